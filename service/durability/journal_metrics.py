"""Metrics of the data directory: durations of writes, and disk use (docs/reference/metrics.md).

Cost: some microseconds for each commit, in the journal's own thread; many requests share a commit.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import TYPE_CHECKING, Final, Protocol

from prometheus_client import CollectorRegistry, Counter, Histogram
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from ...streams.time import SECOND

if TYPE_CHECKING:
    from ...engine.durability.durable_engine import DiskUse

_COMMITS: Final = (
    *(0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005),
    *(0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5),
)
_CHECKPOINTS: Final = (0.001, 0.005, 0.01, 0.05, 0.1, 0.5, 1.0, 5.0, 10.0, 60.0)
_RECORDS: Final = (1, 2, 5, 10, 25, 50, 100, 250, 1000)
_STATE: Final = (
    ("dyknow_journal_waiting_records", "Executed commands that wait for a commit"),
    ("dyknow_journal_waiting_bytes", "Bytes of executed commands that wait for a commit"),
    ("dyknow_journal_size_bytes", "Bytes of the files of the log"),
    ("dyknow_journal_segments", "Files of the log"),
    ("dyknow_data_free_bytes", "Free bytes of the data directory's disk"),
    ("dyknow_checkpoint_size_bytes", "Bytes of the newest checkpoint"),
    ("dyknow_checkpoint_timestamp_seconds", "Time of the newest checkpoint"),
    ("dyknow_checkpoint_behind_records", "Commands that a start would replay"),
)


class JournalMetrics:
    """Metrics of commits and checkpoints, which `CommandQueue` observes."""

    def __init__(self) -> None:
        self._commit_seconds = Histogram(
            "dyknow_journal_commit_seconds",
            "Duration of a write and sync of the log",
            registry=None,
            buckets=_COMMITS,
        )
        self._commit_records = Histogram(
            "dyknow_journal_commit_records",
            "Commands that shared one write and sync",
            registry=None,
            buckets=_RECORDS,
        )
        self.written_bytes = Counter(
            "dyknow_journal_written_bytes", "Bytes written to the log", registry=None
        )
        self.commit_failures = Counter(
            "dyknow_journal_commit_failures", "Failed writes and syncs of the log", registry=None
        )
        self._checkpoint_seconds = Histogram(
            "dyknow_checkpoint_seconds",
            "Duration of a checkpoint's steps: the state, which blocks all requests, and the disk",
            ["step"],
            registry=None,
            buckets=_CHECKPOINTS,
        )
        self.checkpoint_failures = Counter(
            "dyknow_checkpoint_failures", "Failed checkpoints", registry=None
        )

    def register(self, registry: CollectorRegistry) -> None:
        """Register all metrics with ``registry``."""
        for each in (
            self._commit_seconds,
            self._commit_records,
            self.written_bytes,
            self.commit_failures,
            self._checkpoint_seconds,
            self.checkpoint_failures,
        ):
            registry.register(each)

    def observe_commit(self, seconds: float, records: int) -> None:
        """Observe one write and sync."""
        self._commit_seconds.observe(seconds)
        self._commit_records.observe(records)

    @contextmanager
    def time_step(self, step: str) -> Iterator[None]:
        """Observe a step of a checkpoint, unless it fails."""
        begun = perf_counter()
        yield
        self._checkpoint_seconds.labels(step).observe(perf_counter() - begun)


class LogCounters(Protocol):
    """The counters that `CommandQueue` has of the log."""

    @property
    def is_recording(self) -> bool:
        """Whether there is a data directory."""

    @property
    def uncommitted(self) -> tuple[int, int]:
        """The number and the bytes of records that wait for a commit."""

    @property
    def position(self) -> int:
        """The number of the last command."""


class JournalState(Collector):
    """The present state of the log. The caller sets `use` before each scrape: it needs the disk."""

    def __init__(self, queue: LogCounters) -> None:
        self.use: DiskUse | None = None
        self._queue = queue

    def describe(self) -> Iterable[Metric]:
        return ()

    def collect(self) -> Iterable[Metric]:
        values: dict[str, float] = {}
        if self._queue.is_recording:
            records, size = self._queue.uncommitted
            values["dyknow_journal_waiting_records"] = records
            values["dyknow_journal_waiting_bytes"] = size
        use = self.use
        if use is not None:
            values["dyknow_journal_size_bytes"] = use.log_bytes
            values["dyknow_journal_segments"] = use.log_files
            values["dyknow_data_free_bytes"] = use.free
            behind = self._queue.position
            if use.checkpoint is not None:
                values["dyknow_checkpoint_size_bytes"] = use.checkpoint.size
                values["dyknow_checkpoint_timestamp_seconds"] = use.checkpoint.written / SECOND
                behind = max(0, behind - use.checkpoint.position)
            values["dyknow_checkpoint_behind_records"] = behind
        for name, text in _STATE:
            family = GaugeMetricFamily(name, text)
            if name in values:
                family.add_metric([], values[name])
            yield family
