"""RDF texts of clients, and what they entail, in a worker: see `ontology.reasoning`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeVar

import anyio
import anyio.to_thread
from pyoxigraph import BlankNode, NamedNode, Triple

from ...ontology.errors import OntologyError
from ...ontology.reading import TextFormat
from .messages import (
    Answer,
    BadAnswer,
    Entail,
    Failed,
    Job,
    Read,
    Refused,
    Row,
    Table,
    TooMuch,
    rows_of,
    triples_of,
)
from .pool import Busy, Pool
from .worker import WorkerError

T = TypeVar("T")
WAITING: Final = 16
"""So many texts may wait for their turn."""
_BYTES: Final = 1 << 30
"""More than the triples that are allowed can have, with texts of the longest request."""


class IsolatedReasoning:
    """A `Reasoning` whose worker has ``seconds`` for each step, and gives ``triples`` at most."""

    def __init__(self, pool: Pool, seconds: float, triples: int) -> None:
        self._pool = pool
        self._seconds = seconds
        self._triples = triples
        self._turn = anyio.CapacityLimiter(1)

    async def run(self, work: Callable[[], T]) -> T:
        """What ``work`` gives, which reasons on a thread of its own, one at a time; raises `Busy`
        when too many wait."""
        if self._turn.statistics().tasks_waiting >= WAITING:
            raise Busy
        return await anyio.to_thread.run_sync(work, limiter=self._turn, abandon_on_cancel=True)

    def read(self, text: str, format: TextFormat, base: NamedNode) -> frozenset[Triple]:
        """Raises `OntologyError`, also for a text that needs too much."""
        work = Read(text, format, base.value, self._triples)
        return _renamed(self._table(work, "reading the text"))

    def entail(self, asserted: frozenset[Triple]) -> frozenset[Triple]:
        """Raises `OntologyError`, also for triples that entail too much."""
        if len(asserted) > self._triples:
            raise _too_many(self._triples)
        work = Entail(list(rows_of(asserted)), self._triples)
        return frozenset(triples_of(self._table(work, "computing what the ontologies entail")))

    def _table(self, work: Read | Entail, doing: str) -> list[Row]:
        try:
            answer = self._pool.call(lambda worker: worker.call(Job(work, self._seconds), _BYTES))
            return _rows(answer)
        except (WorkerError, BadAnswer) as error:
            raise OntologyError(
                f"{doing} was stopped: {error}", hint="load it in parts, or make it simpler"
            ) from error


def _rows(answer: Answer) -> list[Row]:
    match answer:
        case Table([], rows):
            return rows
        case Refused(message, hint, line, column):
            raise OntologyError(message, line, column, hint)
        case TooMuch(_, limit):
            raise _too_many(limit)
        case Failed(message):
            raise OntologyError(message)
    raise BadAnswer("another answer than was asked for")


def _too_many(limit: int) -> OntologyError:
    return OntologyError(
        f"the ontologies, or what they entail, have more than {limit} triples",
        hint="load less of them: what describes sorts, features and objects is enough",
    )


def _renamed(rows: list[Row]) -> frozenset[Triple]:
    """The triples with fresh blank nodes: those of a worker mean nothing here."""
    fresh: dict[str, BlankNode] = {}

    def node(term: object) -> object:
        return fresh.setdefault(term.value, BlankNode()) if isinstance(term, BlankNode) else term

    return frozenset(
        Triple(node(t.subject), t.predicate, node(t.object))  # type: ignore[arg-type]
        for t in triples_of(rows)
    )
