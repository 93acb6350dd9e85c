"""The term dictionary: an RDF term becomes a small integer once, and stays one.

Numbers on the way of a sample are *not* here: they stay float64 or int64 in their columns
(`timed.ObjectColumn`). The dictionary holds IRIs, strings, blank nodes and the literals that
fit no column.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import BlankNode, Literal, NamedNode

Term: TypeAlias = NamedNode | BlankNode | Literal
Ids: TypeAlias = NDArray[np.int32]

NO_TERM = -1
"""The id of no term: an unbound variable, a value that is absent."""


class TermDictionary:
    """An append-only list of distinct terms; a term's id is its position.

    Law: ``d.term(d.id(t)) == t``; equal terms have equal ids, and an id never changes meaning.
    Equality is RDF term equality (``"1"^^xsd:integer`` and ``"01"^^xsd:integer`` differ).

    Cost: a dict look-up per term encoded. Memory: every distinct term once.
    """

    __slots__ = ("_ids", "_terms")

    def __init__(self) -> None:
        self._terms: list[Term] = []
        self._ids: dict[Term, int] = {}

    def __len__(self) -> int:
        return len(self._terms)

    def id(self, term: Term) -> int:
        """The id of ``term``, given now if it is new."""
        found = self._ids.setdefault(term, len(self._terms))
        if found == len(self._terms):
            self._terms.append(term)
        return found

    def find(self, term: Term) -> int:
        """The id of ``term``, or `NO_TERM`: a look-up that adds nothing."""
        return self._ids.get(term, NO_TERM)

    def term(self, id: int) -> Term:
        """The term with this id."""
        return self._terms[id]

    def ids(self, terms: Iterable[Term]) -> Ids:
        """Ids of many terms, shape ``(n,)``."""
        return np.fromiter((self.id(term) for term in terms), np.int32)

    def terms(self, start: int = 0) -> Sequence[Term]:
        """The terms from id ``start`` on, for tables that follow the dictionary as it grows."""
        return self._terms[start:]
