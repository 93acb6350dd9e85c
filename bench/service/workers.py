"""What worker processes cost: their start, a job, and their memory.

    python bench/service/workers.py

Memory is the proportional set size: what processes share counts once.
"""

from __future__ import annotations

import statistics
import time

import psutil

from dyknow.service.workers.messages import Job, Query
from dyknow.service.workers.worker import Worker

WORKERS = 6
"""Of a service: two to four for SPARQL, two for windows, one each for ontologies and others."""
MEMORY = 64 << 20
JOB = Job(Query("ASK {}", "application/json", 1000, 1 << 20), 20)


def timed_start() -> tuple[Worker, float]:
    begin = time.perf_counter()
    worker = Worker.start(MEMORY)
    return worker, time.perf_counter() - begin


def timed_call(worker: Worker) -> float:
    begin = time.perf_counter()
    worker.call(JOB, 1000)
    return time.perf_counter() - begin


def main() -> None:
    first, start = timed_start()
    print(f"fork server and first worker  {1000 * start:8.1f} ms")
    started = [timed_start() for _ in range(WORKERS - 1)]
    seconds = statistics.median(each for _, each in started)
    print(f"another worker                {1000 * seconds:8.1f} ms")
    workers = [first, *(worker for worker, _ in started)]
    for worker in workers:
        timed_call(worker)
    calls = statistics.median(timed_call(first) for _ in range(200))
    print(f"a job                         {1000 * calls:8.2f} ms")
    server = psutil.Process(first.pid).parent()
    assert server is not None
    processes = [server, *(psutil.Process(worker.pid) for worker in workers)]
    sizes = [process.memory_full_info() for process in processes]
    print(f"the server and {WORKERS} workers      {sum(each.pss for each in sizes) / 1e6:8.0f} MB")
    print(f"one of them                   {max(each.rss for each in sizes) / 1e6:8.0f} MB resident")
    for worker in workers:
        worker.close()


if __name__ == "__main__":
    main()
