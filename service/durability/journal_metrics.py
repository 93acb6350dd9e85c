"""Metrics of the data directory: what writing takes, and what is on the disk
(docs/reference/metrics.md).

Cost: some microseconds a commit, of which many requests share one, in the journal's own thread.
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
    ("dyknow_journal_waiting_records", "Commands that are done and wait to be kept"),
    ("dyknow_journal_waiting_bytes", "Bytes of them"),
    ("dyknow_journal_size_bytes", "Bytes of the files of the log"),
    ("dyknow_journal_segments", "Files of the log"),
    ("dyknow_data_free_bytes", "Bytes that the disk of the data directory has room for"),
    ("dyknow_checkpoint_size_bytes", "Bytes of the newest checkpoint"),
    ("dyknow_checkpoint_timestamp_seconds", "When the newest checkpoint was written"),
    ("dyknow_checkpoint_behind_records", "Commands that a start would do again"),
)


class JournalTimes:
    """What the keeper notes while it writes; nothing without a data directory."""

    def __init__(self) -> None:
        self._commit_seconds = Histogram(
            "dyknow_journal_commit_seconds",
            "How long it took to write and sync the log",
            registry=None,
            buckets=_COMMITS,
        )
        self._commit_records = Histogram(
            "dyknow_journal_commit_records",
            "Commands that shared one write and sync",
            registry=None,
            buckets=_RECORDS,
        )
        self.committed = Counter(
            "dyknow_journal_written_bytes", "Bytes that were written to the log", registry=None
        )
        self.commit_failures = Counter(
            "dyknow_journal_commit_failures", "Writes and syncs that failed", registry=None
        )
        self._checkpoint_seconds = Histogram(
            "dyknow_checkpoint_seconds",
            "How long a checkpoint took: the state, for which everybody waits, and the disk",
            ["step"],
            registry=None,
            buckets=_CHECKPOINTS,
        )
        self.checkpoint_failures = Counter(
            "dyknow_checkpoint_failures", "Checkpoints that could not be written", registry=None
        )

    def register(self, registry: CollectorRegistry) -> None:
        """Let ``registry`` tell of it."""
        for each in (
            self._commit_seconds,
            self._commit_records,
            self.committed,
            self.commit_failures,
            self._checkpoint_seconds,
            self.checkpoint_failures,
        ):
            registry.register(each)

    def commit(self, seconds: float, records: int) -> None:
        """One write and sync."""
        self._commit_seconds.observe(seconds)
        self._commit_records.observe(records)

    @contextmanager
    def step(self, step: str) -> Iterator[None]:
        """A step of a checkpoint; one that fails counts nothing here."""
        begun = perf_counter()
        yield
        self._checkpoint_seconds.labels(step).observe(perf_counter() - begun)


class Recorder(Protocol):
    """Who records commands: what of it is told (`Keeper`)."""

    @property
    def is_recording(self) -> bool:
        """Whether there is a data directory."""

    @property
    def waiting(self) -> tuple[int, int]:
        """Records, and bytes of them, that wait to be written."""

    @property
    def position(self) -> int:
        """The number of the last command."""


class JournalState(Collector):
    """What there is now: `use` is looked up before each scrape, since it waits for the disk."""

    def __init__(self, recorder: Recorder) -> None:
        self.use: DiskUse | None = None
        self._recorder = recorder

    def describe(self) -> Iterable[Metric]:
        return ()

    def collect(self) -> Iterable[Metric]:
        values: dict[str, float] = {}
        if self._recorder.is_recording:
            records, size = self._recorder.waiting
            values["dyknow_journal_waiting_records"] = records
            values["dyknow_journal_waiting_bytes"] = size
        use = self.use
        if use is not None:
            values["dyknow_journal_size_bytes"] = use.log_bytes
            values["dyknow_journal_segments"] = use.log_files
            values["dyknow_data_free_bytes"] = use.free
            behind = self._recorder.position
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
