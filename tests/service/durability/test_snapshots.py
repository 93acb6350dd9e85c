"""What is done on a copy of the process: with the state as it was, and without holding it up."""

from __future__ import annotations

import fcntl
import os
import resource
import signal
import threading
import time
from pathlib import Path

import pytest

from dyknow.engine.durability.commands import DeclareStream, Publish
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.journal.errors import JournalFull
from dyknow.service.durability.fork_snapshot import SnapshotError, Snapshots
from dyknow.streams.sample import Field, FieldType


class Odd(Exception):
    """Its arguments are not those that it was made with, as those of many are not."""

    def __init__(self, one, two):
        super().__init__(f"{one} and {two}")


def is_running(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def test_it_is_as_it_was_when_the_copy_was_taken():
    numbers = [1, 2, 3]
    found = Snapshots().take(lambda: sum(numbers))
    numbers.append(4)
    assert found() == 6


def test_what_is_raised_there_is_raised_here():
    def full():
        raise JournalFull("no room", "make some")

    with pytest.raises(JournalFull, match="no room") as caught:
        Snapshots().take(full)()
    assert caught.value.hint == "make some"


def test_a_copy_that_dies_is_told():
    with pytest.raises(SnapshotError, match=r"has died \(7\)"):
        Snapshots().take(lambda: os._exit(7))()


def test_a_copy_that_takes_for_ever_is_ended():
    with pytest.raises(SnapshotError, match=r"more than 0\.2 s"):
        Snapshots(timeout=0.2).take(lambda: time.sleep(600))()


def test_it_can_be_given_up():
    snapshots = Snapshots()
    found = snapshots.take(lambda: time.sleep(600))
    snapshots.kill()
    with pytest.raises(SnapshotError, match="has died"):
        found()
    snapshots.kill()


def test_a_service_with_thousands_of_connections_has_copies_too(monkeypatch):
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    pipe = os.pipe

    def high():
        found = []
        for low in pipe():
            found.append(fcntl.fcntl(low, fcntl.F_DUPFD_CLOEXEC, 1500))
            os.close(low)
        return tuple(found)

    resource.setrlimit(resource.RLIMIT_NOFILE, (2000, hard))
    try:
        monkeypatch.setattr(os, "pipe", high)
        assert Snapshots().take(lambda: 7)() == 7
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_where_memory_is_short_the_copy_goes_before_the_service():
    score = Path("/proc/self/oom_score_adj")
    before = score.read_text()
    assert Snapshots().take(score.read_text)().strip() == "1000"
    assert score.read_text() == before


def test_an_error_that_cannot_be_read_is_told():
    def fails():
        raise Odd("this", "that")

    with pytest.raises(SnapshotError, match="missing 1 required"):
        Snapshots().take(fails)()


def test_who_lets_the_system_wait_for_children_has_copies_too():
    """As a service inherits it from some that start it."""
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    try:
        snapshots = Snapshots()
        assert snapshots.take(lambda: 7)() == 7
        assert snapshots._child == 0
    finally:
        signal.signal(signal.SIGCHLD, before)


def test_a_lock_of_another_thread_is_not_waited_for_for_ever():
    lock = threading.Lock()
    with lock, pytest.raises(SnapshotError):
        Snapshots(timeout=0.2).take(lock.acquire)()


def test_what_another_thread_changes_under_a_lock_is_whole_and_free_in_a_copy():
    lock, begun, values = threading.RLock(), threading.Event(), [1, 1]

    def change():
        with lock:
            values[0] = 2
            begun.set()
            time.sleep(0.2)
            values[1] = 2

    def look():
        # In a thread of its own, as a state is pickled in one.
        found = []
        thread = threading.Thread(target=lambda: found.append(lock.acquire(timeout=120)))
        thread.start()
        thread.join()
        return found, list(values)

    thread = threading.Thread(target=change)
    thread.start()
    begun.wait()
    assert Snapshots(timeout=120).take(look, lock)() == ([True], [2, 2])
    assert lock.acquire(blocking=False), "it is free here, too"
    thread.join()


def test_files_and_connections_of_the_service_end_with_the_service():
    reader, writer = os.pipe()
    found = Snapshots().take(lambda: time.sleep(1))
    os.close(writer)
    assert os.read(reader, 1) == b"", "the copy would hold it open"
    os.close(reader)
    found()


def test_it_ends_with_the_thread_that_asked():
    """Which is the service's: a copy of one that was killed holds up no start."""
    reader, writer = os.pipe()
    child = os.fork()
    if not child:
        work = Snapshots()
        work.take(lambda: time.sleep(600))
        os.write(writer, str(work._child).encode())
        os._exit(0)
    copy = int(os.read(reader, 100))
    os.waitpid(child, 0)
    until = time.monotonic() + 120
    while is_running(copy):
        assert time.monotonic() < until
        time.sleep(0.01)
    os.close(reader)
    os.close(writer)


def test_a_checkpoint_by_a_copy_has_what_was_done_before_and_nothing_after(tmp_path):
    recorded = RecordedEngine(tmp_path, now=0)
    recorded.do(DeclareStream(StreamDeclaration("s", (Field("n", FieldType.INTEGER),))))

    def say(number):
        line = f'{{"valid": {number}, "available": {number}, "n": {number}}}\n'
        recorded.do(Publish("s", "ndjson", line.encode(), number))
        recorded.log.commit()

    say(1)
    epoch = recorded.engine.epoch
    unwritten = recorded.checkpoint(Snapshots().take)
    say(2)
    assert unwritten.write() == ()
    say(3)
    recorded.close(checkpoint=False)

    again = RecordedEngine(tmp_path, now=0)
    assert again.recovery.position == unwritten.position
    assert again.recovery.replayed == 2
    assert again.engine.epoch == epoch
    samples = again.engine.generator("s").stream.all()
    assert samples.columns["n"].values.tolist() == [1, 2, 3]
    again.close()


def test_who_asks_the_ontology_meanwhile_does_not_hold_a_checkpoint_up(tmp_path):
    """A worker's thread brings it up to date for a query, as a state does when it is written."""
    recorded = RecordedEngine(tmp_path, now=0)
    ontology = recorded.engine.ontology
    # So there is something to be brought in.
    recorded.do(DeclareStream(StreamDeclaration("s", (Field("n", FieldType.INTEGER),))))
    begun = threading.Event()

    def ask():
        with ontology.lock:
            begun.set()
            time.sleep(0.2)

    asking = threading.Thread(target=ask)
    asking.start()
    begun.wait()
    unwritten = recorded.checkpoint(Snapshots(timeout=120).take)
    assert unwritten.write() == ()
    asking.join()
    recorded.close(checkpoint=False)
    again = RecordedEngine(tmp_path, now=0)
    assert again.recovery.replayed == 0
    again.close()
