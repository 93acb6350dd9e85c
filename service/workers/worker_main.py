"""The main program of a worker process: it reads jobs from standard input, and writes answers to
standard output.

`worker` starts it as ``python -m dyknow.service.workers.worker_main MEMORY``. Before the first job
it gives up the rights that no job needs. It can open no files and sockets beyond its three pipes,
so SERVICE and LOAD cannot reach the network. It can allocate at most MEMORY more bytes, and dumps
no core. Each job has its own limit of processor time. Exceeding a limit kills this process only.
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
    """Serve jobs until standard input ends."""
    worker = Worker()
    worker.warm()
    be_dispensable()
    restrict(int(sys.argv[1]))
    _write(b"ready")
    try:
        _serve(worker)
    except MemoryError:
        # Reading a job or writing its answer failed: abort, as the store does without memory.
        os.abort()


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
    most = _address_space() + memory
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, 3))


def _address_space() -> int:
    with open("/proc/self/statm", "rb") as file:
        return int(file.read().split()[0]) * resource.getpagesize()


def _limit_processor_time(seconds: float) -> None:
    """Allow ``seconds`` more processor time; beyond it the system kills the process."""
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
