"""The unit of a monitor: verdicts of a formula over the streams that matching found (SPEC §8)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ....converters.objects import object_in_text
from ....languages.mtl.ast import Monitor
from ....languages.mtl.checked import CheckedMonitor
from ....rdf.dictionary import TermDictionary
from ....rdf.namespaces import DYKNOW
from ....reasoning.mtl.explanation import Explanation, NoStart, explain_verdict
from ....reasoning.mtl.formulas import bound_sorts
from ....reasoning.mtl.monitoring import Monitoring, Reported
from ....streams.generator import StreamGenerator
from ....streams.history import FluentStream
from ....streams.past_queries import Forgotten
from ....streams.sample import SampleBatch
from .sample_reasoner import SampleReasoner, is_by_clock
from .term_readers import TermInput, term_readers
from .verdict_samples import VerdictWriter


class MonitorUnit(SampleReasoner):
    """Evaluates a monitor over its inputs.

    A verdict is valid at its start, and available when the state that decides it leaves: under
    ``max delay`` that long after the state's time, otherwise with the sample that shows that later
    samples are valid later. ``newest`` returns the greatest available time (ns) of the samples in
    streams and upstream of them; a later watermark comes from the clock.

    Law (tests/laws/reasoning): the verdicts do not depend on batch cuts. Cost: see `Monitoring`.
    """

    def __init__(
        self,
        *args: Any,
        monitor: CheckedMonitor,
        terms: Sequence[TermInput],
        dictionary: TermDictionary,
        wider: Mapping[str, Sequence[str]],
        text: Monitor,
        explanation: str,
        newest: Callable[[*tuple[StreamGenerator, ...]], int],
    ) -> None:
        super().__init__(*args, newest=newest)
        self.monitor = monitor
        self.text = text
        self._explanation = explanation
        self._wider = wider
        self._terms = terms
        self._dictionary = dictionary
        self._writer = VerdictWriter(monitor)
        self._started: frozenset[str] = frozenset()
        """The objects whose single start an end has decided."""
        self._begin()

    def _begin(self) -> None:
        self.monitoring = Monitoring(
            self.monitor, len(self.sources), self._wider, without=self._started
        )
        self._readers = term_readers(self._terms, self._dictionary)

    def _begin_again(self) -> None:
        if self.monitor.once:
            self._started |= self.monitoring.started
        super()._begin_again()

    def explain(self) -> str:
        """Describe the evaluation: the formula, its states by now, and the verdicts."""
        return "\n".join([self._explanation, *explain_verdicts(self.monitoring, self.samples)])

    def recall(self) -> RecalledSamples:
        """Return the retained samples that it has read, for explanations."""
        past, evicting = self._past()
        watermark = self._end + 1 if self.all_ended else self.least_watermark
        newest = self._newest_of(*self.sources)
        return RecalledSamples(
            self.monitor,
            self.text,
            tuple(self._terms),
            self._wider,
            self.monitoring.grid,
            len(self.sources),
            past,
            evicting,
            {self.sources.index(source): self._newest_of(source) for source in self._ended},
            self._end if self.all_ended else None,
            watermark,
            watermark is not None and not self.all_ended and is_by_clock(watermark, newest),
        )

    @property
    def reasoning(self) -> Monitoring:
        return self.monitoring

    @property
    def _is_over(self) -> bool:
        return self.monitoring.is_over

    @property
    def is_finished(self) -> bool:
        # The end has decided its single start, and no further object can have one.
        can_follow = self.monitoring.has_own_states and not self.monitor.fixed
        return self.monitor.once and self.monitoring.states > 0 and not can_follow

    def _emit(self, found: Reported) -> None:
        if not len(found):
            return
        columns = self._writer.columns(found, found.objects, self.output.stream.pools)
        self.output.emit(SampleBatch(self.output.stamps_at(found.available), found.valid, columns))


def explain_verdicts(run: Monitoring, samples: int) -> Iterator[str]:
    """Describe in lines the states and verdicts by now."""
    verdicts = ", ".join(f"{count:,} {word}" for word, count in run.verdicts.items())
    yield (
        f"states       {run.states:,} by now, of {samples:,} samples; {run.late:,} samples"
        " came after the state of their time had left"
    )
    yield f"verdicts     {verdicts}"
    yield f"in memory    {run.retained:,} samples and states"
    yield f"evaluated    {run.way}"


@dataclass(frozen=True, slots=True, eq=False)
class RecalledSamples:
    """The retained samples that a monitor has read, and all that its verdicts follow from.

    It shares nothing with the monitor that changes, so another thread may explain verdicts.
    ``past``: the samples of a stream, with its place and itself; ``evicting``: streams that have
    evicted some; ``ended``: when streams have ended, by their places; ``end``: when all have.
    """

    monitor: CheckedMonitor
    text: Monitor
    terms: tuple[TermInput, ...]
    wider: Mapping[str, Sequence[str]]
    grid: int | None
    sources: int
    past: tuple[tuple[int, StreamGenerator, SampleBatch], ...]
    evicting: tuple[FluentStream, ...]
    ended: Mapping[int, int]
    end: int | None
    watermark: int | None
    by_clock: bool

    def explain(self, objects: Sequence[str], start: int) -> Explanation:
        """Explain the verdict of these objects (as the verdicts name them, or IRIs) that starts at
        ``start`` (ns).

        Raises `NoStart`, `TooManyStates`, and `Forgotten` if a stream has evicted samples that the
        states may need: those before the first state left, for a value that is not known there, or
        for a quantifier. Cost: the evaluation of all states of these samples; those of the object
        where each has its own.
        """
        iris = [object_in_text(name, DYKNOW) for name in objects]
        run = self._run(iris)
        states = run.states_of(iris)
        if states is None:
            whose = f" of {', '.join(objects)}" if run.has_own_states else ""
            raise NoStart(f"there is no state{whose} yet")
        if self.evicting and (start < int(states.valid[0]) or bound_sorts(self.monitor.formula)):
            raise Forgotten(self.evicting[0])
        found = explain_verdict(self.monitor, self.text, states, start, iris)
        if self.evicting and (
            found.valid[0] == states.valid[0]
            or any(each.values[0] is None for each in found.features)
        ):
            # An evicted sample may have the value, or make a state before.
            raise Forgotten(self.evicting[0])
        return found

    def _run(self, iris: Sequence[str]) -> Monitoring:
        """Make the states again."""
        run = Monitoring(
            self.monitor, self.sources, self.wider, decides=False, grid=self.grid, only=iris
        )
        readers = term_readers(self.terms, TermDictionary())
        for place, source, batch in self.past:
            run.came(place, batch.available, batch.valid)
            for reader in readers[source]:
                reader.read(batch, place, run)
        for place, moment in self.ended.items():
            run.ended(place, moment)
        if self.watermark is not None:
            run.advance(self.watermark, by_clock=self.by_clock)
        if self.end is not None:
            run.finish(self.end)
        return run
