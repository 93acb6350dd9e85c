"""Requests of one pattern template that differ in an object, evaluated as one (SPEC §8)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....rdf.dictionary import TermDictionary
from ....reasoning.patterns.plans.by_object import PART, PatternByObject
from ....reasoning.patterns.plans.query import Keys, PatternQuery, object_key
from ....reasoning.patterns.recognition.part_recognition import PartRecognition
from ....reasoning.patterns.recognition.recognition import Recognized
from ....streams.generator import StreamGenerator
from ....streams.sample import SampleBatch
from ....streams.time import TIME_MAX, TIME_MIN
from ..merge import ObjectCodes, ObjectName
from ..reasoning.match_samples import MatchWriter
from ..reasoning.pattern import RecalledEvents
from ..reasoning.row_readers import SourceInput, row_readers
from ..reasoning.sample_reasoner import ReportedLosses, ReportLimit, SampleReasoner
from .instances import InstanceUnit, SharingUnit

Parts = NDArray[np.int64]


class ObjectParts:
    """The parts of the objects that instances ask for, by IRI."""

    def __init__(self) -> None:
        self._parts: dict[str, int] = {}

    def __contains__(self, iri: str) -> bool:
        return iri in self._parts

    def add(self, iri: str, part: int) -> None:
        """Let the samples of an object belong to a part from now on."""
        self._parts[iri] = part

    def remove(self, part: int) -> None:
        """Ask for the object of a part no longer."""
        self._parts = {iri: each for iri, each in self._parts.items() if each != part}

    def part(self, iri: str) -> int:
        """Return the part of an object. Contract: it is asked for."""
        return self._parts[iri]


class SharedPatternUnit(SharingUnit["PatternInstance"], SampleReasoner):
    """Evaluates a pattern for each of the objects that its instances ask for.

    Law (tests/laws/engine/test_shared_patterns.py): the samples of an instance, and their available
    times, are those of a `PatternUnit` of its own over the object's samples.

    Cost: that of one pattern over the samples of these objects, and some 50 µs for each instance
    with matches in a batch. An instance without matches costs nothing. Memory: that of one pattern,
    and some 100 bytes for each instance that there was, until the last one leaves.

    ``objects`` name the object in the samples of each source.
    """

    results = "matches"

    def __init__(
        self,
        *args: Any,
        pattern: PatternByObject,
        inputs_of_sources: Sequence[SourceInput],
        objects: Mapping[StreamGenerator, ObjectName],
        dictionary: TermDictionary,
        lateness: Callable[[StreamGenerator], int],
        newest: Callable[[*tuple[StreamGenerator, ...]], int],
        report_limit: ReportLimit,
    ) -> None:
        super().__init__(*args, newest=newest)
        self.pattern = pattern
        self._inputs_of_sources = tuple(inputs_of_sources)
        self._lateness = tuple(lateness(each) for each in self.sources)
        self.keys = Keys()
        self.recognition = PartRecognition(
            pattern,
            len(self.sources),
            self.keys,
            lateness=self._lateness,
        )
        self.matches = 0
        """Matches found by now."""
        self._losses = ReportedLosses(report_limit)
        self._parts = ObjectParts()
        self._readers = row_readers(inputs_of_sources, dictionary, self.keys, pattern.column)
        self._coders = {
            source: ObjectCodes(name, dictionary, self._parts.part, self._parts.__contains__)
            for source, name in objects.items()
        }

    def explain(self) -> str:
        """Describe the evaluation: the plan, and what has been done by now."""
        run = self.recognition
        return "\n".join(
            [
                run.explain(),
                f"shared by    {len(self._instances):,} requests, each for an object of its own",
                f"read         {self.samples:,} samples of their objects",
                f"matches      {self.matches:,} by now; {run.evaluator.pending:,} wait for what "
                "may still come",
                f"in memory    {run.retained:,} rows and matches",
                *(f"left out     {count:,} {what}" for what, count in run.losses().items()),
            ]
        )

    @property
    def reasoning(self) -> PartRecognition:
        return self.recognition

    # -- instances ---------------------------------------------------------------------------

    def enter(self, object: str) -> int:
        """Evaluate the pattern for ``object`` (an IRI) from now on; return its number. Contract: no
        other instance asks for it."""
        part = self.recognition.add_part()
        self._parts.add(object, part)
        self._refresh_objects()
        return part

    def forget(self, number: int) -> None:
        self._parts.remove(number)
        self._refresh_objects()
        self.recognition.end_part(number)

    def can_enter(self, object: str) -> bool:
        """Whether an instance for an object would be as a unit of its own. It would not if another
        one asks for the object, or if this unit did not wait for an input that has gone on since:
        samples may be late for it that come in time for a new unit."""
        return object not in self._parts and all(
            source.is_idle or self._watermarks.get(source, TIME_MIN) <= _watermark_of(source)
            for source in self.sources
        )

    def recall(self, number: int, since: Mapping[StreamGenerator, int]) -> RecalledEvents:
        """Return the retained samples of an instance's object, for explanations; of each stream
        those after the available time (ns) ``since``."""
        past, evicting = self._past()
        own = []
        for place, source, batch in past:
            parts, asked = self._asked_for(source, batch)
            rows = (parts == number) & (asked.available > since.get(source, TIME_MIN))
            own.append((place, source, asked.take(rows)))
        return RecalledEvents(
            self.pattern.query,
            self._inputs_of_sources,
            self._lateness,
            tuple(own),
            evicting,
            None,
            self._end + 1 if self.all_ended else self.least_watermark,
            self._end if self.all_ended else None,
        )

    def _refresh_objects(self) -> None:
        for coder in self._coders.values():
            coder.refresh()

    # -- samples -----------------------------------------------------------------------------

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        self._first.setdefault(source, int(batch.available[0]))
        parts, batch = self._asked_for(source, batch)
        if not len(batch):
            return
        self.samples += len(batch)
        place = self.sources.index(source)
        self.recognition.came_in_parts(place, batch.available, batch.valid, parts)
        for reader in self._readers[source]:
            reader.read(batch, place, self.recognition, parts)

    def in_time(self, source: StreamGenerator, batch: SampleBatch, decided: int) -> SampleBatch:
        if batch.available[0] > decided:
            return batch
        # Samples of other objects are late for no instance.
        parts, late = self._asked_for(source, batch.take(batch.available <= decided))
        self.late += len(late)
        self._count_late(np.bincount(parts))
        if source in self.late_streams:
            self.emit_late(self.late_streams[source], late, decided)
        for instance, side in self._late_of_instances.get(source, {}).items():
            self.emit_late(side, late.take(parts == instance.number), decided)
        return batch.take(batch.available > decided)

    def progress(self, source: StreamGenerator, watermark: int) -> None:
        super().progress(source, watermark)
        self.promise_to_followed()

    def ended(self, source: StreamGenerator) -> None:
        # As a unit that selects an object's samples ends its stream: after the last one it read.
        last = source.stream.last_available
        if source in self._first and last is not None:
            self.advance(source, min(last, TIME_MAX - 1) + 1)
        super().ended(source)

    def resume(self, source: StreamGenerator) -> None:
        super().resume(source)
        self.recognition.resumed(self.sources.index(source))

    def _advance(self, watermark: int, *, by_clock: bool = False) -> None:
        before = self.recognition.late_of.copy()
        super()._advance(watermark, by_clock=by_clock)
        self._count_late(self.recognition.late_of[: len(before)] - before)

    def _count_late(self, late_of: NDArray[np.int64]) -> None:
        """Count the late samples of each part."""
        for part in np.flatnonzero(late_of).tolist():
            instance = self._instances.get(part)
            if instance is not None:
                instance.late += int(late_of[part])

    def _asked_for(self, source: StreamGenerator, batch: SampleBatch) -> tuple[Parts, SampleBatch]:
        """The samples of the objects that instances ask for, with their parts."""
        parts, is_wanted = self._coders[source].encode(batch)
        if is_wanted.all():
            return parts.astype(np.int64), batch
        return parts[is_wanted].astype(np.int64), batch.take(is_wanted)

    # -- matches -----------------------------------------------------------------------------

    def _emit(self, found: Recognized) -> None:
        self._losses.report(self, self.recognition.losses())
        if not len(found):
            return
        self.matches += len(found)
        parts = found.outputs[PART]
        # Stable: the matches of an instance stay in their order.
        order = np.argsort(parts, kind="stable")
        numbers, starts = np.unique(parts[order], return_index=True)
        for number, rows in zip(numbers.tolist(), np.split(order, starts[1:]), strict=True):
            instance = self._instances[number]
            self.promise_to(instance)
            instance.emit(self._of_instance(found, rows, instance))
        (available,) = self.output.stamps_at(found.available.max(keepdims=True))
        self.emit_tally(int(available), int(found.valid.max()), len(numbers))

    def _of_instance(
        self, found: Recognized, rows: NDArray[np.int64], instance: PatternInstance
    ) -> Recognized:
        """The matches of an instance, with its object in place of the number of its part."""
        outputs = {name: values[rows] for name, values in found.outputs.items()}
        for name in self.pattern.objects:
            outputs[name] = np.full(len(rows), instance.key, np.int64)
        return Recognized(found.available[rows], found.valid[rows], outputs, found.rows[rows])


class PatternInstance(InstanceUnit):
    """Emits the matches of one ``object`` (an IRI). ``query``: the pattern of this object."""

    def __init__(
        self, *args: Any, template: SharedPatternUnit, object: str, query: PatternQuery
    ) -> None:
        super().__init__(
            *args,
            template=template,
            enter=lambda: template.enter(object),
            evaluation=template.explain,
        )
        self.query = query
        self._since: dict[StreamGenerator, int] = {}
        """The last available time (ns) of each stream whose samples it has not read."""
        self.key = template.keys.number(object_key(object))
        """The number of its object."""
        self.matches = 0
        """Matches found by now."""
        self._writer = MatchWriter(query, template.keys)

    @property
    def template(self) -> SharedPatternUnit:
        """The unit that evaluates this pattern together with others."""
        assert isinstance(self._template, SharedPatternUnit)
        return self._template

    def connect(self, source: StreamGenerator) -> None:
        super().connect(source)
        for each in self.template.sources:
            if each.stream.last_available is not None:
                self._since[each] = each.stream.last_available

    def recall(self) -> RecalledEvents:
        """Return the retained samples that it has read, for explanations."""
        assert self.number is not None
        return self.template.recall(self.number, self._since)

    @property
    def samples(self) -> int:
        """Samples of the object that were read by now."""
        return 0 if self.number is None else int(self.template.recognition.samples_of[self.number])

    @property
    def rows_of(self) -> Mapping[str, int]:
        """The rows of each kind that came."""
        return {} if self.number is None else self.template.recognition.rows_of_part(self.number)

    @property
    def pending(self) -> int:
        """The number of matches that wait."""
        run = self.template.recognition
        return 0 if self.number is None else run.evaluator.pending_of(self.number)

    def emit(self, found: Recognized) -> None:
        """Emit its next matches."""
        self.matches += len(found)
        self._guarded(lambda: self._emit(found))

    def _emit(self, found: Recognized) -> None:
        columns = self._writer.columns(found, self.output.stream.pools)
        self.output.emit(SampleBatch(self.output.stamps_at(found.available), found.valid, columns))


def _watermark_of(source: StreamGenerator) -> int:
    return TIME_MIN if source.watermark is None else source.watermark
