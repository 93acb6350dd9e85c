"""The rows of a pattern in the samples of streams."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....converters.objects import object_iri
from ....languages.mtl.checked import Kind
from ....rdf.dictionary import TermDictionary
from ....rdf.namespaces import DYKNOW
from ....reasoning.patterns.plans.plan import NO_VALUE
from ....reasoning.patterns.plans.query import (
    END,
    START,
    Keys,
    Part,
    Source,
    SourceColumn,
    object_key,
    text_key,
    value_keys,
)
from ....reasoning.patterns.plans.rows import Values
from ....reasoning.patterns.recognition.recognition import Recognition
from ....streams.generator import StreamGenerator
from ....streams.sample import Column, FieldType, SampleBatch
from ....streams.time import parse_time
from ..merge import MergeInput, ObjectCodes

_KINDS = {
    FieldType.FLOAT: Kind.NUMBER,
    FieldType.INTEGER: Kind.NUMBER,
    FieldType.BOOLEAN: Kind.TRUTH,
    FieldType.STRING: Kind.TEXT,
}


@dataclass(frozen=True, slots=True, eq=False)
class SourceInput:
    """A stream that has samples of a source. ``has_interval``: they last, from their field
    ``start`` to their field ``end``."""

    source: Source
    input: MergeInput
    has_interval: bool


def kind_of(type: FieldType) -> Kind:
    """The kind of the values of a field."""
    return _KINDS[type]


def row_readers(
    inputs: Sequence[SourceInput],
    dictionary: TermDictionary,
    keys: Keys,
    numbered: str | None = None,
) -> dict[StreamGenerator, list[RowReader]]:
    """Return new readers of the sources' rows, by stream. ``numbered``: as for `RowReader`."""
    found: dict[StreamGenerator, list[RowReader]] = {}
    for each in inputs:
        found.setdefault(each.input.source, []).append(RowReader(each, dictionary, keys, numbered))
    return found


class RowReader:
    """Reads the rows of one source from one stream. ``numbered``: the column of objects whose
    numbers `read` is given."""

    def __init__(
        self,
        input: SourceInput,
        dictionary: TermDictionary,
        keys: Keys,
        numbered: str | None = None,
    ) -> None:
        self._source = input.source
        self._input = input.input
        self._has_interval = input.has_interval
        self._keys = keys
        self._numbered = [
            each.argument
            for each in input.source.columns
            if each.part is Part.OBJECT and each.column == numbered
        ]
        self._objects = [
            ObjectCodes(
                object,
                dictionary,
                lambda iri: keys.number(object_key(iri)),
                input.input.is_wanted if i == 0 else None,
            )
            for i, object in enumerate(input.input.objects)
        ]

    def read(
        self,
        batch: SampleBatch,
        place: int,
        recognition: Recognition,
        numbers: NDArray[np.int64] | None = None,
    ) -> None:
        """Add the samples with a value and wanted objects; of a sort, all with its objects.
        ``numbers``: those of the objects that are numbered, all of which are wanted."""
        present = batch.columns[self._input.field].present
        if self._source.is_sort:
            present = np.ones(len(batch), np.bool_)
        if not present.any():
            return
        objects: list[NDArray[Any]] = []
        for i, encoder in enumerate(self._objects):
            if numbers is not None and i in self._numbered:
                objects.append(numbers)
                continue
            codes, is_wanted = encoder.encode(batch)
            objects.append(codes)
            present = present & is_wanted
        rows = np.flatnonzero(present)
        if not len(rows):
            return
        taken = batch if len(rows) == len(batch) else batch.take(rows)
        columns = {
            column.column: objects[column.argument][rows].astype(np.int64)
            if column.part is Part.OBJECT
            else self._column(taken, column)
            for column in self._source.columns
            if column.part is not Part.BEFORE
        }
        start = end = taken.valid
        if self._has_interval:
            start = _of_each(taken.columns[START], parse_time)
            end = _of_each(taken.columns[END], parse_time)
        recognition.add(place, self._source.kind, rows, taken.available, start, end, columns)

    def _column(self, batch: SampleBatch, column: SourceColumn) -> Values:
        values = self._values(batch, column)
        return value_keys(values) if column.as_key else values

    def _values(self, batch: SampleBatch, column: SourceColumn) -> Values:
        """The values as the plans compare them. Raises `ValueError` for another kind."""
        name = column.field if column.part is Part.FIELD else self._input.field
        values = batch.columns[name]
        kind = column.kind or kind_of(values.type)
        match kind:
            case Kind.NUMBER if values.type in (FieldType.FLOAT, FieldType.INTEGER):
                numbers = values.values.astype(np.float64)
                if name == self._input.field:
                    numbers = np.asarray(self._input.conversion.apply(numbers))
                return np.where(values.present, numbers, np.nan)
            case Kind.TRUTH if values.type is FieldType.BOOLEAN:
                return np.where(values.present, values.values.astype(np.int64), NO_VALUE)
            case Kind.TEXT if values.type is FieldType.STRING:
                return _of_each(values, lambda text: self._keys.number(text_key(text)))
            case Kind.OBJECT if values.type is FieldType.STRING:
                return _of_each(values, self._object)
            case Kind.TIME if values.type is FieldType.STRING:
                return _of_each(values, parse_time)
            case _:
                raise ValueError(
                    f"field {name!r} of stream {self._input.source.name} is {values.type}, and the "
                    f"pattern needs a {kind}"
                )

    def _object(self, text: str) -> int:
        return self._keys.number(object_key(object_iri(text, DYKNOW)))


def _of_each(column: Column, convert: Callable[[str], int]) -> NDArray[np.int64]:
    """Convert each text; a missing one is `NO_VALUE`."""
    texts: list[Any] = column.tolist()
    found = {text: NO_VALUE if text is None else convert(str(text)) for text in set(texts)}
    return np.array([found[text] for text in texts], np.int64)
