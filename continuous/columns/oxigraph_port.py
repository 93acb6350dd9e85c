"""The interface to Oxigraph: evaluate a SPARQL text over quads, in this process or another.

`oxigraph_expressions` and `window_store` use it. The service provides an implementation in a worker
that can be stopped (service/workers).
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


class StoredQuads:
    """An immutable set of quads that many queries read."""

    def __init__(self, quads: Collection[Quad] = ()) -> None:
        self.quads = quads
        self.number = next(_NUMBERS)
        """Unique in this process: an implementation that caches a copy recognizes it by this."""

    def __reduce__(self) -> tuple[type[StoredQuads], tuple[Collection[Quad]]]:
        # Numbers are unique per process: an object read from a checkpoint needs a new one.
        return StoredQuads, (self.quads,)


NO_QUADS = StoredQuads()


@dataclass(frozen=True, slots=True)
class Table:
    """Solutions: each row has a term (None: unbound) per variable."""

    variables: tuple[str, ...]
    rows: Sequence[Sequence[Term | None]]


SparqlResult = Table | Sequence[Triple] | bool
"""The result of SELECT, of CONSTRUCT and DESCRIBE, of ASK."""


class OxigraphPort(Protocol):
    """Evaluates SPARQL."""

    def ask(self, sparql: str, kept: StoredQuads, content: Sequence[Quad]) -> SparqlResult:
        """Evaluate ``sparql`` over the quads of both. Raises `budget.BudgetExceeded` if it exceeds
        its limits, ``ValueError``, and the errors of Oxigraph."""


class DirectOxigraph:
    """Evaluates in this process, without a deadline."""

    def ask(self, sparql: str, kept: StoredQuads, content: Sequence[Quad]) -> SparqlResult:
        store = Store()
        store.extend(kept.quads)
        store.extend(content)
        result = store.query(sparql, custom_functions=FUNCTIONS)
        match result:
            case QueryBoolean():
                return bool(result)
            case QueryTriples():
                return list(result)
            case QuerySolutions():
                names = tuple(variable.value for variable in result.variables)
                return Table(names, [[_rdf11(term) for term in solution] for solution in result])
        raise AssertionError("Oxigraph has three kinds of results")


DIRECT = DirectOxigraph()


def _rdf11(term: object) -> Term | None:
    if isinstance(term, Triple):
        raise ValueError("triples about triples (RDF 1.2) are not supported")
    return term  # type: ignore[return-value]
