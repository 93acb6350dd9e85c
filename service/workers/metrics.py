"""Metrics of worker processes: their number, their jobs and their ends."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from .pool import Pool


class WorkerMetrics(Collector):
    """Reads the pools' counters. Labels are pools, kinds of jobs, outcomes, reasons."""

    def __init__(self, pools: Mapping[str, Pool]) -> None:
        self._pools = pools

    def describe(self) -> Iterable[Metric]:
        return ()

    def collect(self) -> Iterable[Metric]:
        workers = GaugeMetricFamily(
            "dyknow_workers", "Worker processes, by pool and state", labels=["pool", "state"]
        )
        waiting = GaugeMetricFamily(
            "dyknow_workers_waiting", "Callers that wait for a worker", labels=["pool"]
        )
        ends = CounterMetricFamily(
            "dyknow_worker_ends",
            "Workers that ended during a job, by reason",
            labels=["pool", "reason"],
        )
        for name, pool in self._pools.items():
            workers.add_metric([name, "busy"], pool.busy)
            workers.add_metric([name, "idle"], pool.idle)
            waiting.add_metric([name], pool.waiting)
            for reason, count in pool.ends.items():
                ends.add_metric([name, reason], count)
        # Pools have different kinds of jobs, so no two samples have the same labels.
        (jobs, *others) = (next(iter(pool.jobs.collect())) for pool in self._pools.values())
        for other in others:
            jobs.samples.extend(other.samples)
        yield from (workers, waiting, ends, jobs)
