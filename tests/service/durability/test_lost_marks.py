"""Damage to what tells how far a data directory goes: it is told by ``dyknow check`` and the start
alike, and no id is given twice (docs/reference/data-directory.md)."""

import json
import shutil
from pathlib import Path

import pytest
from command_line import run
from simulated_disk import Killed, SimulatedDisk

from dyknow.engine.durability.commands import DeclareStream, Publish
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.journal.errors import JournalDamaged
from dyknow.journal.high_water import Mark
from dyknow.journal.segment import walk
from dyknow.rdf.namespaces import DYKNOW
from dyknow.streams.history import Retention
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import SECOND

NUMBERS = StreamDeclaration("s", (Field("n", FieldType.INTEGER),), 0, Retention(), DYKNOW, None)
MARK = "journal/high-water-mark"
COPY = 36
"""Bytes of one copy of the mark."""


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """Samples 1 to 10 in one file of the log, records 3 to 12; checkpoints of records 4 and 8."""
    path = tmp_path_factory.mktemp("original") / "data"
    recorded = RecordedEngine(path, now=0)
    recorded.do(DeclareStream(NUMBERS))
    for n in range(1, 11):
        body = b'{"valid": %d, "available": %d, "n": %d}\n' % (n * SECOND, n * SECOND, n)
        recorded.do(Publish("s", "ndjson", body, n * SECOND))
        recorded.log.commit()
        if n in (2, 6):
            recorded.checkpoint().write()
    recorded.close(checkpoint=False)
    return path


@pytest.fixture
def data(original, tmp_path):
    return shutil.copytree(original, tmp_path / "data")


def checked(data, status=1):
    return json.loads(run("check", data, "--json", status=status).stdout)


def opened(data, **more):
    return RecordedEngine(data, now=30 * SECOND, **more)


def zero(data, start, end):
    content = bytearray((data / MARK).read_bytes())
    content[start:end] = bytes(end - start)
    (data / MARK).write_bytes(content)


def cut(data, count):
    """Let the log end before its last ``count`` records, where one ends."""
    (path,) = (data / "journal").glob("*.log")
    content = path.read_bytes()
    end = list(walk(content, 1))[-count - 1]
    path.write_bytes(content[: end.begin + end.length])


def shown(recorded):
    """Its epoch and the numbers in its stream; it is closed as by a kill."""
    stream = recorded.engine.generator("s").stream
    found = recorded.engine.epoch, stream.all().columns["n"].values.tolist()
    recorded.log.close()
    recorded._directory.close()
    return found


@pytest.mark.parametrize("also_cut", [0, 3])
@pytest.mark.parametrize("how", ["delete", "empty", "shorter", "longer", "all copies"])
def test_a_mark_that_no_loss_of_power_leaves_so_is_refused_and_repaired(data, how, also_cut):
    epoch, _ = shown(opened(data))
    whole = (data / MARK).read_bytes()
    if also_cut:
        cut(data, also_cut)
    if how == "delete":
        (data / MARK).unlink()
    elif how == "all copies":
        zero(data, 5, 80)
    else:
        parts = {"empty": b"", "shorter": whole[:60], "longer": whole + b"\0"}
        (data / MARK).write_bytes(parts[how])
    found = checked(data)
    assert found["start"].startswith("refuses")
    assert "high-water-mark" in found["damage"][0] or "records up to 12" in found["damage"][0]
    with pytest.raises(JournalDamaged, match=r"high-water-mark|records up to 12"):
        opened(data)
    assert json.loads(run("repair", data, "--json").stdout)["lost"]
    checked(data, status=0)
    recorded = opened(data)
    assert not recorded.recovery.is_continued
    anew, numbers = shown(recorded)
    assert anew != epoch
    assert numbers == list(range(1, 11 - also_cut))
    assert shown(opened(data)) == (anew, numbers)


@pytest.mark.parametrize("also_cut", [0, 3])
def test_where_the_last_commits_are_not_told_of_ids_begin_anew(data, also_cut):
    """A loss of power may leave the later copies so: no start is refused for it."""
    epoch, _ = shown(opened(data))
    zero(data, COPY, 3 * COPY)
    if also_cut:
        cut(data, also_cut)
        with pytest.raises(JournalDamaged, match="records up to 12"):
            opened(data)
        # As it is where the last run was killed: the first copy is of its start.
        (data / MARK).write_bytes(Mark(1, 6, 6).encoded() + bytes(2 * COPY))
    found = checked(data)
    assert "only the first copy" in found["damage"][0]
    assert "ids of events begin anew" in found["start"]
    recorded = opened(data)
    assert any("only the first copy" in note for note in recorded.recovery.notes)
    anew, numbers = shown(recorded)
    assert anew != epoch
    assert numbers == list(range(1, 11 - also_cut))
    checked(data, status=0)
    assert shown(opened(data)) == (anew, numbers)


def test_a_start_that_is_killed_before_ids_begin_anew_is_followed_by_one_that_does(data):
    """The first thing that a start does is to write a good mark: it must not hide the doubt."""
    epoch, _ = shown(opened(data))
    damaged = data / MARK
    for calls in range(1, 60):
        zero(data, COPY, 3 * COPY)
        disk = SimulatedDisk()
        disk.stop_after = calls
        try:
            recorded = opened(data, disk=disk)
        except Killed:
            disk.kill()
        else:
            assert shown(recorded)[0] != epoch
            break
        if damaged.read_bytes()[COPY:] == bytes(2 * COPY):
            continue  # It had not come so far.
        anew, _ = shown(opened(data))
        assert anew != epoch, calls
        epoch = anew
    else:
        pytest.fail("it does not end")


@pytest.mark.parametrize(("which", "name"), [(0, "first"), (1, "second"), (2, "third")])
def test_of_three_copies_one_is_not_missed_and_told(data, which, name):
    epoch, numbers = shown(opened(data))
    zero(data, which * COPY, (which + 1) * COPY)
    assert f"the {name} copy" in checked(data)["damage"][0]
    damaged = shutil.copytree(data, data.parent / "damaged")
    cut(damaged, 1)
    with pytest.raises(JournalDamaged, match="records up to 12"):
        opened(damaged)
    recorded = opened(data)
    assert any(f"the {name} copy" in note for note in recorded.recovery.notes)
    assert shown(recorded) == (epoch, numbers)
    checked(data, status=0)


def test_a_mark_of_an_earlier_version_is_read_and_made_longer(data):
    """It had two copies; a process may be killed while the third is added."""
    epoch, numbers = shown(opened(data))
    earlier = Mark(1, 12, 12).encoded().replace(b"DYKNOWH3", b"DYKNOWHW")
    for more in (b"", b"DYKNOWH3", 30 * b"x"):
        (data / MARK).write_bytes(2 * earlier + more)
        checked(data, status=1 if more else 0)
        assert shown(opened(data)) == (epoch, numbers)
        checked(data, status=0)
        assert (data / MARK).stat().st_size == 3 * COPY
    (data / MARK).write_bytes(earlier + bytes(COPY))
    assert shown(opened(data))[0] != epoch


@pytest.mark.parametrize(
    "left", [None, b"", bytes(13), b'{"format":"2"}', b'{"fnrmat":2}', b"\xff"]
)
def test_check_and_start_agree_on_a_format_that_is_not_told(data, left):
    epoch, numbers = shown(opened(data))
    (data / "format.json").unlink()
    if left is not None:
        (data / "format.json").write_bytes(left)
    found = checked(data)
    assert found["damage"] == ["format.json is missing or damaged"]
    assert found["start"].startswith("refuses")
    with pytest.raises(JournalDamaged, match=r"format\.json is missing or damaged"):
        opened(data)
    done = json.loads(run("repair", data, "--json").stdout)
    assert done["lost"] is None
    assert [Path(name).read_bytes() for name in done["aside"]] == ([] if left is None else [left])
    checked(data, status=0)
    assert shown(opened(data)) == (epoch, numbers)


def test_a_checkpoint_that_is_gone_is_told_and_nothing_is_lost(data):
    epoch, numbers = shown(opened(data))
    max((data / "checkpoints").glob("*.checkpoint")).unlink()
    assert checked(data)["damage"] == ["the checkpoint of record 8 is missing"]
    recorded = opened(data)
    assert "the checkpoint of record 8 is missing" in recorded.recovery.notes
    assert shown(recorded) == (epoch, numbers)
    run("repair", data)
    checked(data, status=0)


def test_a_list_of_checkpoints_that_is_damaged_is_told_and_nothing_is_lost(data):
    epoch, numbers = shown(opened(data))
    (data / "checkpoints" / "kept.json").write_bytes(b"[4, \xff")
    assert "kept.json" in checked(data)["damage"][0]
    recorded = opened(data)
    assert any("kept.json" in note for note in recorded.recovery.notes)
    recorded.checkpoint().write()
    assert shown(recorded) == (epoch, numbers)
    checked(data, status=0)


def test_names_that_are_none_of_its_own_are_told_and_are_no_damage(data):
    (data / "journal" / "x.log").write_text("x")
    (data / "note").write_text("x")
    assert checked(data, status=0)["strays"] == ["note", "journal/x.log"]
    assert "unknown, not checked: journal/x.log" in run("check", data).stdout
