"""A log that is looked at, or copied, while it is written to."""

import os
import threading
from concurrent.futures import ThreadPoolExecutor
from unittest.mock import patch

from hypothesis import example, given, settings
from hypothesis import strategies as st
from small_logs import folder

from dyknow.journal import backup, examination, segment
from dyknow.journal.directory import format_bytes, locked
from dyknow.journal.disk import Disk
from dyknow.journal.durability import Durability
from dyknow.journal.examination import examine
from dyknow.journal.log import Log

STEPS = st.lists(st.sampled_from([None, None, 1, 9, 40]), min_size=6, max_size=40)
"""Sizes of records that are appended; None: a commit."""


class Part:
    """Work in a thread that goes on from one pause to the next, when it is told to."""

    def __init__(self, threads, work):
        self.is_over = False
        self._may_go, self._has_paused = threading.Semaphore(0), threading.Semaphore(0)
        self._work = threads.submit(self._run, work)

    def _run(self, work):
        self._may_go.acquire()
        try:
            return work()
        finally:
            self.is_over = True
            self._has_paused.release()

    def pause(self):
        self._has_paused.release()
        self._may_go.acquire()

    def go(self):
        if not self.is_over:
            self._may_go.release()
            assert self._has_paused.acquire(timeout=120)

    def finish(self):
        while not self.is_over:
            self.go()
        return self._work.result()


class Watched(Disk):
    """``look`` is called before anything is done, and knows how many files were made. With
    ``halves`` the end of what is written can be seen before its beginning."""

    def __init__(self, *, halves):
        self.look = lambda: None
        self.made = 0
        self.halves = halves

    def open(self, path, *, new=False):
        self.look()
        self.made += new
        return super().open(path, new=new)

    def allocate(self, file, start, count):
        self.look()
        super().allocate(file, start, count)

    def write(self, file, data, start):
        self.look()
        if self.halves:
            middle = len(data) // 2
            super().write(file, data[middle:], start + middle)
            self.look()
            data = data[:middle]
        super().write(file, data, start)

    def sync(self, file):
        self.look()
        super().sync(file)


def found_meanwhile(path, steps, files, gaps, size, durability, read, *, halves=False):
    """What ``read`` gives of the log in ``path``, and up to where records were acknowledged before.

    It begins when so many ``files`` are there. Before it, and between two files that it reads, the
    writer calls the disk as often as ``gaps`` say.
    """
    disk = Watched(halves=halves)
    log = Log(path / "journal", segment=size, disk=disk, durability=durability)
    (path / "format.json").write_bytes(format_bytes())
    plain, acknowledged = segment.scan, []
    disk.made = 0

    def paused(*arguments):
        found = plain(*arguments)
        reader.pause()
        return found

    def reading():
        acknowledged.append(log.durable)
        return read(path)

    def look():
        nonlocal left
        left -= disk.made >= files
        while left < 0 and not reader.is_over:
            reader.go()
            left = next(chances, 0)

    chances = iter(gaps)
    left = next(chances)
    with ThreadPoolExecutor(1) as threads, patch.object(examination, "scan", paused):
        reader = Part(threads, reading)
        disk.look = look
        try:
            for step in steps:
                if step is None:
                    log.commit()
                else:
                    log.append(bytes([step + 1]) * (step + 1))
        finally:
            disk.look = lambda: None
            found = reader.finish()
    log.close()
    return found, acknowledged[0]


GIVEN = (
    STEPS,
    st.integers(1, 4),
    st.tuples(st.integers(0, 8), st.integers(0, 20), st.integers(0, 20)),
    st.sampled_from([1, 100, 160, 250]),
    st.sampled_from(list(Durability)),
)
PENDING_IN_TWO = ([9, None, 40, 9, None, 9, None], 2, (2, 5), 100, Durability.FSYNC)
"""When the reader begins, a record waits for the first file and one for the second."""


@given(*GIVEN)
@example(*PENDING_IN_TWO)
@settings(deadline=None, max_examples=150)
def test_what_is_being_written_is_no_damage(steps, files, gaps, size, durability):
    with folder() as path:
        found, acknowledged = found_meanwhile(
            path, steps, files, gaps, size, durability, lambda path: examine(path / "journal")
        )
    assert found.damage is None
    assert found.position >= acknowledged


@given(*GIVEN)
@settings(deadline=None, max_examples=150)
def test_half_of_a_write_is_no_damage_where_somebody_writes(steps, files, gaps, size, durability):
    with folder() as path:
        found, acknowledged = found_meanwhile(
            path,
            steps,
            files,
            gaps,
            size,
            durability,
            lambda path: examine(path / "journal", in_use=True),
            halves=True,
        )
    assert found.damage is found.torn is None
    assert not any(each.damage for each in found.scans)
    assert found.position >= acknowledged


@given(*GIVEN, st.booleans())
@example(*PENDING_IN_TWO, False)
@settings(deadline=None, max_examples=100)
def test_a_copy_that_is_made_meanwhile_has_all_that_was_acknowledged(
    steps, files, gaps, size, durability, halves
):
    def copied(path):
        manifest = backup.back_up(path, path.with_name("copy"), "a test")
        return manifest, examine(path.with_name("copy") / "journal")

    with folder() as path:
        path = path / "data"
        path.mkdir()
        lock = locked(path) if halves else None
        (manifest, copy), acknowledged = found_meanwhile(
            path, steps, files, gaps, size, durability, copied, halves=halves
        )
        if lock is not None:
            os.close(lock)
    assert copy.damage is None
    assert manifest.position == copy.position >= acknowledged
