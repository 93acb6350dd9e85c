"""The unit of a monitor: verdicts of a formula over the streams that matching found (SPEC §8)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...converters.objects import object_iri, object_name
from ...languages.mtl.ast import Monitor, Report
from ...languages.mtl.checked import CheckedMonitor, Kind
from ...rdf.dictionary import TermDictionary
from ...rdf.namespaces import DYKNOW
from ...reasoning.mtl.explanation import Explanation, NoStart, explain_verdict
from ...reasoning.mtl.formulas import bound_sorts
from ...reasoning.mtl.monitoring import WORDS, Monitoring, Reported
from ...reasoning.states.states import Term
from ...streams.generator import StreamGenerator
from ...streams.history import FluentStream
from ...streams.past_queries import Forgotten
from ...streams.sample import (
    Column,
    Field,
    FieldType,
    SampleBatch,
    Schema,
    column_from_values,
)
from ...streams.time import TIME_MAX, format_time, parse_time
from .base import ComputationalUnit
from .merge import MergeInput, ObjectCodes

VERDICT, DECIDED, LAST = "verdict", "decided", "last"
RESULT_FIELDS: Final = (VERDICT, DECIDED, LAST)
"""The fields of verdicts beside the objects; `LAST` only where runs are reported."""
_NUMBERS = (FieldType.FLOAT, FieldType.INTEGER)


@dataclass(frozen=True, slots=True, eq=False)
class TermInput:
    """A stream that has the values of a term, which are of ``kind``. ``variables``: which of the
    feature's arguments are variables."""

    term: Term
    kind: Kind
    variables: tuple[int, ...]
    input: MergeInput


def verdict_schema(monitor: CheckedMonitor) -> Schema:
    """Return the fields of a monitor's verdicts: the objects by the names of the parameters, the
    verdict, the time of the deciding state; and of a run the time of its last start."""
    names = [name for name, _ in monitor.parameters]
    results = RESULT_FIELDS if monitor.report is Report.CHANGES else (VERDICT, DECIDED)
    return Schema(tuple(Field(name, FieldType.STRING) for name in (*names, *results)))


class MonitorUnit(ComputationalUnit):
    """Evaluates a monitor over its inputs.

    A verdict is valid at its start, and available when the state that decides it leaves: under
    ``max delay`` that long after the state's time, otherwise with the sample that shows that later
    samples are valid later. ``newest``: the greatest available time (ns) of the samples upstream of
    a unit; a later watermark comes from the clock.

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
        newest: Callable[[ComputationalUnit], int],
    ) -> None:
        super().__init__(*args)
        self._newest = newest
        self.text = text
        self.monitoring = Monitoring(monitor, len(self.sources), wider)
        self.samples = 0
        """Samples read by now."""
        self._explanation = explanation
        self._first: dict[StreamGenerator, int] = {}
        """The available time (ns) of the first sample read of each input."""
        self._wider = wider
        self._make_readers = partial(_readers, terms, dictionary)
        self._readers = self._make_readers()

    @property
    def reads(self) -> Sequence[StreamGenerator]:
        """The streams that it reads."""
        return self.inputs

    def explain(self) -> str:
        """Describe the evaluation: the formula, its states by now, and the verdicts."""
        run = self.monitoring
        verdicts = ", ".join(f"{count:,} {word}" for word, count in run.verdicts.items())
        now = [
            f"states       {run.states:,} by now, of {self.samples:,} samples; {run.late:,} samples"
            " came after the state of their time had left",
            f"verdicts     {verdicts}",
            f"in memory    {run.retained:,} samples and states",
        ]
        return "\n".join([self._explanation, *now])

    def why(self, objects: Sequence[str], start: int) -> Explanation:
        """Explain the verdict of these objects (as the verdicts name them, or IRIs) that starts at
        ``start`` (ns), from the retained samples of the inputs.

        Raises `NoStart`, and `Forgotten` if an input has evicted samples that the states may need:
        those before the first state left, for a value that is not known there, or for a quantifier.
        Cost: the evaluation of all retained samples.
        """
        iris = [object_iri(name.removeprefix("<").removesuffix(">"), DYKNOW) for name in objects]
        run, evicting = self._again()
        states = run.states_of(iris)
        if states is None:
            raise NoStart("there is no state yet")
        monitor = run.monitor
        if evicting and (start < int(states.valid[0]) or bound_sorts(monitor.formula)):
            raise Forgotten(evicting[0])
        found = explain_verdict(monitor, self.text, states, start, iris)
        if evicting and (
            found.valid[0] == states.valid[0]
            or any(each.values[0] is None for each in found.features)
        ):
            # An evicted sample may have the value, or make a state before.
            raise Forgotten(evicting[0])
        return found

    def _again(self) -> tuple[Monitoring, list[FluentStream]]:
        """Make all states again of the retained samples that the unit has read. Also returns the
        streams that have evicted some."""
        run = Monitoring(
            self.monitoring.monitor,
            len(self.sources),
            self._wider,
            decides=False,
            grid=self.monitoring.grid,
        )
        readers, evicting = self._make_readers(), []
        for place, source in enumerate(self.sources):
            first, past = self._first.get(source), self.past_of(source)
            if first is None:
                continue
            past = past.take(past.available >= first)
            if not len(past) or int(past.available[0]) > first:
                evicting.append(source.stream)
            if len(past):
                run.came(place, past.available, past.valid)
                for reader in readers[source]:
                    reader.read(past, place, run)
        for source in self._ended:
            run.ended(self.sources.index(source))
        if self.all_ended:
            run.advance(self._end + 1)
            run.finish(self._end)
        elif self.least_watermark is not None:
            least = self.least_watermark
            run.advance(least, by_clock=self._is_by_clock(least))
        return run, evicting

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        self.samples += len(batch)
        self._first.setdefault(source, int(batch.available[0]))
        place = self.sources.index(source)
        self.monitoring.came(place, batch.available, batch.valid)
        for reader in self._readers[source]:
            reader.read(batch, place, self.monitoring)

    def progress(self, source: StreamGenerator, watermark: int) -> None:
        least = self.least_watermark
        if least is None or self.output.is_ended:
            return
        self.monitoring.set_idle(i for i, each in enumerate(self.sources) if each.is_idle)
        self._advance(least, by_clock=self._is_by_clock(least))
        if self.monitoring.is_over:
            self._leave_inputs()
            self.output.end()
        else:
            self.output.advance(least)

    def resume(self, source: StreamGenerator) -> None:
        if self.output.is_ended:
            raise RuntimeError(f"{source.name} goes on after its end, and all verdicts are out")
        super().resume(source)

    def finish(self, source: StreamGenerator) -> None:
        if self.output.is_ended:
            return
        self.monitoring.ended(self.sources.index(source))
        if self.all_ended:
            self._advance(self._end + 1)
            self._emit(self.monitoring.finish(self._end))
        super().finish(source)

    @property
    def _end(self) -> int:
        """The available time (ns) of the end of all inputs, whichever of them ended first."""
        return min(max([self.last_processed, *self._watermarks.values()]), TIME_MAX - 1)

    def _is_by_clock(self, watermark: int) -> bool:
        # After a sample of time t the watermark of a stream is t or t + 1.
        return watermark > self._newest(self) + 1

    def _advance(self, watermark: int, *, by_clock: bool = False) -> None:
        before = self.monitoring.late
        self._emit(self.monitoring.advance(watermark, by_clock=by_clock))
        # Beside the samples that were late for the unit itself.
        self.late += self.monitoring.late - before

    def _emit(self, found: Reported) -> None:
        if not len(found):
            return
        columns: dict[str, list[str]] = {}
        for (name, _), iris in zip(self.monitoring.monitor.parameters, found.objects, strict=True):
            names = {iri: object_name(iri, DYKNOW) for iri in set(iris)}
            columns[name] = [names[iri] for iri in iris]
        columns[VERDICT] = [WORDS[value] for value in found.value.tolist()]
        columns[DECIDED] = list(map(format_time, found.decided.tolist()))
        columns[LAST] = list(map(format_time, found.last.tolist()))
        pools = self.output.stream.pools
        self.output.emit(
            SampleBatch(
                self.output.stamps_at(found.available),
                found.valid,
                {
                    field.name: column_from_values(field, columns[field.name], pools[field.name])
                    for field in self.output.schema.fields
                },
            )
        )


def _readers(
    terms: Sequence[TermInput], dictionary: TermDictionary
) -> dict[StreamGenerator, list[_TermReader]]:
    """New readers of the terms, by stream."""
    found: dict[StreamGenerator, list[_TermReader]] = {}
    for each in terms:
        found.setdefault(each.input.source, []).append(_TermReader(each, dictionary))
    return found


class _TermReader:
    """Reads the values of one term from one stream."""

    def __init__(self, input: TermInput, dictionary: TermDictionary) -> None:
        self._term = input.term
        self._kind = input.kind
        self._variables = input.variables
        self._input = input.input
        self._names: list[str] = []
        """IRIs by their codes."""
        self._code_of: dict[str, int] = {}
        self._codes = [
            ObjectCodes(object, dictionary, self._code, input.input.is_wanted if i == 0 else None)
            for i, object in enumerate(input.input.objects)
        ]

    def read(self, batch: SampleBatch, place: int, monitoring: Monitoring) -> None:
        """Add the samples with a value and wanted objects."""
        column = batch.columns[self._input.field]
        present = column.present
        codes = []
        for encoder in self._codes:
            own, is_wanted = encoder.encode(batch)
            codes.append(own)
            present = present & is_wanted
        rows = np.flatnonzero(present)
        if not len(rows):
            return
        names = np.array(self._names, object)
        objects = np.empty((len(rows), len(self._variables)), object)
        for i, argument in enumerate(self._variables):
            objects[:, i] = names[codes[argument][rows]]
        values = self._values(column.take(rows))
        available, valid = batch.available[rows], batch.valid[rows]
        monitoring.add(place, self._term, available, valid, objects, values)

    def _code(self, iri: str) -> int:
        code = self._code_of.setdefault(iri, len(self._names))
        if code == len(self._names):
            self._names.append(iri)
        return code

    def _values(self, column: Column) -> NDArray[Any]:
        """The values as the formula compares them. Raises `ValueError` for another kind."""
        match self._kind:
            case Kind.NUMBER if column.type in _NUMBERS:
                return np.asarray(self._input.conversion.apply(column.values.astype(np.float64)))
            case Kind.TRUTH if column.type is FieldType.BOOLEAN:
                return column.values
            case Kind.TEXT if column.type is FieldType.STRING:
                return np.array(column.tolist(), object)
            case Kind.OBJECT if column.type is FieldType.STRING:
                return _of_each(column, lambda text: object_iri(text, DYKNOW), object)
            case Kind.TIME if column.type is FieldType.STRING:
                return _of_each(column, parse_time, np.int64)
            case _:
                raise ValueError(
                    f"field {self._input.field!r} of stream {self._input.source.name} is "
                    f"{column.type}, and the formula needs a {self._kind}"
                )


def _of_each(column: Column, convert: Callable[[str], Any], kind: Any) -> NDArray[Any]:
    texts = [str(value) for value in column.tolist()]
    found = {text: convert(text) for text in set(texts)}
    return np.array([found[text] for text in texts], kind)
