"""What the units of formulas and patterns share: samples in, decided results out."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Protocol, TypeAlias

from ....streams.generator import StreamGenerator
from ....streams.history import FluentStream
from ....streams.sample import SampleBatch, Times
from ....streams.time import TIME_MAX, TIME_MIN
from ..base import ComputationalUnit


class Reasoning(Protocol):
    """An evaluation over the samples of several streams, numbered from 0."""

    @property
    def late(self) -> int: ...
    def came(self, source: int, available: Times, valid: Times, /) -> None: ...
    def ended(self, source: int, moment: int, /) -> None: ...
    def set_idle(self, sources: Iterable[int], /) -> None: ...
    def advance(self, watermark: int, *, by_clock: bool = False) -> Any: ...
    def finish(self, moment: int, /) -> Any: ...


ReportLimit: TypeAlias = Callable[[ComputationalUnit, str], None]
"""Reports what a limit has left out, with its unit."""


class ReportedLosses:
    """Reports what limits leave out, each kind when it is first left out."""

    def __init__(self, report: ReportLimit) -> None:
        self._report = report
        self._reported: set[str] = set()

    def report(self, unit: ComputationalUnit, losses: Iterable[str]) -> None:
        """Report the ``losses`` that are new."""
        for what in losses:
            if what not in self._reported:
                self._reported.add(what)
                self._report(unit, f"left out: {what}")


class SampleReasoner(ComputationalUnit):
    """Gives the samples of its inputs to an evaluation, and emits what that decides.

    The end of all inputs decides everything. If one goes on, a new evaluation begins: its results
    are those of a unit that starts then.

    ``newest`` returns the greatest available time (ns) of the samples in streams and upstream of
    them; a later watermark comes from the clock.
    """

    def __init__(self, *args: Any, newest: Callable[[*tuple[StreamGenerator, ...]], int]) -> None:
        super().__init__(*args)
        self._newest = newest
        self.samples = 0
        """Samples that the evaluation has read by now."""
        self._first: dict[StreamGenerator, int] = {}
        """The available time (ns) of the first sample read of each input."""
        self._readers: Mapping[StreamGenerator, Sequence[Any]] = {}
        """Readers of each input's samples, for the evaluation."""
        self._advanced = TIME_MIN
        """The watermark that the evaluation has reached."""
        self.went_on = False
        """Whether inputs went on after the end of all, so that a new evaluation began."""

    @property
    @abstractmethod
    def reasoning(self) -> Reasoning:
        """The evaluation."""

    @abstractmethod
    def _begin(self) -> None:
        """Make a new evaluation, and new readers for it."""

    @abstractmethod
    def _emit(self, found: Any) -> None:
        """Emit what was decided."""

    @property
    def reads(self) -> Sequence[StreamGenerator]:
        """The streams that it reads."""
        return self.inputs

    def receive(self, source: StreamGenerator, batch: SampleBatch) -> None:
        if self.output.is_ended and self.failure is None:
            # Another version has restored the ends of streams, of which it does not tell units.
            self.resumed(source)
        super().receive(source, batch)

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        self.samples += len(batch)
        self._first.setdefault(source, int(batch.available[0]))
        place = self.sources.index(source)
        self.reasoning.came(place, batch.available, batch.valid)
        for reader in self._readers[source]:
            reader.read(batch, place, self.reasoning)

    def progress(self, source: StreamGenerator, watermark: int) -> None:
        least = self.least_watermark
        if least is None or self.output.is_ended:
            return
        self.reasoning.set_idle(i for i, each in enumerate(self.sources) if each.is_idle)
        newest = self._newest_of(*self.sources)
        by_clock = is_by_clock(least, newest)
        self._advance(least, by_clock=by_clock)
        if self._is_over:
            self._leave_inputs()
            self.output.end()
        else:
            # The end is at the newest sample, and may follow.
            self.output.advance(least if by_clock else min(least, newest))

    @property
    def _is_over(self) -> bool:
        """Whether no result can follow, so that the output ends before its inputs."""
        return False

    @property
    def is_finished(self) -> bool:
        """Whether no result can follow the end, even if inputs go on after it."""
        return False

    def resume(self, source: StreamGenerator) -> None:
        super().resume(source)
        # The others may have gone on meanwhile: what comes before what they reached is late.
        known = self._watermarks.get(source, TIME_MIN)
        if self._advanced > known:
            self._watermarks[source] = self._advanced
        if self.output.is_ended:
            self._begin_again()

    def _begin_again(self) -> None:
        """Begin a new evaluation, without the samples before the end."""
        self.went_on = True
        self.samples = 0
        self._first.clear()
        # It may have gone past idle streams. Samples at the time of the end are late.
        self._watermarks = self.watermarks_if_new()
        for source, watermark in self._watermarks.items():
            self._watermarks[source] = max(watermark, end_of(source))
        self._begin()
        for place, source in enumerate(self.sources):
            if source.is_ended:
                self._ended.add(source)
                self.reasoning.ended(place, self._newest_of(source))

    def finish(self, source: StreamGenerator) -> None:
        if self.output.is_ended:
            return
        self.reasoning.ended(self.sources.index(source), self._newest_of(source))
        if self.all_ended:
            self._advance(self._end + 1)
            self._emit(self.reasoning.finish(self._end))
            if self.is_finished:
                self._until = self._end
                self._leave_inputs()
        super().finish(source)

    def _past(
        self,
    ) -> tuple[tuple[tuple[int, StreamGenerator, SampleBatch], ...], tuple[FluentStream, ...]]:
        """The retained samples that it has read, each with its place and stream; and the streams
        that have evicted some."""
        past, evicting = [], []
        for place, source in enumerate(self.sources):
            first, batch = self._first.get(source), self.past_of(source)
            if first is None:
                continue
            batch = batch.take(batch.available >= first)
            if not len(batch) or int(batch.available[0]) > first:
                evicting.append(source.stream)
            if len(batch):
                past.append((place, source, batch))
        return tuple(past), tuple(evicting)

    @property
    def _end(self) -> int:
        """The available time (ns) of the end of all inputs, whichever of them ended first."""
        return min(self._newest_of(*self.sources), TIME_MAX - 1)

    def _newest_of(self, *sources: StreamGenerator) -> int:
        """The greatest available time (ns) of the samples for it, and of those upstream."""
        newest = self._newest(*sources)
        return newest if self._until is None else min(newest, self._until)

    def _advance(self, watermark: int, *, by_clock: bool = False) -> None:
        before = self.reasoning.late
        self._advanced = max(self._advanced, watermark)
        self._emit(self.reasoning.advance(watermark, by_clock=by_clock))
        # Beside the samples that were late for the unit itself.
        self.late += self.reasoning.late - before


def end_of(source: StreamGenerator) -> int:
    """The watermark with which a unit that selects samples ends its stream: after the newest
    one."""
    last = source.stream.last_available
    return TIME_MIN if last is None else min(last, TIME_MAX - 1) + 1


def is_by_clock(watermark: int, newest: int) -> bool:
    """Whether the clock has brought the watermark of streams whose newest sample is available at
    ``newest`` (ns)."""
    # After a sample of time t the watermark of a stream is t or t + 1.
    return watermark > newest + 1
