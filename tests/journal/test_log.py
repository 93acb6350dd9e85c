"""The log, case by case; tests/laws/journal/test_journal.py has what holds of all of them."""

import errno
import itertools
import struct
import threading
import zlib

import pytest
from simulated_disk import Killed, SimulatedDisk

from dyknow.journal.durability import Durability
from dyknow.journal.errors import (
    JournalBroken,
    JournalDamaged,
    JournalFull,
    UnknownFormat,
)
from dyknow.journal.high_water import NAME, Mark, read_mark
from dyknow.journal.log import Log
from dyknow.journal.segment import framed, header_of, path_of, scan, walk


def filled(path, count=5, **more):
    """A log with ``count`` records, a file for each two of them, closed."""
    log = Log(path, segment=60, **more)
    for i in range(count):
        log.append(b"record %d" % (i + 1))
        log.commit()
    log.close()
    return sorted(path.glob("*.log"))


def test_what_was_appended_is_read_again_from_any_position(tmp_path):
    filled(tmp_path)
    log = Log(tmp_path)
    assert log.first == 1
    assert [data for _, data in log.read(3)] == [b"record 4", b"record 5"]
    assert list(log.read(5)) == []
    assert log.torn is None
    log.close()


def test_an_error_in_the_block_of_an_entry_leaves_nothing(tmp_path):
    log = Log(tmp_path)
    with pytest.raises(ZeroDivisionError), log.entry(b"no"):
        raise ZeroDivisionError
    assert log.append(b"yes") == 1
    log.close()
    again = Log(tmp_path)
    assert list(again.read()) == [(1, b"yes")]
    again.close()


def test_an_empty_record_is_refused(tmp_path):
    log = Log(tmp_path)
    with pytest.raises(ValueError, match="not empty"):
        log.append(b"")
    log.close()


def test_entries_are_appended_while_another_thread_commits(tmp_path):
    log = Log(tmp_path, segment=4000)
    done = threading.Event()
    seen = []

    def commit():
        while not done.is_set():
            seen.append(log.commit())
            # Read while the end is written to: it is what was committed, at least.
            found = list(log.read(max(0, seen[-1] - 3)))
            assert [position for position, _ in found][:3] == list(
                range(max(1, seen[-1] - 2), seen[-1] + 1)
            )

    thread = threading.Thread(target=commit)
    thread.start()
    for i in range(2000):
        log.append(b"%d" % (i + 1))
    done.set()
    thread.join()
    log.close()
    assert seen == sorted(seen)
    again = Log(tmp_path)
    assert list(again.read()) == [(i + 1, b"%d" % (i + 1)) for i in range(2000)]
    again.close()


def test_files_that_nobody_needs_are_forgotten_and_the_rest_is_read(tmp_path):
    filled(tmp_path, 9)
    log = Log(tmp_path, segment=60)
    log.drop(4)
    assert log.first == 5
    assert [position for position, _ in log.read()] == [5, 6, 7, 8, 9]
    log.close()
    again = Log(tmp_path)
    assert again.first == 5
    again.drop(100)
    assert list(again.read(8)) == [(9, b"record 9")]
    again.close()


def test_files_to_be_forgotten_may_still_be_there_after_a_kill(tmp_path):
    filled(tmp_path, 9)
    disk = SimulatedDisk()
    log = Log(tmp_path, segment=60, disk=disk)
    disk.stop_after = disk.calls + 5  # four of the mark, one file
    with pytest.raises(Killed):
        log.drop(8)
    disk.kill()
    again = Log(tmp_path)
    assert again.first == 3
    assert again.position == 9
    again.close()


def test_of_files_that_are_forgotten_the_power_does_not_bring_back_any_but_the_last(tmp_path):
    filled(tmp_path, 9)
    disk = SimulatedDisk()
    log = Log(tmp_path, segment=60, disk=disk)
    log.drop(8)
    which = itertools.cycle([False, True])
    disk.lose_power(lambda: next(which), lambda n: n)
    again = Log(tmp_path)
    assert (again.first, again.position) == (9, 9)
    again.close()


def test_one_copy_of_the_mark_is_whole_at_any_time(tmp_path):
    """The power goes between the writes of both, and takes both that are not synced."""
    filled(tmp_path, 5)
    disk = SimulatedDisk()
    log = Log(tmp_path, disk=disk)
    before = read_mark(tmp_path)
    disk.stop_after = disk.calls + 3
    with pytest.raises(Killed):
        log._mark.keep(Mark(1, 4, 4))
    # What was written begins in the middle: the head of each is torn.
    which = itertools.cycle([True, False])
    disk.lose_power(lambda: next(which), lambda n: n // 2)
    assert read_mark(tmp_path).mark is not None
    assert before.mark == Mark(1, 5, 5)


def test_a_file_whose_records_nobody_has_kept_does_not_let_the_one_before_go(tmp_path):
    disk = SimulatedDisk()
    log = Log(tmp_path, segment=1, disk=disk)
    log.append(b"kept")
    log.commit()
    with pytest.raises(ZeroDivisionError), log.entry(b"no"):
        raise ZeroDivisionError
    log.drop(1)
    disk.lose_power(lambda: False, lambda n: 0)
    again = Log(tmp_path)
    assert list(again.read()) == [(1, b"kept")]
    again.close()


@pytest.mark.parametrize("left", [b"", bytes(100), header_of(6)[:10], header_of(6)])
def test_a_last_file_that_was_only_begun_is_begun_again(tmp_path, left):
    filled(tmp_path)
    path = path_of(tmp_path, 6)
    path.write_bytes(left)
    log = Log(tmp_path, segment=60)
    assert log.position == 5
    assert (log.torn is None) == (left == header_of(6))
    log.append(b"record 6")
    log.append(b"record 7")
    log.close()
    again = Log(tmp_path)
    assert [data for _, data in again.read(4)] == [b"record 5", b"record 6", b"record 7"]
    again.close()


@pytest.mark.parametrize("hurt", ["first", "middle", "last", "end", "mark too"])
def test_a_file_that_is_missing_is_told(tmp_path, hurt):
    files = filled(tmp_path, 9)
    if hurt == "end":
        scanned = scan(files[-1])
        files[-1].write_bytes(files[-1].read_bytes()[: scanned.end - 10])
    else:
        files[{"first": 0, "last": -1}.get(hurt, 1)].unlink()
    if hurt == "mark too":
        (tmp_path / NAME).unlink()
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(JournalDamaged) as caught:
        Log(tmp_path)
    assert "dyknow check" in caught.value.hint
    assert before == {path: path.read_bytes() for path in tmp_path.iterdir()}


def test_a_flipped_bit_is_told_with_its_place(tmp_path):
    files = filled(tmp_path, 9)
    data = bytearray(files[1].read_bytes())
    data[50] ^= 4
    files[1].write_bytes(data)
    with pytest.raises(JournalDamaged, match=f"{files[1].name}: .*from byte 24 on, after record 2"):
        Log(tmp_path)


def test_damage_behind_the_last_record_of_a_file_is_cut_off_and_told(tmp_path):
    files = filled(tmp_path, 9)
    with files[1].open("ab") as file:
        file.write(b"junk")
    log = Log(tmp_path)
    assert log.torn.path == files[1]
    assert [position for position, _ in log.read()] == list(range(1, 10))
    log.close()
    assert b"junk" not in files[1].read_bytes()


def test_damage_that_comes_while_it_runs_is_told_to_who_reads(tmp_path):
    filled(tmp_path, 9)
    log = Log(tmp_path)
    files = sorted(tmp_path.glob("*.log"))
    data = bytearray(files[2].read_bytes())
    data[60] ^= 1
    files[2].write_bytes(data)
    with pytest.raises(JournalDamaged, match="record 6 "):
        list(log.read())
    log.close()


def test_a_later_format_is_refused_with_what_to_do(tmp_path):
    files = filled(tmp_path)
    checksum = zlib.crc32(struct.pack("<IQ", 2, 5))
    files[-1].write_bytes(struct.pack("<8sIIQ", b"DYKNOWLG", 2, checksum, 5))
    with pytest.raises(UnknownFormat, match="format 2") as caught:
        Log(tmp_path)
    assert "later" in caught.value.hint


def test_a_record_of_an_unfinished_write_is_no_damage_though_later_ones_are_there(tmp_path):
    """The disk writes in any order: what is behind tells that nothing of it was synced."""
    log = Log(tmp_path)
    log.append(b"kept")
    log.commit()
    log.close()
    path = path_of(tmp_path, 1)
    with path.open("r+b") as file:
        file.seek(scan(path).end)
        file.write(bytes(30) + framed(3, b"third", 1))
    again = Log(tmp_path)
    assert again.position == 1
    assert again.torn is not None
    again.close()


def test_the_last_room_of_a_disk_is_used(tmp_path):
    disk = SimulatedDisk(room=200)
    log = Log(tmp_path, disk=disk)
    for _ in range(3):
        log.append(b"x" * 30)
    with pytest.raises(JournalFull):
        log.append(b"x" * 60)
    assert log.append(b"x") == 4
    assert log.commit() == 4
    log.close()


def test_a_record_may_be_longer_than_the_room_that_is_made_and_than_a_file(tmp_path):
    disk = SimulatedDisk()
    log = Log(tmp_path, segment=100, disk=disk)
    long = b"l" * (5 << 20)
    assert log.append(long) == 1
    disk.room = 5 << 20
    with pytest.raises(JournalFull):
        log.append(long)
    disk.room = None
    assert log.append(long) == 2
    log.commit()
    disk.kill()
    again = Log(tmp_path)
    assert [data for _, data in again.read()] == [long, long]
    again.close()


def test_while_what_was_taken_cannot_be_written_nothing_more_is_taken(tmp_path):
    disk = SimulatedDisk()
    log = Log(tmp_path, disk=disk)
    log.append(b"taken")
    disk.full_writes = True
    with pytest.raises(JournalFull):
        log.commit()
    disk.full_writes = False
    with pytest.raises(JournalFull):
        log.append(b"more")
    assert log.commit() == 1
    assert log.append(b"more") == 2
    log.close()


def test_what_cannot_be_opened_is_told_and_tried_again(tmp_path):
    disk = SimulatedDisk()
    log = Log(tmp_path, segment=1, disk=disk)
    disk.broken = {"open"}
    with pytest.raises(JournalBroken):
        log.append(b"a")
    disk.broken.clear()
    assert log.append(b"a") == 1
    log.close()


def test_a_write_that_fails_for_another_cause_ends_it(tmp_path):
    disk = SimulatedDisk()
    log = Log(tmp_path, disk=disk)
    log.append(b"a")
    disk.broken = {"write"}
    with pytest.raises(JournalBroken):
        log.commit()
    disk.broken.clear()
    with pytest.raises(JournalBroken, match=str(errno.EIO)):
        log.append(b"b")


def test_what_durability_write_has_acknowledged_and_lost_is_counted(tmp_path):
    disk = SimulatedDisk()
    log = Log(tmp_path, durability=Durability.WRITE, disk=disk)
    for i in range(3):
        log.append(b"%d" % i)
        log.commit()
    # Of all that was written the power leaves the mark and the file's name.
    log._mark.keep(Mark(1, 0, 3))
    disk.sync_folder(tmp_path)
    disk.lose_power(lambda: False, lambda n: 0)
    again = Log(tmp_path)
    assert again.lost == 3
    assert again.position == 0
    again.close()


def test_after_a_kill_all_is_on_the_disk_before_anybody_is_told(tmp_path):
    """What the operating system still had is synced at the start."""
    disk = SimulatedDisk()
    log = Log(tmp_path, durability=Durability.WRITE, segment=1, disk=disk)
    for i in range(3):
        log.append(b"%d" % i)
    log.commit()
    again = Log(tmp_path, segment=1, disk=disk)
    assert again.durable == 3
    disk.lose_power(lambda: False, lambda n: 0)
    third = Log(tmp_path)
    assert third.position == 3
    third.close()


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("place", [4, 30])
def test_what_a_client_has_sent_is_no_record_where_the_one_with_it_is_damaged(
    tmp_path, count, place
):
    """Its bytes may be those of a record, with any position, and whatever it says was synced."""
    folder = tmp_path / "journal"
    log = Log(folder)
    log.append(b"first")
    for i in range(count):
        log.append(
            b"sent: " + framed(2 + i, b"planted", 100) + framed(3 + i, b"another", 100) + b"."
        )
    log.commit()
    log.close()
    (path,) = folder.glob("*.log")
    damaged = bytearray(path.read_bytes())
    start = next(walk(bytes(damaged), 1))
    damaged[start.begin + start.length + place] ^= 1
    path.write_bytes(damaged)
    damage = scan(path).damage
    assert damage is not None
    assert [each.position for each in damage.behind] == list(range(3, 2 + count))
    assert all(each.synced < 100 for each in damage.behind)
