"""The unit of a pattern: its matches over the streams that matching found (SPEC §8)."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...converters.objects import object_name
from ...languages.mtl.checked import Kind
from ...rdf.dictionary import TermDictionary
from ...rdf.namespaces import DYKNOW
from ...reasoning.patterns.plan import NO_VALUE
from ...reasoning.patterns.query import END, START, Keys, PatternQuery, Result
from ...reasoning.patterns.recognition import Recognition, Recognized
from ...streams.generator import StreamGenerator
from ...streams.sample import (
    Column,
    Field,
    FieldType,
    SampleBatch,
    Schema,
    column_from_values,
)
from ...streams.time import TIME_MAX, format_time
from .base import ComputationalUnit
from .row_readers import SourceInput, row_readers

_TYPES = {
    Kind.NUMBER: FieldType.FLOAT,
    Kind.TRUTH: FieldType.BOOLEAN,
    Kind.TEXT: FieldType.STRING,
    Kind.TIME: FieldType.STRING,
    Kind.OBJECT: FieldType.STRING,
}


def match_schema(query: PatternQuery) -> Schema:
    """Return the fields of a pattern's matches: the results, then the times of start and end."""
    results = [
        Field(each.name, FieldType.STRING if each.is_list else _TYPES[each.kind])
        for each in query.results
    ]
    return Schema((*results, Field(START, FieldType.STRING), Field(END, FieldType.STRING)))


class PatternUnit(ComputationalUnit):
    """Evaluates a pattern over its inputs; see `Recognition` for when a match is available.
    ``newest`` returns the greatest available time (ns) of the samples in streams and upstream of
    them; a later watermark comes from the clock.
    """

    def __init__(
        self,
        *args: Any,
        query: PatternQuery,
        inputs_of_sources: Sequence[SourceInput],
        dictionary: TermDictionary,
        keys: Keys,
        lateness: Callable[[StreamGenerator], int],
        newest: Callable[[*tuple[StreamGenerator, ...]], int],
    ) -> None:
        super().__init__(*args)
        self._newest = newest
        self._keys = keys
        self.query = query
        self.recognition = Recognition(
            query, len(self.sources), keys, lateness=[lateness(each) for each in self.sources]
        )
        self.samples = self.matches = 0
        """Samples read, and matches found by now."""
        self._readers = row_readers(inputs_of_sources, dictionary, keys)

    @property
    def reads(self) -> Sequence[StreamGenerator]:
        """The streams that it reads."""
        return self.inputs

    def explain(self) -> str:
        """Describe the evaluation: the plans, and what has been done by now."""
        run = self.recognition
        return "\n".join(
            [
                run.evaluator.explain(),
                f"read         {self.samples:,} samples; {run.late:,} came behind later ones, and "
                "were left out",
                f"matches      {self.matches:,} by now; {run.evaluator.pending:,} wait for rows "
                "that may still come",
                f"in memory    {run.retained:,} rows and matches",
                *self._losses(),
            ]
        )

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        self.samples += len(batch)
        place = self.sources.index(source)
        self.recognition.came(place, batch.available, batch.valid)
        for reader in self._readers[source]:
            reader.read(batch, place, self.recognition)

    def progress(self, source: StreamGenerator, watermark: int) -> None:
        least = self.least_watermark
        if least is None or self.output.is_ended:
            return
        self.recognition.set_idle(i for i, each in enumerate(self.sources) if each.is_idle)
        # After a sample of time t the watermark of a stream is t or t + 1.
        by_clock = least > self._newest(*self.sources) + 1
        self._advance(least, by_clock=by_clock)
        # The end is at the newest sample, and may follow.
        self.output.advance(least if by_clock else min(least, self._newest(*self.sources)))

    def resume(self, source: StreamGenerator) -> None:
        if self.output.is_ended:
            raise RuntimeError(f"{source.name} goes on after its end, and all matches are out")
        super().resume(source)

    def finish(self, source: StreamGenerator) -> None:
        if self.output.is_ended:
            return
        self.recognition.ended(self.sources.index(source), self._newest(source))
        if self.all_ended:
            end = min(self._newest(*self.sources), TIME_MAX - 1)
            self._advance(end + 1)
            self._emit(self.recognition.finish(end))
        super().finish(source)

    def _advance(self, watermark: int, *, by_clock: bool = False) -> None:
        before = self.recognition.late
        self._emit(self.recognition.advance(watermark, by_clock=by_clock))
        # Beside the samples that were late for the unit itself.
        self.late += self.recognition.late - before

    def _losses(self) -> list[str]:
        counters = self.recognition.evaluator.counters
        lost = {
            "rows, beyond the limit of rows kept": counters.unstored,
            "rows, beyond the limit of rows kept for one key": counters.crowded,
            "rows that complete more matches than the limit": counters.cut_short,
            "matches, beyond the limit of those that wait": counters.unawaited,
        }
        return [f"left out     {count:,} {what}" for what, count in lost.items() if count]

    def _emit(self, found: Recognized) -> None:
        if not len(found):
            return
        self.matches += len(found)
        pools = self.output.stream.pools
        columns = {
            field.name: self._column(field, found, pools.get(field.name))
            for field in self.output.schema.fields
        }
        self.output.emit(SampleBatch(self.output.stamps_at(found.available), found.valid, columns))

    def _column(self, field: Field, found: Recognized, pool: Any) -> Column:
        values = found.outputs[field.name]
        if field.name in (START, END):
            return column_from_values(field, list(map(format_time, values.tolist())), pool)
        result = next(each for each in self.query.results if each.name == field.name)
        if result.is_list:
            lists = (list(map(self._text_of(result), each.tolist())) for each in values)
            texts = [json.dumps(each, ensure_ascii=False) for each in lists]
            return column_from_values(field, texts, pool)
        if field.type is FieldType.FLOAT:
            numbers = values.astype(np.float64)
            if values.dtype != np.float64:
                numbers[values == NO_VALUE] = np.nan
            return Column(field.type, numbers, np.isnan(numbers))
        told = self._text_of(result)
        known = {value: told(value) for value in set(values.tolist())}
        return column_from_values(field, [known[value] for value in values.tolist()], pool)

    def _text_of(self, result: Result) -> Callable[[Any], Any]:
        """Return what a value of an output is in a sample."""
        match result.kind:
            case Kind.TIME:
                convert: Callable[[Any], Any] = format_time
            case Kind.TRUTH:
                convert = bool
            case Kind.TEXT:

                def convert(number: int) -> str:
                    return self._keys.key(number)[1:]

            case Kind.OBJECT:

                def convert(number: int) -> str:
                    return object_name(self._keys.key(number)[1:-1], DYKNOW)

            case Kind.NUMBER:
                return lambda number: None if number != number else number
        return lambda value: None if value == NO_VALUE else convert(value)
