"""Terms of instances in growing columns, numbers as numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import Literal, NamedNode

from ...rdf.dictionary import Term, TermDictionary
from ...rdf.timed import DATATYPES, Kind, ObjectColumn, split_term
from ..columns.relation import bits, decoded, decoded_terms
from ..values.literals import canonical

_BLOCK = 4096
"""As many terms wait to be encoded: long lists of them keep the garbage collector busy."""
_READ: Mapping[str, tuple[Kind, Any]] = {
    DATATYPES[Kind.DOUBLE].value: (Kind.DOUBLE, float),
    DATATYPES[Kind.INTEGER].value: (Kind.INTEGER, int),
}


class Growing:
    """An array that grows at its end; a `view` of it stays as it is. Cost: O(what comes)."""

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
        """Other values from now on; ``values`` is ours."""
        self._values = self.view = values


class Terms:
    """A growing column of terms: a tag (`Kind`) and 64 bits each, as `TermValues.encoded` has them.

    Numbers never enter the dictionary: a million thresholds are 9 bytes each.
    """

    def __init__(self, dictionary: TermDictionary) -> None:
        self.dictionary = dictionary
        self._tags, self._bits = Growing(np.int8), Growing(np.int64)
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
        """Cost: some microseconds a term, most of them when a block is encoded."""
        self._waiting.append(term)
        if len(self._waiting) == _BLOCK:
            self.settle()

    def settle(self) -> None:
        """Encode what waits."""
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
        """The terms of these rows."""
        tags, values = self.tags[rows], self.bits[rows]
        if not len(tags):
            return ObjectColumn(Kind.TERM, np.zeros(0, np.int32))
        if (tags == tags[0]).all():
            return decoded(Kind(int(tags[0])), values)
        return decoded_terms(tags, values, self.dictionary)

    def term(self, row: int) -> Term:
        return self.column(np.array([row])).term_at(0, self.dictionary)


def _split(term: Term, dictionary: TermDictionary) -> tuple[Kind, Any]:
    """`split_term` of the canonical spelling; doubles and integers without spelling them first."""
    if isinstance(term, NamedNode):
        return Kind.TERM, dictionary.transient_id(term)
    if isinstance(term, Literal):
        known, text = _READ.get(term.datatype.value), term.value
        if known is not None and text.isascii() and "_" not in text and text == text.strip():
            kind, read = known
            try:
                value = read(text)
            except ValueError:
                value = None
            if value is not None and (
                -(2**63) <= value < 2**63 if kind is Kind.INTEGER else abs(value) < np.inf
            ):
                return kind, value
    return split_term(canonical(term), dictionary.transient_id)
