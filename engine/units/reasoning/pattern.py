"""The unit of a pattern: its matches over the streams that matching found (SPEC §8)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ....continuous.operators.background import Background
from ....converters.objects import object_in_text
from ....languages.mtl.checked import Kind
from ....rdf.dictionary import TermDictionary
from ....rdf.namespaces import DYKNOW
from ....reasoning.patterns.plans.query import END, START, Keys, PatternQuery
from ....reasoning.patterns.recognition.explanation import (
    ExplainedMatch,
    MatchedEvent,
    PartialMatches,
)
from ....reasoning.patterns.recognition.recognition import SAMPLE, STREAM, Recognition, Recognized
from ....reasoning.patterns.recognition.static_tables import StaticTables
from ....streams.generator import StreamGenerator
from ....streams.history import FluentStream
from ....streams.past_queries import Forgotten
from ....streams.sample import SampleBatch
from .match_samples import MatchWriter
from .partial_answers import partial_answers
from .row_readers import SourceInput, row_readers
from .sample_reasoner import ReportedLosses, ReportLimit, SampleReasoner


class PatternUnit(SampleReasoner):
    """Evaluates a pattern over its inputs; see `Recognition` for when a match is available.

    ``lateness`` returns how far (ns) samples of a stream may be behind later ones. ``newest``
    returns the greatest available time (ns) of the samples in streams and upstream of them; a later
    watermark comes from the clock. ``report_limit`` gets what a limit leaves out, when it first
    does.
    """

    def __init__(
        self,
        *args: Any,
        query: PatternQuery,
        inputs_of_sources: Sequence[SourceInput],
        dictionary: TermDictionary,
        lateness: Callable[[StreamGenerator], int],
        newest: Callable[[*tuple[StreamGenerator, ...]], int],
        background: Background,
        report_limit: ReportLimit,
    ) -> None:
        super().__init__(*args, newest=newest)
        self._keys = Keys()
        self._writer = MatchWriter(query, self._keys)
        self._inputs_of_sources = tuple(inputs_of_sources)
        self._lateness = [lateness(each) for each in self.sources]
        self._dictionary = dictionary
        self.query = query
        self._background = background
        self._losses = ReportedLosses(report_limit)
        self._begin()

    def _begin(self) -> None:
        self._readers = row_readers(self._inputs_of_sources, self._dictionary, self._keys)
        self.recognition = Recognition(
            self.query,
            len(self.sources),
            self._keys,
            lateness=self._lateness,
            static=StaticTables(self._background, self._keys, self.query.graphs[1]),
        )
        self.matches = 0
        """Matches that the evaluation has found by now."""

    def explain(self) -> str:
        """Describe the evaluation: the plans, and what has been done by now."""
        run = self.recognition
        rounded = run.evaluator.counters.rounded
        return "\n".join(
            [
                run.explain(),
                f"read         {self.samples:,} samples; {run.late:,} came behind later ones, and "
                "were left out",
                *explain_matches(run, self.matches),
                *([f"rounded      {rounded:,} numbers of matches or samples"] if rounded else []),
            ]
        )

    @property
    def rows_of(self) -> Mapping[str, int]:
        """The rows of each kind that came."""
        return self.recognition.rows_of

    @property
    def pending(self) -> int:
        """The number of matches that wait."""
        return self.recognition.evaluator.pending

    def partial(self, objects: Sequence[str], limit: int) -> PartialMatches:
        """Return the partial matches of all these objects (as the matches name them, or IRIs).
        Raises `PlanError` for a pattern whose partial matches are not known."""
        return partial_answers(
            self.query, self.recognition, self._keys, self._writer, objects, limit
        )

    def recall(self) -> RecalledEvents:
        """Return the retained samples that it has read, for explanations."""
        past, evicting = self._past()
        return RecalledEvents(
            self.query,
            self._inputs_of_sources,
            tuple(self._lateness),
            past,
            evicting,
            self._background,
            self._end + 1 if self.all_ended else self.least_watermark,
            self._end if self.all_ended else None,
        )

    @property
    def reasoning(self) -> Recognition:
        return self.recognition

    def _emit(self, found: Recognized) -> None:
        self._losses.report(self, self.recognition.losses())
        if not len(found):
            return
        self.matches += len(found)
        columns = self._writer.columns(found, self.output.stream.pools)
        self.output.emit(SampleBatch(self.output.stamps_at(found.available), found.valid, columns))


def explain_matches(run: Recognition, matches: int) -> Iterator[str]:
    """Describe in lines what has been found by now, and what is kept."""
    pending = run.evaluator.pending
    yield f"matches      {matches:,} by now; {pending:,} wait for what may still come"
    yield f"in memory    {run.retained:,} rows and matches"
    yield from (f"left out     {count:,} {what}" for what, count in run.losses().items())


@dataclass(frozen=True, slots=True, eq=False)
class RecalledEvents:
    """The retained samples that a pattern has read.

    It shares nothing with the unit that changes, so another thread may explain matches. ``past``:
    the samples of a stream, with its place and itself; ``evicting``: streams that have evicted
    some; ``end``: the available time (ns) at which all have ended; ``background``: the static
    triples of a pattern that may have some.
    """

    query: PatternQuery
    inputs: tuple[SourceInput, ...]
    lateness: tuple[int, ...]
    past: tuple[tuple[int, StreamGenerator, SampleBatch], ...]
    evicting: tuple[FluentStream, ...]
    background: Background | None
    watermark: int | None
    end: int | None

    def explain(self, objects: Sequence[str], start: int) -> tuple[ExplainedMatch, ...]:
        """Explain the matches of these objects (as the matches name them, or IRIs) that start at
        ``start`` (ns), or are valid then.

        Raises `Forgotten` if there is none and a stream has evicted samples. Cost: the evaluation
        of all retained samples.
        """
        keys = Keys()
        writer = MatchWriter(self.query, keys)
        run = Recognition(
            self.query,
            len(self.lateness),
            keys,
            lateness=self.lateness,
            keeps_places=True,
            static=None
            if self.background is None
            else StaticTables(self.background, keys, self.query.graphs[1]),
        )
        readers = row_readers(self.inputs, TermDictionary(), keys)
        for place, source, batch in self.past:
            run.came(place, batch.available, batch.valid)
            for reader in readers.get(source, ()):
                reader.read(batch, place, run)
        found = [] if self.watermark is None else [run.advance(self.watermark)]
        if self.end is not None:
            found.append(run.finish(self.end))
        names = [each.name for each in self.query.results if each.kind is Kind.OBJECT]
        wanted = dict(zip(names, (object_in_text(each, DYKNOW) for each in objects), strict=False))
        explained = []
        for part in found:
            for match in range(len(part)):
                values = writer.values(part, match)
                of_objects = {name: object_in_text(str(values[name]), DYKNOW) for name in wanted}
                times = int(part.outputs[START][match]), int(part.valid[match])
                if start in times and of_objects == wanted:
                    explained.append(self._explained(run, part, match, values))
        if not explained and self.evicting:
            raise Forgotten(self.evicting[0])
        return tuple(explained)

    def _explained(
        self, run: Recognition, part: Recognized, match: int, values: dict[str, Any]
    ) -> ExplainedMatch:
        samples = {place: (source, batch) for place, source, batch in self.past}
        places = run.places()
        events = []
        for element, row in zip(run.plans[0].elements, part.rows[match].tolist(), strict=False):
            source, batch = samples[int(places[row, STREAM])]
            sample = int(places[row, SAMPLE])
            events.append(
                MatchedEvent(
                    element.name,
                    source.name,
                    int(batch.available[sample]),
                    int(batch.valid[sample]),
                    batch.values_at(sample),
                )
            )
        return ExplainedMatch(
            int(part.available[match]),
            int(part.valid[match]),
            int(part.outputs[START][match]),
            int(part.outputs[END][match]),
            values,
            tuple(events),
        )
