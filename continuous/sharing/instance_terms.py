"""InstanceTerms of instances in growing columns; numbers need no dictionary entry."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import Literal, NamedNode

from ...rdf.dictionary import Term, TermDictionary
from ...rdf.timed import DATATYPES, Kind, ObjectColumn, split_term
from ..columns.relation import bits, decode, decode_terms
from ..values.literals import canonical

_BLOCK = 4096
"""The number of terms encoded at a time. Longer lists would slow down the garbage collector."""
_READ: Mapping[str, tuple[Kind, Any]] = {
    DATATYPES[Kind.DOUBLE].value: (Kind.DOUBLE, float),
    DATATYPES[Kind.INTEGER].value: (Kind.INTEGER, int),
}


class GrowingArray:
    """An array that grows at its end; its views do not change. Cost: O(appended values)."""

    def __init__(self, kind: Any) -> None:
        self._values: NDArray[Any] = np.zeros(0, kind)
        self.view: NDArray[Any] = self._values

    def extend(self, values: NDArray[Any]) -> None:
        start = len(self.view)
        stop = start + len(values)
        if stop > len(self._values):
            larger = np.zeros(max(stop, 2 * start), self._values.dtype)
            larger[:start] = self.view
            self._values = larger
        self._values[start:stop] = values
        self.view = self._values[:stop]

    def replace(self, values: NDArray[Any]) -> None:
        """Replace the values; the array takes over ``values``."""
        self._values = self.view = values


class InstanceTerms:
    """A growing column of terms, each a tag (`Kind`) and 64 bits, as in `TermValues.encode`.

    Numbers never enter the dictionary, so a million thresholds take 9 bytes each.
    """

    def __init__(self, dictionary: TermDictionary) -> None:
        self.dictionary = dictionary
        self._tags, self._bits = GrowingArray(np.int8), GrowingArray(np.int64)
        self._waiting: list[Term] = []
        dictionary.hold(self)

    def held_ids(self) -> Iterator[NDArray[np.int64]]:
        """See `dictionary.Holder`."""
        yield self.bits[self.tags == Kind.TERM]

    @property
    def tags(self) -> NDArray[np.int8]:
        return self._tags.view

    @property
    def bits(self) -> NDArray[np.int64]:
        return self._bits.view

    def append(self, term: Term) -> None:
        """Append a term. Cost: some microseconds per term, mostly when a block is encoded."""
        self._waiting.append(term)
        if len(self._waiting) == _BLOCK:
            self.settle()

    def settle(self) -> None:
        """Encode the appended terms."""
        if not self._waiting:
            return
        dictionary = self.dictionary
        kinds, values = zip(*[_split(term, dictionary) for term in self._waiting], strict=True)
        self._waiting = []
        tags = np.array(kinds, np.int8)
        self._tags.extend(tags)
        if (tags == tags[0]).all():
            self._bits.extend(bits(np.array(values, kinds[0].dtype)))
            return
        new = np.zeros(len(tags), np.int64)
        for kind in set(kinds):
            at = np.flatnonzero(tags == kind)
            new[at] = bits(np.array([values[i] for i in at.tolist()], kind.dtype))
        self._bits.extend(new)

    def keep(self, rows: NDArray[np.int64]) -> None:
        self._tags.replace(self.tags[rows])
        self._bits.replace(self.bits[rows])

    def column(self, rows: NDArray[np.int64]) -> ObjectColumn:
        """Return the terms of these rows."""
        tags, values = self.tags[rows], self.bits[rows]
        if not len(tags):
            return ObjectColumn(Kind.TERM, np.zeros(0, np.int32))
        if (tags == tags[0]).all():
            return decode(Kind(int(tags[0])), values)
        return decode_terms(tags, values, self.dictionary)

    def term(self, row: int) -> Term:
        return self.column(np.array([row])).term_at(0, self.dictionary)


def _split(term: Term, dictionary: TermDictionary) -> tuple[Kind, Any]:
    """Apply `split_term` to the canonical spelling. Doubles and integers skip that spelling."""
    if isinstance(term, NamedNode):
        return Kind.TERM, dictionary.transient_id(term)
    if isinstance(term, Literal):
        reader, text = _READ.get(term.datatype.value), term.value
        if reader is not None and text.isascii() and "_" not in text and text == text.strip():
            kind, read = reader
            try:
                value = read(text)
            except ValueError:
                value = None
            if value is not None and (
                -(2**63) <= value < 2**63 if kind is Kind.INTEGER else abs(value) < np.inf
            ):
                return kind, value
    return split_term(canonical(term), dictionary.transient_id)
