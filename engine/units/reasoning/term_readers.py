"""The values of a formula's terms in the samples of streams, for monitors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ....converters.objects import object_iri
from ....languages.mtl.checked import Kind
from ....rdf.dictionary import TermDictionary
from ....rdf.namespaces import DYKNOW
from ....reasoning.mtl.monitoring import Monitoring
from ....reasoning.states.states import Term
from ....streams.generator import StreamGenerator
from ....streams.sample import Column, FieldType, SampleBatch
from ....streams.time import parse_time
from ..merge import MergeInput, ObjectCodes

_NUMBERS: Final = (FieldType.FLOAT, FieldType.INTEGER)


@dataclass(frozen=True, slots=True, eq=False)
class TermInput:
    """A stream that has the values of a term, which are of ``kind``. ``variables``: which of the
    feature's arguments are variables."""

    term: Term
    kind: Kind
    variables: tuple[int, ...]
    input: MergeInput


def term_readers(
    terms: Sequence[TermInput], dictionary: TermDictionary
) -> dict[StreamGenerator, list[TermReader]]:
    """Return new readers of the terms, by stream."""
    found: dict[StreamGenerator, list[TermReader]] = {}
    for each in terms:
        found.setdefault(each.input.source, []).append(TermReader(each, dictionary))
    return found


_UNKNOWN: Final = -2
"""The place of an object that was not asked for."""


class TermReader:
    """Reads the values of one term from one stream, always for the same monitor."""

    def __init__(self, input: TermInput, dictionary: TermDictionary) -> None:
        self._term = input.term
        self._kind = input.kind
        self._variables = input.variables
        self._input = input.input
        self._names: list[str] = []
        """IRIs by their codes."""
        self._code_of: dict[str, int] = {}
        self._places = [np.empty(0, np.int64) for _ in input.variables]
        """The places of objects in the monitor, by their codes, for each variable argument."""
        self._codes = [
            ObjectCodes(object, dictionary, self._code, input.input.is_wanted if i == 0 else None)
            for i, object in enumerate(input.input.objects)
        ]

    def read(
        self,
        batch: SampleBatch,
        place: int,
        monitoring: Monitoring,
        parts: NDArray[np.int64] | None = None,
    ) -> None:
        """Add the samples with a value and wanted objects. ``parts``: the numbers of the objects,
        all of which are wanted, where parts are evaluated."""
        column = batch.columns[self._input.field]
        present = column.present
        if not np.count_nonzero(present):
            return
        if parts is not None:
            rows = np.flatnonzero(present)
            times = batch.available[rows], batch.valid[rows]
            numbers = parts[rows].reshape(-1, 1)
            monitoring.add(place, self._term, *times, numbers, self._values(column.take(rows)))
            return
        codes = []
        for encoder in self._codes:
            own, is_wanted = encoder.encode(batch)
            codes.append(own)
            present = present & is_wanted
        rows = np.flatnonzero(present)
        if not len(rows):
            return
        places = np.empty((len(rows), len(self._variables)), np.int64)
        for i, argument in enumerate(self._variables):
            places[:, i] = self._places_of(codes[argument][rows], i, monitoring)
        values = self._values(column.take(rows))
        monitoring.add(place, self._term, batch.available[rows], batch.valid[rows], places, values)

    def _places_of(
        self, codes: NDArray[np.int32], variable: int, monitoring: Monitoring
    ) -> NDArray[np.int64]:
        """The places of objects by their codes; each is asked for once."""
        table = self._places[variable]
        more = len(self._names) - len(table)
        if more > 0:
            more = max(more, len(table))
            table = self._places[variable] = np.concatenate([table, np.full(more, _UNKNOWN)])
        found = table[codes]
        if len(found) and int(found.min()) == _UNKNOWN:
            # In the order in which they come.
            for code in dict.fromkeys(codes[found == _UNKNOWN].tolist()):
                table[code] = monitoring.place(self._term, variable, self._names[code])
            found = table[codes]
        return found

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
