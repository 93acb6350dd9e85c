"""The process of a worker: one job after the other from standard input, answers to standard output.

Started as ``python -m dyknow.service.workers.worker_main MEMORY`` by `worker`. Before the first job
it takes from itself what no job needs: files and sockets (no descriptor beyond the three pipes can
be opened, so that SERVICE and LOAD reach nobody), memory beyond MEMORY bytes more than it has, core
dumps. Each job has its own allowance of processor time. What ends the process ends nothing else.
"""

from __future__ import annotations

import os
import resource
import sys
import time

from ..config.oom_priority import be_dispensable
from .jobs import Worker
from .messages import PREFIX, decode_job, encode


def main() -> None:
    """Serve until standard input ends."""
    worker = Worker()
    worker.warm()
    be_dispensable()
    restrict(int(sys.argv[1]))
    _write(b"ready")
    try:
        _serve(worker)
    except MemoryError:
        # For a job's text or its answer: as it ends where the store needs more.
        os.abort()


def _serve(worker: Worker) -> None:
    while True:
        message = _read()
        if message is None:
            return
        job = decode_job(message)
        del message
        _allow(job.seconds)
        _write(encode(worker.answer(job.work)))


def restrict(memory: int) -> None:
    """From now on: ``memory`` more bytes of address space, no new descriptors, no core dumps."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    most = _address_space() + memory
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, 3))


def _address_space() -> int:
    with open("/proc/self/statm", "rb") as file:
        return int(file.read().split()[0]) * resource.getpagesize()


def _allow(seconds: float) -> None:
    """So much processor time from now on; beyond it the system ends the process."""
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
