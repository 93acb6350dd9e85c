"""Whoever evaluates a SPARQL text over quads: Oxigraph, here or in another process.

`oxigraph_expressions` and `window_store` ask; the service gives them one that can be stopped
(service/workers).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Protocol

from pyoxigraph import Quad, QueryBoolean, QuerySolutions, QueryTriples, Store, Triple

from ...rdf.dictionary import Term
from ..values.standard_functions import FUNCTIONS

_NUMBERS = count()


class Kept:
    """Quads that are asked about again and again, as they were at one time."""

    def __init__(self, quads: Collection[Quad] = ()) -> None:
        self.quads = quads
        self.number = next(_NUMBERS)
        """No other one has it: who keeps a copy knows by it whether that is the same."""

    def __reduce__(self) -> tuple[type[Kept], tuple[Collection[Quad]]]:
        # Out of a checkpoint it gets a number of the process that reads it: in that one another may
        # have its old one.
        return Kept, (self.quads,)


NOTHING = Kept()


@dataclass(frozen=True, slots=True)
class Table:
    """Solutions: a row each with a term (None: unbound) for each variable."""

    variables: tuple[str, ...]
    rows: Sequence[Sequence[Term | None]]


Found = Table | Sequence[Triple] | bool
"""The answer of SELECT, of CONSTRUCT and DESCRIBE, of ASK."""


class Asking(Protocol):
    """Evaluates SPARQL."""

    def ask(self, sparql: str, kept: Kept, content: Sequence[Quad]) -> Found:
        """The answer over the quads of both. Raises `budget.BudgetExceeded` where it needs more
        than it may, ``ValueError`` and what Oxigraph raises else."""


class DirectAsking:
    """Evaluates here, and waits as long as it takes."""

    def ask(self, sparql: str, kept: Kept, content: Sequence[Quad]) -> Found:
        store = Store()
        store.extend(kept.quads)
        store.extend(content)
        found = store.query(sparql, custom_functions=FUNCTIONS)
        match found:
            case QueryBoolean():
                return bool(found)
            case QueryTriples():
                return list(found)
            case QuerySolutions():
                names = tuple(variable.value for variable in found.variables)
                return Table(names, [[_rdf11(term) for term in solution] for solution in found])
        raise AssertionError("Oxigraph knows three kinds of results")


DIRECT = DirectAsking()


def _rdf11(term: object) -> Term | None:
    if isinstance(term, Triple):
        raise ValueError("triples about triples (RDF 1.2) are not supported")
    return term  # type: ignore[return-value]
