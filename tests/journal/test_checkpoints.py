"""Checkpoints: the newest two, whole, or an error that says what to do."""

import pytest
from simulated_disk import SimulatedDisk

from dyknow.journal.checkpoints import Checkpoint, Checkpoints, parts_of
from dyknow.journal.errors import JournalBroken, JournalDamaged, JournalFull


def kept(position, state=b"state"):
    return Checkpoint(position, "dyknow 1", b"portable", state)


def test_the_newest_two_are_kept(tmp_path):
    found = Checkpoints(tmp_path)
    for position in (5, 9, 12):
        found.write(kept(position))
    assert found.positions() == [12, 9]
    assert found.read(12) == kept(12)


def test_the_same_position_again_replaces_it(tmp_path):
    found = Checkpoints(tmp_path)
    found.write(kept(5))
    found.write(kept(5, b"other"))
    assert found.read(5).state == b"other"


@pytest.mark.parametrize(("broken", "error"), [("room", JournalFull), ("sync", JournalBroken)])
def test_one_that_cannot_be_written_leaves_the_others_and_nothing(tmp_path, broken, error):
    disk = SimulatedDisk()
    found = Checkpoints(tmp_path, disk)
    found.write(kept(5))
    if broken == "room":
        disk.room = 3
    else:
        disk.broken = {"sync"}
    with pytest.raises(error) as caught:
        found.write(kept(9))
    assert caught.value.hint
    assert found.positions() == [5]
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".checkpoint", ".json"]
    assert found.gone() == []


def test_what_a_crash_left_is_removed(tmp_path):
    (tmp_path / "00000000000000000005.part").write_bytes(b"half")
    assert Checkpoints(tmp_path).positions() == []
    assert not list(tmp_path.iterdir())


def test_what_others_left_that_came_to_nothing_makes_room(tmp_path):
    found = Checkpoints(tmp_path)
    found.put(kept(5))
    found.put(kept(9))
    assert [path.name for path in tmp_path.iterdir()] == [f"{9:020d}.part"]
    found.drop(9)
    found.drop(9)
    assert not list(tmp_path.iterdir())


def test_one_under_the_name_of_another_is_told(tmp_path):
    found = Checkpoints(tmp_path)
    (tmp_path / "00000000000000000006.checkpoint").write_bytes(b"".join(parts_of(kept(5))))
    with pytest.raises(JournalDamaged, match="is of position 5"):
        found.read(6)
