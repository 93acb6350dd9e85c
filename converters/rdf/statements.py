"""Streams of RDF as it is: each sample is a statement, with the terms as texts of N-Triples.

A number that a float64 holds exactly is a number, with the local name of its datatype beside it; so
it costs no text, and policies and plots see a number. Any other object is a text. See
docs/reference/formats.md.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import BlankNode, Literal, NamedNode, RdfFormat, parse

from ...rdf.dictionary import NO_TERM, Ids, Term, TermDictionary
from ...rdf.namespaces import XSD
from ...rdf.timed import DATATYPES, Kind, make_literal
from ...streams.sample import Column, Field, FieldType, SampleBatch, Schema, Times
from ...streams.string_pool import StringPool
from ..errors import WireError
from ..wire import BatchLimits, Incoming
from .ntriples import GENERATED, Statements, TripleReader, line_of, object_value

SUBJECT, PREDICATE, OBJECT, NUMBER, DATATYPE, GRAPH = (
    "subject",
    "predicate",
    "object",
    "number",
    "datatype",
    "graph",
)
TERMS: Final = (SUBJECT, PREDICATE, OBJECT, GRAPH)
"""The fields that hold terms as texts."""
SCHEMA: Final = Schema(
    tuple(
        Field(name, FieldType.FLOAT if name == NUMBER else FieldType.STRING)
        for name in (SUBJECT, PREDICATE, OBJECT, NUMBER, DATATYPE, GRAPH)
    )
)
NUMBERS: Final = {kind: DATATYPES[kind].value.removeprefix(XSD) for kind in Kind if kind.is_number}
"""The texts of `DATATYPE`."""
MOST_TERMS: Final = 1 << 14
"""Terms that a thread remembers from one text to the next."""
MOST_SPELLED: Final = 1 << 20
"""And bytes of their spellings."""
EXACT: Final = 2**53
"""The greatest integer up to which a float64 holds all."""
_TIMED: Final = (RdfFormat.N_QUADS, RdfFormat.TRIG, RdfFormat.JSON_LD)
"""The formats of graphs with names."""


def decode_statements(
    data: bytes,
    format: RdfFormat,
    pools: dict[str, StringPool],
    limits: BatchLimits | None = None,
    time_property: str = "",
) -> Incoming:
    """Decode a text of RDF; one bad statement refuses all of it.

    The time of a statement is that of its graph, if the default graph gives times; otherwise, with
    a ``time_property`` (IRI), the time that its subject has by this property, or the earliest of
    those that lead to its subject; otherwise that of its arrival. Statements come in order of time.
    Blank nodes are numbered in order of appearance, and are of this text alone. Raises `WireError`.

    Cost: 2 ns a byte and some Python for each distinct term, of N-Triples and N-Quads; 3 µs a
    statement in other formats.
    """
    reader = _reader()
    found = reader.statements(data, format, None if limits is None else limits.samples)
    times: Times | None = None
    if format in _TIMED and _has_graph_times(found, reader.dictionary):
        found, times = reader.with_times(found)
    elif time_property:
        times = _property_times(found, reader, time_property)
    if not len(found):
        raise WireError(None, "the text holds no statement", "send at least one")
    if times is not None:
        order = np.argsort(times, kind="stable")
        found, times = found.take(order), times[order]
    stamped = times is None
    if times is None:
        times = np.zeros(len(found), np.int64)
    texts = _Texts(found, reader.dictionary, limits)
    batch = SampleBatch(times, times, texts.columns(pools))
    return Incoming(batch, stamped, valid_on_arrival=stamped, has_nodes=texts.has_nodes)


_own: Final = threading.local()


def _reader() -> TripleReader:
    """The reader of this thread. It remembers the terms of earlier texts, up to a bound."""
    reader: TripleReader | None = getattr(_own, "reader", None)
    if reader is None or len(reader.dictionary) > MOST_TERMS or reader.size > MOST_SPELLED:
        reader = _own.reader = TripleReader(TermDictionary())
    return reader


def with_named_nodes(batch: SampleBatch, number: int) -> SampleBatch:
    """The batch with names for its blank nodes that no other batch of the stream has. ``number``:
    that of its first sample."""
    columns = dict(batch.columns)
    for name in (SUBJECT, OBJECT, GRAPH):
        column = columns[name]
        pool = column.pool
        assert pool is not None
        used = np.unique(column.values[column.present])
        texts = {code: pool[code] for code in used.tolist()}
        nodes = {code: text for code, text in texts.items() if text.startswith("_:")}
        if not nodes:
            continue
        values = column.values.copy()
        for code, text in nodes.items():
            values[column.values == code] = pool.code(f"_:s{number}{text[2:]}")
        columns[name] = Column(column.type, values, column.null, pool)
    return SampleBatch(batch.available, batch.valid, columns)


def check_statements(batch: SampleBatch) -> None:
    """Check samples that came as such, and not as RDF. Raises `WireError` with the row, from 1."""
    for name in TERMS:
        column = batch.columns[name]
        if name in (SUBJECT, PREDICATE):
            _refuse(~column.present, f"a statement has a {name}")
        assert column.pool is not None
        used = np.unique(column.values[column.present]).tolist()
        for code in used:
            text = column.pool[code]
            if not isinstance(parse_term(text), _ALLOWED[name]):
                rows = column.present & (column.values == code)
                _refuse(rows, f"field {name!r}: {text[:40]!r} is no {_WORDS[name]} of N-Triples")
    object, number, datatype = (batch.columns[name].present for name in (OBJECT, NUMBER, DATATYPE))
    _refuse(object == number, "a statement has either an object or a number")
    _refuse(number != datatype, "a number has a datatype, and nothing else has one")
    kinds = batch.columns[DATATYPE]
    assert kinds.pool is not None
    for code in np.unique(kinds.values[datatype]).tolist():
        if kinds.pool[code] not in NUMBERS.values():
            _refuse(
                datatype & (kinds.values == code),
                f"the datatype of a number is one of {', '.join(NUMBERS.values())}",
            )


_ALLOWED: Final = {
    SUBJECT: NamedNode | BlankNode,
    PREDICATE: NamedNode,
    OBJECT: NamedNode | BlankNode | Literal,
    GRAPH: NamedNode | BlankNode,
}
_WORDS: Final = {
    SUBJECT: "IRI or blank node",
    PREDICATE: "IRI",
    OBJECT: "term",
    GRAPH: "IRI or blank node",
}


def parse_term(text: str) -> Term | None:
    """The term with this text of N-Triples; None if it is no such text."""
    if text.startswith("<") and text.endswith(">"):
        try:
            return NamedNode(text[1:-1])
        except ValueError:
            pass  # an IRI with escapes, or none at all
    line = f"<x:s> <x:p> {text} .".encode(errors="replace")
    # A quoted triple nests; more than one line would be more than one term.
    if b"<<" in line or b"\n" in line or b"\r" in line:
        return None
    try:
        quads = list(parse(line, format=RdfFormat.N_TRIPLES))
    except SyntaxError:
        return None
    term = quads[0].object if len(quads) == 1 else None
    return term if isinstance(term, NamedNode | BlankNode | Literal) else None


def _refuse(rows: NDArray[np.bool_], message: str) -> None:
    if rows.any():
        raise WireError(int(np.argmax(rows)) + 1, message, "docs/reference/formats.md has the form")


def _has_graph_times(found: Statements, dictionary: TermDictionary) -> bool:
    generated = dictionary.find(GENERATED)
    of_default = (found.graph == NO_TERM) & (found.predicate == generated)
    return generated != NO_TERM and bool(of_default.any())


def _property_times(found: Statements, reader: TripleReader, property: str) -> Times:
    """The time of each statement by the times of subjects."""
    latest = np.iinfo(np.int64).max
    times = np.full(len(reader.dictionary), latest, np.int64)
    predicate = reader.dictionary.find(NamedNode(property))
    for row in np.flatnonzero(found.predicate == predicate).tolist():
        subject = int(found.subject[row])
        times[subject] = min(times[subject], reader.time_at(found, row))
    has_own = times < latest
    links = np.flatnonzero(found.kind == Kind.TERM)
    _lead(times, has_own, found.subject[links], found.object[links])
    of_rows: Times = times[found.subject]
    if len(lacking := np.flatnonzero(of_rows == latest)):
        row = int(lacking[0])
        lacks = reader.dictionary.term(int(found.subject[row]))
        raise WireError(
            line_of(found, row),
            f"{lacks} has no time: it has no <{property}>, and nothing that has one leads to it",
            "give it one, or send it to a stream without a time property",
        )
    return of_rows


def _lead(times: Times, has_own: NDArray[np.bool_], source: Ids, target: NDArray[np.int64]) -> None:
    """Give terms without a time of their own the earliest that leads to them. Cost: O(links)."""
    by_source = np.argsort(source, kind="stable")
    targets = target[by_source].tolist()
    ids = np.arange(len(times) + 1)
    begins = np.searchsorted(source[by_source], ids).tolist()
    reached = has_own.tolist()
    own = np.flatnonzero(has_own)
    for start in own[np.argsort(times[own], kind="stable")].tolist():
        waiting = [start]
        while waiting:
            term = waiting.pop()
            for other in targets[begins[term] : begins[term + 1]]:
                if not reached[other]:
                    reached[other] = True
                    times[other] = times[start]
                    waiting.append(other)


class _Texts:
    """The columns of statements; blank nodes are numbered in order of appearance."""

    def __init__(
        self, found: Statements, dictionary: TermDictionary, limits: BatchLimits | None
    ) -> None:
        self._found = found
        self._dictionary = dictionary
        self._nodes: dict[Term, str] = {}
        objects = np.where(found.kind == Kind.TERM, found.object, NO_TERM)
        # Graphs have no term -1, which is the last entry here.
        is_used = np.zeros(len(dictionary) + 1, np.bool_)
        for ids in (found.subject, found.predicate, objects, found.graph):
            is_used[ids] = True
        terms = [dictionary.term(id) for id in np.flatnonzero(is_used[:-1]).tolist()]
        if any(isinstance(term, BlankNode) for term in terms):
            for id in np.stack([found.graph, found.subject, objects], axis=1).ravel().tolist():
                if id != NO_TERM and isinstance(term := dictionary.term(id), BlankNode):
                    self._nodes.setdefault(term, f"_:b{len(self._nodes)}")
        if limits is not None:
            for term in terms:
                size = len(str(term).encode())
                if size > limits.text:
                    raise WireError(
                        None,
                        f"a term has at most {limits.text} bytes, and {str(term)[:40]}… has {size}",
                        "keep the text elsewhere and send its address",
                    )

    @property
    def has_nodes(self) -> bool:
        """Whether there are blank nodes."""
        return bool(self._nodes)

    def columns(self, pools: dict[str, StringPool]) -> dict[str, Column]:
        """The columns of `SCHEMA`, with codes of ``pools`` (made where missing)."""
        found = self._found
        pool = {
            field.name: pools.setdefault(field.name, StringPool())
            for field in SCHEMA.fields
            if field.type is FieldType.STRING
        }
        values = found.object.view(np.float64)
        is_number = np.zeros(len(found), np.bool_)
        numbers = np.zeros(len(found), np.float64)
        for kind in NUMBERS:
            rows = np.flatnonzero(found.kind == kind)
            if kind is Kind.INTEGER:
                rows = rows[np.abs(found.object[rows]) <= EXACT]
                numbers[rows] = found.object[rows]
            else:
                rows = rows[np.isfinite(values[rows])]
                numbers[rows] = values[rows]
            is_number[rows] = True
        return {
            SUBJECT: self._terms(found.subject, pool[SUBJECT]),
            PREDICATE: self._terms(found.predicate, pool[PREDICATE]),
            OBJECT: self._objects(is_number, pool[OBJECT]),
            NUMBER: Column(FieldType.FLOAT, numbers, _null(~is_number)),
            DATATYPE: _coded(found.kind, ~is_number, NUMBERS.__getitem__, pool[DATATYPE]),
            GRAPH: self._terms(found.graph, pool[GRAPH]),
        }

    def _terms(self, ids: Ids, pool: StringPool) -> Column:
        return _coded(ids, ids == NO_TERM, self._text, pool)

    def _objects(self, is_number: NDArray[np.bool_], pool: StringPool) -> Column:
        """Terms; and literals that are neither terms nor numbers, such as booleans."""
        found = self._found
        column = _coded(found.object, is_number | (found.kind != Kind.TERM), self._text, pool)
        others = np.flatnonzero(~is_number & (found.kind != Kind.TERM))
        pairs = zip(found.kind[others].tolist(), found.object[others], strict=True)
        texts = [str(make_literal(Kind(kind), object_value(Kind(kind), v))) for kind, v in pairs]
        column.values[others] = pool.encode(texts)
        return Column(FieldType.STRING, column.values, _null(is_number), pool)

    def _text(self, id: int) -> str:
        term = self._dictionary.term(id)
        return self._nodes.get(term) or str(term)


def _coded(
    ids: NDArray[Any], null: NDArray[np.bool_], text: Callable[[Any], str], pool: StringPool
) -> Column:
    """A column of the texts of ids."""
    rows = np.flatnonzero(~null)
    present = ids[rows]
    # Ids are small: a table by id is quicker than sorting them. Codes are given in order of
    # appearance, since ids depend on earlier texts, and a replay has to give the same codes.
    table = np.full(int(present.max()) + 1 if len(rows) else 0, -1, np.int32)
    table[present[::-1]] = np.arange(len(rows), dtype=np.int32)[::-1]
    used = np.flatnonzero(table >= 0)
    used = used[np.argsort(table[used])]
    table[used] = pool.encode([text(id) for id in used.tolist()])
    codes = np.zeros(len(ids), np.int32)
    codes[rows] = table[present]
    return Column(FieldType.STRING, codes, _null(null), pool)


def _null(null: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    return null if null.any() else None
