"""The jobs of a worker: queries over a copy of the ontology, SPARQL over quads, RDF texts,
closures, specifications in XML.

This module limits only the sizes of results; `worker_main` limits time and memory of the process.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Iterator
from typing import Any, get_args

import msgspec
from pyoxigraph import (
    NamedNode,
    Quad,
    QueryBoolean,
    QueryResultsFormat,
    QuerySolutions,
    QueryTriples,
    RdfFormat,
    Store,
    parse,
)

from ...continuous.values.standard_functions import FUNCTIONS
from ...languages.errors import LanguageError
from ...languages.specification import parse_specification
from ...languages.specification.markup import NAMESPACE
from ...ontology.churn import Churn
from ...ontology.entailment.closure_queries import answer
from ...ontology.entailment.deep_hierarchies import MARKERS
from ...ontology.entailment.owlrl_closure import closure_of
from ...ontology.errors import OntologyError, QueryRefused
from ...ontology.texts.query_guard import Dataset, check_user_query
from ...ontology.texts.reading import TextFormat, nquads_of_json_ld, read_triples
from ..http.encodings.sparql_formats import TABLES, write_graph
from .messages import (
    Answer,
    Ask,
    Elements,
    Entail,
    Failed,
    Follow,
    GraphNames,
    Misread,
    Query,
    Read,
    ReadJsonLd,
    ReadSpecification,
    Refused,
    Row,
    Table,
    TooMuch,
    Truth,
    Work,
    Written,
    cell_of,
    rows_of,
    triples_of,
)
from .xml_elements import UNIT
from .xml_elements import rows_of as element_rows

_EMPTY_SPECIFICATION = f'<specification xmlns="{NAMESPACE}"/>'


class Worker:
    """The state of a worker: its copy of the ontology, and the cached quads for `Ask`."""

    def __init__(self) -> None:
        self._store = Store()
        self._churn = Churn()
        self._kept: dict[str, list[Quad]] = {}

    def warm(self) -> None:
        """Do each kind of job once. It imports modules and opens files, which is impossible after
        `worker_main.restrict`."""
        self.answer(Query("SELECT * { ?s ?p ?o }", "text/csv", 1, 1000))
        text = "<urn:a> a owl:Class ; rdfs:label 'a'@en, '1'^^xsd:integer ."
        read = self.answer(Read(text, "turtle", "urn:b", 10))
        assert isinstance(read, Table)
        closed = self.answer(Entail(read.rows, 1000))
        assert isinstance(closed, Table)
        self.answer(Ask("SELECT", "", None, b"", [], 1, 1))
        self.answer(ReadJsonLd(b'{"@id": "urn:a", "urn:p": {}}', 1, 1000))
        self.answer(ReadSpecification(_EMPTY_SPECIFICATION, 1, 1))

    def answer(self, work: Work) -> Answer:
        """Execute a job and return its answer; expected errors are answers, too."""
        try:
            match work:
                case Follow():
                    return self._follow(work)
                case Query():
                    return self._query(work)
                case Ask():
                    return self._ask(work)
                case Read():
                    return _read(work)
                case Entail():
                    return _entail(work)
                case ReadJsonLd():
                    return _read_json_ld(work)
                case ReadSpecification():
                    return _read_specification(work)
        except _LimitExceeded as exceeded:
            return TooMuch(exceeded.what, exceeded.limit)
        except (QueryRefused, OntologyError) as error:
            return Refused(error.message, error.hint, error.line, error.column)
        except LanguageError as error:
            return Misread(error.message, error.hint, error.span.start, error.span.end)
        except MemoryError:
            return Failed("it needs more memory than it may have")
        except RecursionError:
            return Failed("it is nested too deeply")
        except (SyntaxError, ValueError, RuntimeError, OSError) as error:
            # Errors of the store during the evaluation of a valid text.
            return Failed(str(error))

    def _follow(self, work: Follow) -> Answer:
        if work.dump is not None:
            self._store, self._churn = Store(), Churn()
            self._store.extend(_quads(work.dump))
        removed, added = list(_quads(work.removed)), list(_quads(work.added))
        for quad in removed:
            self._store.remove(quad)
        self._store.extend(added)
        self._churn.note(removed, added)
        self._store = self._churn.replace_if_due(self._store)
        return Truth(True)

    def _query(self, work: Query) -> Answer:
        if not work.format:
            check_user_query(work.text, work.base)
            return Truth(True)
        found = answer(self._store, work.text, _dataset(work.dataset), work.base)
        if isinstance(found, QueryTriples):
            wanted = _limited(found, work.rows, "triples")
            sink = _Sink(work.size)
            write_graph(wanted, sink, work.format)
            return Written(sink.content())
        body = _serialize(found, TABLES[work.format], work.size)
        # A row has at least three bytes in each format.
        if isinstance(found, QuerySolutions) and len(body) > 3 * work.rows:
            _check_rows(body, TABLES[work.format], work.rows)
        return Written(body)

    def _ask(self, work: Ask) -> Answer:
        for key in work.forget:
            self._kept.pop(key, None)
        if work.kept is not None:
            self._kept[work.key] = list(_quads(work.kept))
        store = Store()
        store.extend(self._kept.get(work.key, ()))
        store.extend(_quads(work.content))
        found = store.query(work.text, custom_functions=FUNCTIONS)
        if isinstance(found, QueryBoolean):
            return Truth(bool(found))
        budget = _Budget(work.rows, work.size)
        if isinstance(found, QueryTriples):
            return Table([], [budget.spend(row) for row in rows_of(found)])
        names = [variable.value for variable in found.variables]
        rows = [
            budget.spend([None if term is None else cell_of(term) for term in solution])
            for solution in found
        ]
        return Table(names, rows)


def _read(work: Read) -> Answer:
    if work.format not in get_args(TextFormat):
        return Refused(f"unknown format {work.format!r}")
    format: Any = work.format
    triples = read_triples(work.text, format, NamedNode(work.base))
    if len(triples) > work.triples:
        return TooMuch("triples", work.triples)
    return Table([], sorted(rows_of(triples), key=str))


def _entail(work: Entail) -> Answer:
    added = closure_of(frozenset(triples_of(work.triples)))
    if sum(1 for triple in added if triple.predicate not in MARKERS) > work.most:
        return TooMuch("triples", work.most)
    return Table([], sorted(rows_of(added), key=str))


def _read_json_ld(work: ReadJsonLd) -> Answer:
    sink = _Sink(work.size)
    for line in _limited(nquads_of_json_ld(work.text), work.statements, "statements"):
        sink.write(line)
    return Written(sink.content())


def _read_specification(work: ReadSpecification) -> Answer:
    found = parse_specification(work.text)
    rows = element_rows(found)
    for what, number, most in (
        ("elements", len(rows), work.elements),
        ("units to insert", sum(1 for row in rows if row[0] == UNIT), work.parts),
        ("units to remove", len(found.removals), work.parts),
    ):
        if number > most:
            return TooMuch(what, most)
    return Elements(rows)


class _LimitExceeded(Exception):
    def __init__(self, what: str, limit: int) -> None:
        super().__init__(what)
        self.what = what
        self.limit = limit


class _Budget:
    def __init__(self, rows: int, size: int) -> None:
        self._rows, self._most_rows = 0, rows
        self._bytes, self._most_bytes = 0, size

    def spend(self, row: Row) -> Row:
        self._rows += 1
        self._bytes += sum(len(cell[1]) for cell in row if cell is not None)
        if self._rows > self._most_rows:
            raise _LimitExceeded("rows", self._most_rows)
        if self._bytes > self._most_bytes:
            raise _LimitExceeded("bytes", self._most_bytes)
        return row


class _Sink:
    """A file-like object that accepts at most ``most`` bytes."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._size = 0
        self._parts: list[bytes] = []

    def write(self, data: bytes) -> int:
        self._size += len(data)
        if self._size > self._most:
            raise _LimitExceeded("bytes", self._most)
        self._parts.append(bytes(data))
        return len(data)

    def flush(self) -> None:
        """Do nothing: there is no buffer."""

    def content(self) -> bytes:
        return b"".join(self._parts)


def _serialize(found: Any, format: QueryResultsFormat, most: int) -> bytes:
    sink = _Sink(most)
    found.serialize(sink, format=format)
    return sink.content()


def _limited(items: Iterable[Any], most: int, what: str) -> Iterator[Any]:
    for number, item in enumerate(items):
        if number == most:
            raise _LimitExceeded(what, most)
        yield item


class _Bindings(msgspec.Struct):
    bindings: list[msgspec.Raw]


class _Results(msgspec.Struct):
    results: _Bindings


def _check_rows(body: bytes, format: QueryResultsFormat, most: int) -> None:
    """Raises `_LimitExceeded` for a table of more rows. The caller has bounded the bytes."""
    if format is QueryResultsFormat.JSON:
        rows = len(msgspec.json.decode(body, type=_Results).results.bindings)
    elif format is QueryResultsFormat.XML:
        rows = len(re.findall(rb"<result>|<result/>", body))
    elif format is QueryResultsFormat.TSV:
        rows = body.count(b"\n") - 1  # line feeds in terms are escaped
    else:
        # A literal may be longer than the 131,072 characters that the module takes by default.
        csv.field_size_limit(len(body))
        rows = sum(1 for _ in csv.reader(io.StringIO(body.decode(), newline=""))) - 1
    if rows > most:
        raise _LimitExceeded("rows", most)


def _dataset(named: GraphNames | None) -> Dataset | None:
    if named is None:
        return None
    default_graphs, named_graphs = named
    return tuple(map(NamedNode, default_graphs)), tuple(map(NamedNode, named_graphs))


def _quads(data: bytes) -> Iterable[Quad]:
    return parse(data, RdfFormat.N_QUADS) if data else ()
