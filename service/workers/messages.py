"""The messages between the service and a worker: msgpack of typed structs, no pickles.

A malicious text may have taken over a worker, so its answers are untrusted. Decoding checks their
types, and makes no other objects.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, TypeAlias

import msgspec
from pyoxigraph import BlankNode, Literal, NamedNode, Triple

if TYPE_CHECKING:  # it imports numpy, which no worker needs
    from ...rdf.dictionary import Term

Cell: TypeAlias = tuple[int, str, str]
"""A term: its kind, its text, and the datatype or language of a literal."""
Row: TypeAlias = list[Cell | None]
GraphNames: TypeAlias = tuple[list[str], list[str]]
"""The IRIs of a dataset's default graphs, and of its named ones."""
ElementRow: TypeAlias = tuple[int, int, str, str | None, int, int]
"""An element of a specification (`xml_elements`): its kind, the row of its parent, the type or the
value, the name, start and end of its tag."""
PREFIX = 8
"""Bytes of the message length that precedes a message, big-endian."""
_IRI, _BLANK, _TYPED, _TAGGED = range(4)


class Follow(msgspec.Struct, tag="follow", frozen=True):
    """A change of the copy of the ontology, as N-Quads: a dump, or additions and removals."""

    dump: bytes | None
    added: bytes
    removed: bytes


class Query(msgspec.Struct, tag="query", frozen=True):
    """A user's SPARQL text over the copy of the ontology.

    ``format`` is a media type of `sparql_formats`; empty: only check the text.
    """

    text: str
    format: str
    rows: int
    size: int
    dataset: GraphNames | None = None
    """The graphs that the request chooses, instead of those of FROM."""
    base: str = ""
    """The IRI that relative IRIs are resolved against."""


class Ask(msgspec.Struct, tag="ask", frozen=True):
    """A SPARQL text over quads (N-Quads): the cached ones of ``key``, and ``content``.

    ``kept`` has the quads of ``key`` if the worker does not cache them yet; ``forget`` are keys to
    evict.
    """

    text: str
    key: str
    kept: bytes | None
    content: bytes
    forget: list[str]
    rows: int
    size: int


class Read(msgspec.Struct, tag="read", frozen=True):
    """An ontology text for `ontology.texts.reading.read_triples`."""

    text: str
    format: str
    base: str
    triples: int


class Entail(msgspec.Struct, tag="entail", frozen=True):
    """Triples whose closure the worker computes."""

    triples: list[Row]
    most: int


class ReadJsonLd(msgspec.Struct, tag="read json-ld", frozen=True):
    """A text of JSON-LD, of which at most ``statements`` are read, and written as N-Quads of at
    most ``size`` bytes."""

    text: bytes
    statements: int
    size: int


class ReadSpecification(msgspec.Struct, tag="read specification", frozen=True):
    """A specification in XML, decoded, with at most ``parts`` insertions, as many removals, and
    ``elements`` elements."""

    text: str
    parts: int
    elements: int


Work: TypeAlias = Follow | Query | Ask | Read | Entail | ReadJsonLd | ReadSpecification


class Job(msgspec.Struct, frozen=True):
    """A job, with its limit of processor time in seconds."""

    work: Work
    seconds: float


class Written(msgspec.Struct, tag="written", frozen=True):
    """A serialized answer for the client."""

    body: bytes


class Table(msgspec.Struct, tag="table", frozen=True):
    """Solutions, or triples as rows of three."""

    variables: list[str]
    rows: list[Row]


class Truth(msgspec.Struct, tag="truth", frozen=True):
    """The answer to ASK."""

    answer: bool


class Refused(msgspec.Struct, tag="refused", frozen=True):
    """An error in the text."""

    message: str
    hint: str = ""
    line: int | None = None
    column: int | None = None


class Elements(msgspec.Struct, tag="elements", frozen=True):
    """A specification (`xml_elements`)."""

    rows: list[ElementRow]


class Misread(msgspec.Struct, tag="misread", frozen=True):
    """An error in the text between the characters ``start`` and ``end``."""

    message: str
    hint: str
    start: int
    end: int


class Failed(msgspec.Struct, tag="failed", frozen=True):
    """An error in the evaluation of a valid text."""

    message: str


class TooMuch(msgspec.Struct, tag="too-much", frozen=True):
    """A result with more than ``limit`` of ``what``."""

    what: str
    limit: int


Answer: TypeAlias = Written | Table | Truth | Refused | Elements | Misread | Failed | TooMuch


def tag_of(message: msgspec.Struct) -> str:
    """Return the tag of a job or answer in the protocol."""
    return str(message.__struct_config__.tag)


encode = msgspec.msgpack.Encoder().encode
decode_job = msgspec.msgpack.Decoder(Job).decode
_decode_answer = msgspec.msgpack.Decoder(Answer).decode


class BadAnswer(Exception):
    """A worker's answer violates the protocol."""


def decode_answer(data: bytes) -> Answer:
    """Decode an answer. Raises `BadAnswer`."""
    try:
        answer: Answer = _decode_answer(data)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise BadAnswer(str(error)) from error
    return answer


def cell_of(term: object) -> Cell:
    """Convert a term to a cell. Raises ``ValueError`` for a term outside RDF 1.1."""
    match term:
        case NamedNode():
            return _IRI, term.value, ""
        case BlankNode():
            return _BLANK, term.value, ""
        case Literal():
            if term.language is not None:
                return _TAGGED, term.value, term.language
            return _TYPED, term.value, term.datatype.value
    raise ValueError(f"no RDF 1.1 term: {term}")


def term_of(cell: Cell) -> Term:
    """Convert a cell to a term. Raises `BadAnswer`."""
    kind, value, extra = cell
    try:
        if kind == _IRI:
            return NamedNode(value)
        if kind == _BLANK:
            return BlankNode(value)
        if kind == _TAGGED:
            return Literal(value, language=extra)
        if kind == _TYPED:
            return Literal(value, datatype=NamedNode(extra))
    except ValueError as error:
        raise BadAnswer(str(error)) from error
    raise BadAnswer(f"a term of kind {kind}")


def rows_of(triples: Iterable[Triple]) -> Iterator[Row]:
    """Convert triples to rows."""
    for triple in triples:
        yield [cell_of(triple.subject), cell_of(triple.predicate), cell_of(triple.object)]


def triples_of(rows: Iterable[Row]) -> Iterator[Triple]:
    """Convert rows to triples. Raises `BadAnswer`."""
    terms: dict[Cell, Term] = {}
    for row in rows:
        if len(row) != 3 or None in row:
            raise BadAnswer("a triple has three terms")
        terms_of_row = []
        for cell in row:
            assert cell is not None
            term = terms.get(cell)
            if term is None:
                term = terms[cell] = term_of(cell)
            terms_of_row.append(term)
        subject, predicate, object = terms_of_row
        if isinstance(subject, Literal) or not isinstance(predicate, NamedNode):
            raise BadAnswer("a triple has a term in a wrong place")
        yield Triple(subject, predicate, object)
