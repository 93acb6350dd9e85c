"""The fork server: which processes end with which, and what is left."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from waiting import until

from dyknow.service.workers.fork_server import FORK_SERVER, ForkedProcess, ForkServer

MEMORY = 64 << 20


@pytest.fixture
def server() -> Iterator[ForkServer]:
    made = ForkServer()
    yield made
    made.stop()


def parent_of(process: ForkedProcess) -> int:
    return int(Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[1])


def descriptors(pid: int) -> int:
    return len(os.listdir(f"/proc/{pid}/fd"))


def end(process: ForkedProcess) -> None:
    process.kill()
    process.wait()
    process.close()


def test_all_workers_have_one_parent_without_threads(server: ForkServer) -> None:
    workers = [server.fork(MEMORY) for _ in range(3)]
    (parent,) = set(map(parent_of, workers))
    assert parent != os.getpid()
    assert len(os.listdir(f"/proc/{parent}/task")) == 1
    for each in workers:
        end(each)


def test_nothing_is_left_of_workers(server: ForkServer) -> None:
    first = server.fork(MEMORY)
    parent = parent_of(first)
    end(first)
    here = descriptors(os.getpid())
    for _ in range(20):
        workers = [server.fork(MEMORY) for _ in range(3)]
        for each in workers:
            end(each)
    assert descriptors(os.getpid()) == here
    # The three of any process, and a pipe that wakes it.
    until(lambda: descriptors(parent) == 5)
    assert not Path(f"/proc/{parent}/task/{parent}/children").read_text()


def test_how_a_worker_ended(server: ForkServer) -> None:
    for number in (signal.SIGKILL, signal.SIGSEGV, signal.SIGXCPU):
        worker = server.fork(MEMORY)
        assert worker.poll() is None
        os.kill(worker.pid, number)
        assert worker.wait() == worker.poll() == -number
        worker.close()
    worker = server.fork(MEMORY)
    os.close(os.dup(worker.jobs))
    with open("/dev/null", "rb") as nothing:
        os.dup2(nothing.fileno(), worker.jobs)  # the end of its input
    assert worker.wait() == 0
    worker.close()


def test_a_service_may_have_thousands_of_descriptors(server: ForkServer) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, 4096), hard))
    here = [os.open("/dev/null", os.O_RDONLY) for _ in range(1100)]
    try:
        worker = server.fork(MEMORY)
        assert min(worker.jobs, worker.answers) > 1023
        assert worker.poll() is None
        end(worker)
    finally:
        for each in here:
            os.close(each)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_when_the_server_dies_its_workers_are_dead_and_another_comes(server: ForkServer) -> None:
    worker = server.fork(MEMORY)
    parent = parent_of(worker)
    os.kill(parent, signal.SIGKILL)
    assert worker.wait() == -signal.SIGKILL
    until(lambda: not Path(f"/proc/{worker.pid}/exe").exists())
    worker.close()
    until(lambda: not Path(f"/proc/{parent}/exe").exists())
    other = server.fork(MEMORY)
    assert parent_of(other) != parent
    end(other)


def test_a_server_that_does_not_answer_is_replaced(
    server: ForkServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as hasty:
        hasty.setattr("dyknow.service.workers.fork_server.START_DEADLINE", 0.0001)
        with pytest.raises(OSError, match="timed out"):
            server.fork(MEMORY)
    end(server.fork(MEMORY))


def test_the_fork_of_a_process_has_a_server_of_its_own() -> None:
    process = FORK_SERVER.fork(MEMORY)
    child = os.fork()
    if not child:
        try:
            own = FORK_SERVER.fork(MEMORY)
            assert parent_of(own) != parent_of(process)
            end(own)
            FORK_SERVER.stop()
            os._exit(0)
        finally:
            os._exit(1)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 0
    assert process.poll() is None
    other = FORK_SERVER.fork(MEMORY)
    assert parent_of(other) == parent_of(process)
    end(process)
    end(other)


def test_server_and_workers_end_with_their_process() -> None:
    text = f"""
import os
from dyknow.service.workers.fork_server import FORK_SERVER
process = FORK_SERVER.fork({MEMORY})
print(process.pid, os.getpid(), flush=True)
input()
"""
    with subprocess.Popen(
        [sys.executable, "-c", text], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        worker = int(process.stdout.readline().split()[0])
        parent = int(Path(f"/proc/{worker}/stat").read_text().rpartition(")")[2].split()[1])
        process.kill()
    for pid in (worker, parent):
        until(lambda pid=pid: not Path(f"/proc/{pid}/exe").exists())
