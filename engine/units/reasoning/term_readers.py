"""The values of a formula's terms in the samples of streams, for monitors."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
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
from ....streams.sample import Column, FieldType, Mask, SampleBatch
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
    """Return new readers of the terms, by stream; terms whose objects have the same names share
    one."""
    groups: dict[Hashable, list[TermInput]] = {}
    for each in terms:
        input = each.input
        key = input.source, input.objects, input.is_wanted, each.variables
        groups.setdefault(key, []).append(each)
    found: dict[StreamGenerator, list[TermReader]] = {}
    for group in groups.values():
        found.setdefault(group[0].input.source, []).append(TermReader(group, dictionary))
    return found


_UNKNOWN: Final = -2
"""The place of an object that was not asked for."""


class TermReader:
    """Reads the values of terms from one stream, always for the same monitor. Contract: the terms
    have the same objects and variables."""

    def __init__(self, terms: Sequence[TermInput], dictionary: TermDictionary) -> None:
        self._terms = terms
        self._variables = terms[0].variables
        self._names: list[str] = []
        """IRIs by their codes."""
        self._code_of: dict[str, int] = {}
        self._places = [[np.empty(0, np.int64) for _ in self._variables] for _ in terms]
        """The places of objects in the monitor, by their codes, for each term and variable."""
        input = terms[0].input
        self._codes = [
            ObjectCodes(object, dictionary, self._code, input.is_wanted if i == 0 else None)
            for i, object in enumerate(input.objects)
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
        encoded: tuple[list[NDArray[np.int32]], Mask] | None = None
        for number, term in enumerate(self._terms):
            column = batch.columns[term.input.field]
            present = column.present
            if not np.count_nonzero(present):
                continue
            if parts is None:
                encoded = encoded or self._encoded(batch)
                present = present & encoded[1]
            rows = np.flatnonzero(present)
            if not len(rows):
                continue
            if parts is not None:
                places = parts[rows].reshape(-1, 1)
            else:
                assert encoded is not None
                places = np.empty((len(rows), len(self._variables)), np.int64)
                for i, argument in enumerate(self._variables):
                    own = encoded[0][argument][rows]
                    places[:, i] = self._places_of(own, number, i, monitoring)
            values = _values(term, column.take(rows))
            times = batch.available[rows], batch.valid[rows]
            monitoring.add(place, term.term, *times, places, values)

    def _encoded(self, batch: SampleBatch) -> tuple[list[NDArray[np.int32]], Mask]:
        """The codes of the samples' objects, for each argument, and whether they are wanted."""
        found = [encoder.encode(batch) for encoder in self._codes]
        wanted = [is_wanted for _, is_wanted in found]
        return [codes for codes, _ in found], np.logical_and.reduce(wanted)

    def _places_of(
        self, codes: NDArray[np.int32], term: int, variable: int, monitoring: Monitoring
    ) -> NDArray[np.int64]:
        """The places of objects by their codes; each is asked for once."""
        table = self._places[term][variable]
        more = len(self._names) - len(table)
        if more > 0:
            more = max(more, len(table))
            table = np.concatenate([table, np.full(more, _UNKNOWN)])
            self._places[term][variable] = table
        found = table[codes]
        if len(found) and int(found.min()) == _UNKNOWN:
            # In the order in which they come.
            for code in dict.fromkeys(codes[found == _UNKNOWN].tolist()):
                name = self._names[code]
                table[code] = monitoring.place(self._terms[term].term, variable, name)
            found = table[codes]
        return found

    def _code(self, iri: str) -> int:
        code = self._code_of.setdefault(iri, len(self._names))
        if code == len(self._names):
            self._names.append(iri)
        return code


def _values(term: TermInput, column: Column) -> NDArray[Any]:
    """The values as the formula compares them. Raises `ValueError` for another kind."""
    match term.kind:
        case Kind.NUMBER if column.type in _NUMBERS:
            return np.asarray(term.input.conversion.apply(column.values.astype(np.float64)))
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
                f"field {term.input.field!r} of stream {term.input.source.name} is "
                f"{column.type}, and the formula needs a {term.kind}"
            )


def _of_each(column: Column, convert: Callable[[str], Any], kind: Any) -> NDArray[Any]:
    texts = [str(value) for value in column.tolist()]
    found = {text: convert(text) for text in set(texts)}
    return np.array([found[text] for text in texts], kind)
