"""RDF texts of clients and their entailments, in a worker: see `ontology.reasoning`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeVar

import anyio
import anyio.to_thread
from pyoxigraph import BlankNode, NamedNode, Triple

from ...ontology.errors import OntologyError
from ...ontology.texts.reading import TextFormat
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
"""Texts that may wait for the worker."""
_BYTES: Final = 1 << 30
"""Beyond the size of the allowed triples, with the texts of the longest request."""


class IsolatedReasoning:
    """A `Reasoning` in a worker, with ``seconds`` for each step and at most ``triples`` triples."""

    def __init__(self, pool: Pool, seconds: float, triples: int) -> None:
        self._pool = pool
        self._seconds = seconds
        self._triples = triples
        self._limiter = anyio.CapacityLimiter(1)

    async def run(self, work: Callable[[], T]) -> T:
        """Call ``work`` in a thread, one at a time, and return its result. Raises `Busy` if too
        many wait."""
        if self._limiter.statistics().tasks_waiting >= WAITING:
            raise Busy
        return await anyio.to_thread.run_sync(work, limiter=self._limiter, abandon_on_cancel=True)

    def read(self, text: str, format: TextFormat, base: NamedNode) -> frozenset[Triple]:
        """Parse a text. Raises `OntologyError`, also if the text exceeds a limit."""
        work = Read(text, format, base.value, self._triples)
        return _with_fresh_nodes(self._table(work, "reading the text"))

    def entail(self, asserted: frozenset[Triple]) -> frozenset[Triple]:
        """Return the entailments. Raises `OntologyError`, also if they exceed a limit."""
        if len(asserted) > self._triples:
            raise _too_many(self._triples)
        work = Entail(list(rows_of(asserted)), self._triples)
        return frozenset(
            triples_of(self._table(work, "computing the entailments of the ontologies"))
        )

    def _table(self, work: Read | Entail, doing: str) -> list[Row]:
        try:
            answer = self._pool.call(lambda worker: worker.call(Job(work, self._seconds), _BYTES))
            return _rows(answer)
        except (WorkerError, BadAnswer) as error:
            raise OntologyError(
                f"{doing} was stopped: {error}", hint="load it in parts, or simplify it"
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
    raise BadAnswer("an answer of another kind than the job")


def _too_many(limit: int) -> OntologyError:
    return OntologyError(
        f"the ontologies and their entailments have more than {limit} triples",
        hint="load fewer triples: descriptions of sorts, features and objects suffice",
    )


def _with_fresh_nodes(rows: list[Row]) -> frozenset[Triple]:
    """Return the triples with fresh blank nodes: names from two texts must not coincide."""
    fresh: dict[str, BlankNode] = {}

    def node(term: object) -> object:
        return fresh.setdefault(term.value, BlankNode()) if isinstance(term, BlankNode) else term

    return frozenset(
        Triple(node(t.subject), t.predicate, node(t.object))  # type: ignore[arg-type]
        for t in triples_of(rows)
    )
