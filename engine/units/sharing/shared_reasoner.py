"""Requests of one template about an object each, evaluated as one (SPEC §8): what formulas and
patterns have in common."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ....rdf.dictionary import TermDictionary
from ....streams.generator import StreamGenerator
from ....streams.sample import SampleBatch, Times
from ....streams.time import TIME_MIN
from ..merge import ObjectCodes, ObjectName
from ..reasoning.sample_reasoner import Reasoning, SampleReasoner, end_of
from .instances import InstanceUnit, SharingUnit

Parts = NDArray[np.int64]
Rows = NDArray[np.int64]


class PartReasoning(Reasoning, Protocol):
    """An evaluation of parts, each by its own samples."""

    @property
    def late_of(self) -> NDArray[np.int64]: ...
    @property
    def samples_of(self) -> NDArray[np.int64]: ...
    def end_part(self, part: int, /) -> None: ...
    def came_in_parts(
        self, stream: int, available: Times, valid: Times, part: Parts, /
    ) -> None: ...
    def resumed(self, stream: int, /) -> None: ...


class ObjectParts:
    """The parts of the objects that instances ask for, by IRI. Several may be of one object."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}
        self._parts: list[list[int]] = []
        """The parts of each object, by its number."""
        self._object_of: dict[int, int] = {}
        """The number of each part's object."""
        self._table: tuple[Rows, Rows, Parts] | None = None
        """For each object the number of its parts, and its place among the parts of all."""

    def __contains__(self, iri: str) -> bool:
        return iri in self._numbers and bool(self._parts[self._numbers[iri]])

    def add(self, iri: str, part: int) -> None:
        """Let the samples of an object belong to a part from now on."""
        number = self._numbers.setdefault(iri, len(self._parts))
        if number == len(self._parts):
            self._parts.append([])
        self._parts[number].append(part)
        self._object_of[part] = number
        self._table = None

    def remove(self, part: int) -> None:
        """Ask for the object of a part no longer."""
        self._parts[self._object_of.pop(part)].remove(part)
        self._table = None

    def number(self, iri: str) -> int:
        """Return the number of an object. Contract: it is asked for."""
        return self._numbers[iri]

    def of(self, objects: Rows) -> tuple[Rows, Parts]:
        """Return a row for each part of the objects with these numbers, and the part; in order of
        the rows."""
        if self._table is None:
            counts = np.array([len(parts) for parts in self._parts], np.int64)
            flat = np.array([part for parts in self._parts for part in parts], np.int64)
            self._table = counts, np.cumsum(counts) - counts, flat
        counts, first, flat = self._table
        count = counts[objects]
        rows = np.repeat(np.arange(len(objects)), count)
        place = np.arange(len(rows)) - np.repeat(np.cumsum(count) - count, count)
        return rows, flat[first[objects[rows]] + place]


class ReasoningInstance(InstanceUnit):
    """Emits the results of one ``object`` (an IRI). ``enter`` adds it to the evaluation."""

    def __init__(
        self,
        *args: Any,
        template: SharedReasoner[Any],
        object: str,
        enter: Callable[[], int],
    ) -> None:
        super().__init__(*args, template=template, enter=enter, evaluation=template.explain)
        self.object = object
        self._shared = template
        self._since: dict[StreamGenerator, int] = {}
        """The last available time (ns) of each stream whose samples it has not read."""
        self._samples = 0
        """The samples that were read when it left."""

    def enter(self) -> None:
        super().enter()
        for each in self._shared.sources:
            if each.stream.last_available is not None:
                self._since[each] = each.stream.last_available

    @property
    def went_on(self) -> bool:
        """Whether inputs went on after the end of all, so that a new evaluation began."""
        return self._shared.went_on

    @property
    def is_finished(self) -> bool:
        """Whether no result can follow the end, even if inputs go on after it."""
        return False

    @property
    def samples(self) -> int:
        """Samples of the object that were read by now."""
        if self.number is None:
            return self._samples
        return int(self._shared.reasoning.samples_of[self.number])

    def leave(self, *, forgets: bool = True) -> None:
        self._samples = self.samples
        super().leave(forgets=forgets)

    def emit(self, found: Any) -> None:
        """Emit its next results."""
        self._guarded(lambda: self._emit(found))

    @abstractmethod
    def _emit(self, found: Any) -> None: ...


Instance = TypeVar("Instance", bound=ReasoningInstance)


class SharedReasoner(SharingUnit[Instance], SampleReasoner, Generic[Instance]):
    """Evaluates a formula or pattern for each of the objects that its instances ask for.

    Law (tests/laws/engine/test_shared_reasoning.py): the samples of an instance, and their
    available times, are those of a unit of its own over the object's samples.

    Cost: that of one evaluation over the samples of these objects, and some 50 µs for each instance
    with results in a batch. An instance without results costs nothing. Memory: that of one
    evaluation, and some 100 bytes for each instance that there was, until the last one leaves.

    ``objects`` name the object in the samples of each source.
    """

    def __init__(
        self,
        *args: Any,
        objects: Mapping[StreamGenerator, ObjectName],
        dictionary: TermDictionary,
        newest: Callable[[*tuple[StreamGenerator, ...]], int],
    ) -> None:
        super().__init__(*args, newest=newest)
        self._dictionary = dictionary
        self._parts = ObjectParts()
        self._coders = {
            source: ObjectCodes(name, dictionary, self._parts.number, self._parts.__contains__)
            for source, name in objects.items()
        }

    @property
    @abstractmethod
    def reasoning(self) -> PartReasoning:
        """The evaluation."""

    @abstractmethod
    def explain(self) -> str:
        """Describe the evaluation, and what has been done by now."""

    def _explain(self, evaluation: str, *more: str) -> str:
        """Describe the evaluation, and what has been done by now."""
        shared = f"shared by    {len(self._instances):,} requests that name an object each"
        return "\n".join(
            [evaluation, shared, f"read         {self.samples:,} samples of their objects", *more]
        )

    # -- instances ---------------------------------------------------------------------------

    def ask_for(self, object: str, part: int) -> int:
        """Let the samples of ``object`` (an IRI) belong to a new part; return it."""
        self._parts.add(object, part)
        self._refresh_objects()
        return part

    def forget(self, number: int) -> None:
        self._parts.remove(number)
        self._refresh_objects()
        self.reasoning.end_part(number)

    @property
    def can_enter(self) -> bool:
        """Whether a new instance would be as a unit of its own. It would not if this unit did not
        wait for an input that has gone on since: samples may be late for it that come in time for a
        new unit."""
        fresh = self.watermarks_if_new()
        return all(time <= fresh.get(each, TIME_MIN) for each, time in self._watermarks.items())

    def past_of_part(
        self, number: int, since: Mapping[StreamGenerator, int]
    ) -> tuple[tuple[tuple[int, StreamGenerator, SampleBatch], ...], Any]:
        """Return the retained samples of a part's object, as `_past` does; of each stream those
        after the available time (ns) ``since``."""
        past, evicting = self._past()
        own = []
        for place, source, batch in past:
            parts, asked = self._asked_for(source, batch)
            rows = (parts == number) & (asked.available > since.get(source, TIME_MIN))
            own.append((place, source, asked.take(rows)))
        return tuple(own), evicting

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
        self.reasoning.came_in_parts(place, batch.available, batch.valid, parts)
        for reader in self._readers[source]:
            reader.read(batch, place, self.reasoning, parts)

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
        # A unit for one object alone reads a selected stream, which ends with this watermark.
        if source.stream.last_available is not None:
            self.advance(source, end_of(source))
        super().ended(source)

    def resume(self, source: StreamGenerator) -> None:
        super().resume(source)
        self.reasoning.resumed(self.sources.index(source))

    def _begin_again(self) -> None:
        # Those that are finished leave while their evaluation is there. The others enter the new
        # one, where the numbers begin anew.
        instances, self._instances = self._instances, {}
        for number, instance in instances.items():
            self._parts.remove(number)
            if instance.is_finished:
                self.let_go(instance)
                instance.leave(forgets=False)
        super()._begin_again()
        for instance in instances.values():
            if instance.number is not None:
                instance.enter()

    def _advance(self, watermark: int, *, by_clock: bool = False) -> None:
        before = self.reasoning.late_of.copy()
        super()._advance(watermark, by_clock=by_clock)
        self._count_late(self.reasoning.late_of[: len(before)] - before)

    def _count_late(self, late_of: NDArray[np.int64]) -> None:
        """Count the late samples of each part."""
        for part in np.flatnonzero(late_of).tolist():
            instance = self._instances.get(part)
            if instance is not None:
                instance.late += int(late_of[part])

    def _asked_for(self, source: StreamGenerator, batch: SampleBatch) -> tuple[Parts, SampleBatch]:
        """The samples of the objects that instances ask for, with their parts; a sample comes once
        for each part of its object."""
        objects, is_wanted = self._coders[source].encode(batch)
        wanted = np.flatnonzero(is_wanted)
        rows, parts = self._parts.of(objects[wanted].astype(np.int64))
        if len(rows) == len(wanted) == len(batch):
            return parts, batch
        return parts, batch.take(wanted[rows])

    # -- results -----------------------------------------------------------------------------

    def _hand_out(
        self,
        parts: Parts,
        available: Times,
        valid: Times,
        of_instance: Callable[[Rows, Instance], Any],
    ) -> None:
        """Let each instance emit its results: the rows with its part, in their order."""
        if not len(parts):
            return
        # Stable: the results of an instance stay in their order.
        order = np.argsort(parts, kind="stable")
        numbers, starts = np.unique(parts[order], return_index=True)
        for number, rows in zip(numbers.tolist(), np.split(order, starts[1:]), strict=True):
            instance = self._instances.get(number)
            if instance is None:
                continue  # a result of another instance has made it leave
            # No sample is stamped before the watermark, which instances without followers lack.
            self.promise_to(instance)
            instance.emit(of_instance(rows, instance))
        (last,) = self.output.stamps_at(available.max(keepdims=True))
        self.emit_tally(int(last), int(valid.max()), len(numbers))
