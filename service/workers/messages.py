"""What a parent and a worker say to each other: msgpack of typed structs, nothing that is executed.

A worker may have been taken over by what it was given, so that its answers are data of a stranger:
decoding checks their types, and makes no objects but these.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, TypeAlias

import msgspec
from pyoxigraph import BlankNode, Literal, NamedNode, Triple

if TYPE_CHECKING:  # it brings numpy, which no worker needs
    from ...rdf.dictionary import Term

Cell: TypeAlias = tuple[int, str, str]
"""A term: what it is, its text, the datatype or language of a literal."""
Row: TypeAlias = list[Cell | None]
ElementRow: TypeAlias = tuple[int, int, str, str | None, int, int]
"""An element of a specification (`xml_elements`): what it is, the row that it stands in, the type
or the value, the name, where its tag begins and ends."""
PREFIX = 8
"""Bytes of a message's length before it, big-endian."""
_IRI, _BLANK, _TYPED, _TAGGED = range(4)


class Follow(msgspec.Struct, tag="follow", frozen=True):
    """What the copy of the ontology lacks, as N-Quads: all of it, or what came and what went."""

    dump: bytes | None
    added: bytes
    removed: bytes


class Query(msgspec.Struct, tag="query", frozen=True):
    """A user's SPARQL text over the copy of the ontology.

    ``format`` is a media type of `sparql_formats`, empty if the text is to be checked only.
    """

    text: str
    format: str
    rows: int
    size: int


class Ask(msgspec.Struct, tag="ask", frozen=True):
    """A SPARQL text over quads (N-Quads): those kept as ``key``, and ``content``.

    ``kept`` are the quads of ``key`` where they are not there yet; ``forget`` are keys of others.
    """

    text: str
    key: str
    kept: bytes | None
    content: bytes
    forget: list[str]
    rows: int
    size: int


class Read(msgspec.Struct, tag="read", frozen=True):
    """An ontology text, as `ontology.reading.read_triples` takes it."""

    text: str
    format: str
    base: str
    triples: int


class Entail(msgspec.Struct, tag="entail", frozen=True):
    """Triples of which the closure is wanted."""

    triples: list[Row]
    most: int


class ReadSpecification(msgspec.Struct, tag="read specification", frozen=True):
    """A specification in XML, decoded; of at most so many insertions, as many removals, and
    ``elements`` of all kinds."""

    text: str
    parts: int
    elements: int


Work: TypeAlias = Follow | Query | Ask | Read | Entail | ReadSpecification


class Job(msgspec.Struct, frozen=True):
    """What is to be done, and how many seconds of a processor it may take."""

    work: Work
    seconds: float


class Written(msgspec.Struct, tag="written", frozen=True):
    """An answer as a client gets it."""

    body: bytes


class Table(msgspec.Struct, tag="table", frozen=True):
    """Solutions, or triples as rows of three."""

    variables: list[str]
    rows: list[Row]


class Truth(msgspec.Struct, tag="truth", frozen=True):
    """The answer to ASK."""

    answer: bool


class Refused(msgspec.Struct, tag="refused", frozen=True):
    """The text is to blame."""

    message: str
    hint: str = ""
    line: int | None = None
    column: int | None = None


class Elements(msgspec.Struct, tag="elements", frozen=True):
    """A specification (`xml_elements`)."""

    rows: list[ElementRow]


class Misread(msgspec.Struct, tag="misread", frozen=True):
    """The text is to blame, between the characters ``start`` and ``end``."""

    message: str
    hint: str
    start: int
    end: int


class Failed(msgspec.Struct, tag="failed", frozen=True):
    """The evaluation of a right text found an error."""

    message: str


class TooMuch(msgspec.Struct, tag="too-much", frozen=True):
    """A result of more than ``limit`` of ``what``."""

    what: str
    limit: int


Answer: TypeAlias = Written | Table | Truth | Refused | Elements | Misread | Failed | TooMuch


def tag_of(message: msgspec.Struct) -> str:
    """What kind of job or answer it is, as it is sent."""
    return str(message.__struct_config__.tag)


encode = msgspec.msgpack.Encoder().encode
decode_job = msgspec.msgpack.Decoder(Job).decode
_decode_answer = msgspec.msgpack.Decoder(Answer).decode


class BadAnswer(Exception):
    """A worker said what none says."""


def decode_answer(data: bytes) -> Answer:
    """Raises `BadAnswer` for anything else."""
    try:
        found: Answer = _decode_answer(data)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise BadAnswer(str(error)) from error
    return found


def cell_of(term: object) -> Cell:
    """The term as data; raises ``ValueError`` for what RDF 1.1 does not have."""
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
    """Raises `BadAnswer` for what is no term."""
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
    """Triples as rows."""
    for triple in triples:
        yield [cell_of(triple.subject), cell_of(triple.predicate), cell_of(triple.object)]


def triples_of(rows: Iterable[Row]) -> Iterator[Triple]:
    """The triples that rows are; raises `BadAnswer` for others."""
    terms: dict[Cell, Term] = {}
    for row in rows:
        if len(row) != 3 or None in row:
            raise BadAnswer("a triple has three terms")
        found = []
        for cell in row:
            assert cell is not None
            term = terms.get(cell)
            if term is None:
                term = terms[cell] = term_of(cell)
            found.append(term)
        subject, predicate, object = found
        if isinstance(subject, Literal) or not isinstance(predicate, NamedNode):
            raise BadAnswer("a triple has terms that cannot stand there")
        yield Triple(subject, predicate, object)
