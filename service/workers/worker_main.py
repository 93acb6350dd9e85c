"""The main program of the fork server and of its workers.

`fork_server` starts it with a socket as standard input. It does each kind of job once, then forks
a worker for each request.

A worker reads jobs from standard input, and writes answers to standard output. Before the first
job it gives up the rights that no job needs. It can open no files and sockets beyond its three
pipes, so SERVICE and LOAD cannot reach the network. It can allocate at most the requested memory
more, and dumps no core. Each job has its own limit of processor time. Exceeding a limit kills this
process only.
"""

from __future__ import annotations

import gc
import os
import resource
import select
import signal
import socket
import time
from concurrent.futures import ThreadPoolExecutor
from typing import NoReturn

from ..config.address_space import limit_address_space
from ..config.oom_priority import be_dispensable
from .fork_server import STATUS_BYTES
from .jobs import Worker
from .messages import PREFIX, decode_job, encode


def main() -> None:
    """Fork workers until the service closes its end of the socket."""
    worker = Worker()
    # Each thread of Oxigraph has its own random numbers. Those of the main thread must not have
    # begun: all workers would go on with the same, and make the same UUIDs and blank nodes.
    with ThreadPoolExecutor(1) as thread:
        thread.submit(worker.warm).result()
    while len(os.listdir("/proc/self/task")) > 1:
        time.sleep(0.001)  # Python joins a thread before the system has ended it.
    gc.freeze()  # What all workers share is not written to by the collector.
    with socket.socket(fileno=0) as service:
        _ForkLoop(service, worker).run()


class _ForkLoop:
    """Forks ``worker`` for each request, and tells how each fork ended."""

    def __init__(self, service: socket.socket, worker: Worker) -> None:
        self._service = service
        self._worker = worker
        self._statuses: dict[int, int] = {}
        """The pipe for the exit status of each worker, by process id."""
        self._wakeup, wakeup = os.pipe()
        os.set_blocking(wakeup, False)
        signal.set_wakeup_fd(wakeup, warn_on_full_buffer=False)
        signal.signal(signal.SIGCHLD, lambda *_: None)

    def run(self) -> None:
        while True:
            ready, _, _ = select.select([self._service.fileno(), self._wakeup], [], [])
            if self._wakeup in ready:
                os.read(self._wakeup, 1 << 16)
                self._reap()
            if self._service.fileno() in ready:
                request = self._service.recv(8)
                if not request:
                    return
                self._fork(int.from_bytes(request, "big"))

    def _reap(self) -> None:
        while self._statuses:
            pid, status = os.waitpid(-1, os.WNOHANG)
            if not pid:
                return
            code = os.waitstatus_to_exitcode(status)
            pipe = self._statuses.pop(pid)
            try:
                os.write(pipe, code.to_bytes(STATUS_BYTES, "big", signed=True))
            except BrokenPipeError:
                pass  # The service has closed its handle: it killed the worker.
            finally:
                os.close(pipe)

    def _fork(self, memory: int) -> None:
        pipes: list[tuple[int, int]] = []
        try:
            pipes.extend(os.pipe() for _ in range(3))
            pid = os.fork()
        except OSError as error:  # no memory, or too many processes or files
            self._service.send(str(error).encode())
            for pipe in pipes:
                for descriptor in pipe:
                    os.close(descriptor)
            return
        (jobs, to_jobs), (from_answers, answers), (from_status, status) = pipes
        if not pid:
            _become_worker(self._worker, jobs, answers, memory)
        self._statuses[pid] = status
        socket.send_fds(self._service, [b"%d" % pid], [to_jobs, from_answers, from_status])
        for descriptor in (jobs, answers, to_jobs, from_answers, from_status):
            os.close(descriptor)


def _become_worker(worker: Worker, jobs: int, answers: int, memory: int) -> NoReturn:
    """Serve jobs until the pipe ``jobs`` ends, then end this process."""
    try:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        os.dup2(jobs, 0)  # closes the socket
        os.dup2(answers, 1)
        os.closerange(3, 1 + max(map(int, os.listdir("/proc/self/fd"))))
        be_dispensable()
        restrict(memory)
        _write(b"ready")
        _serve(worker)
        os._exit(0)
    except MemoryError:
        # Reading a job or writing its answer failed: abort, as the store does without memory.
        os.abort()
    finally:
        os._exit(1)


def _serve(worker: Worker) -> None:
    while True:
        message = _read()
        if message is None:
            return
        job = decode_job(message)
        del message
        _limit_processor_time(job.seconds)
        _write(encode(worker.answer(job.work)))


def restrict(memory: int) -> None:
    """Limit the process to ``memory`` more bytes, no new descriptors and no core dumps."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    limit_address_space(memory)
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, 3))


def _limit_processor_time(seconds: float) -> None:
    """Allow ``seconds`` more processor time; beyond it the system kills the process."""
    # The system counts the whole life of the process, in whole seconds.
    soft = int(time.process_time() + seconds) + 2
    resource.setrlimit(resource.RLIMIT_CPU, (soft, resource.RLIM_INFINITY))


def _read() -> bytes | None:
    length = _read_exactly(PREFIX)
    return None if length is None else _read_exactly(int.from_bytes(length, "big"))


def _read_exactly(size: int) -> bytes | None:
    data = bytearray()
    while len(data) < size:
        part = os.read(0, min(size - len(data), 1 << 20))
        if not part:
            return None
        data += part
    return bytes(data)


def _write(message: bytes) -> None:
    for data in (len(message).to_bytes(PREFIX, "big"), message):
        left = memoryview(data)
        while left:
            left = left[os.write(1, left) :]


if __name__ == "__main__":
    main()
