"""Texts of RDF as timed triples in columns; N-Triples and N-Quads quickly.

N-Triples have no times: the caller gives one time for all triples of a text. N-Quads are a stream
of *timestamped graphs* as the W3C RDF Stream Processing group defines them: the default graph gives
the time of each graph's triples,

    <urn:g1> <http://www.w3.org/ns/prov#generatedAtTime> "2021-10-07T19:12:53Z"^^xsd:dateTime .

anywhere in the text. Called by ``dyknow run``, by programs, and for streams of statements; see
docs/reference/formats.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from pyoxigraph import BlankNode, DefaultGraph, Literal, NamedNode, Quad, RdfFormat, Triple, parse

from ...ontology.errors import OntologyError
from ...ontology.texts.document_guard import check_document
from ...rdf.dictionary import NO_TERM, Ids, Term, TermDictionary, TermTable
from ...rdf.namespaces import XSD
from ...rdf.timed import (
    Kind,
    ObjectColumn,
    TimedTriples,
    TripleRows,
    make_term,
    number_text,
    split_term,
)
from ...streams.jit import JIT
from ...streams.sample import Times
from ...streams.time import TIME_MAX, TIME_MIN, parse_time
from .. import cells
from ..decimals import floats
from ..errors import WireError
from .triple_lines import DATATYPES, LOOK, numbers, statements

GENERATED = NamedNode("http://www.w3.org/ns/prov#generatedAtTime")
"""The predicate that gives a graph's time."""
PART: Final = 10_000
"""Statements that are Python objects at the same time."""
_TIME_HINT = f"a graph has one {GENERATED}, in the default graph"


@dataclass(frozen=True, slots=True)
class Statements:
    """Triples in columns, shape ``(n,)``: ids, and for objects `Kind` and value: an id, an integer,
    a boolean, or the bits of a float64. ``graph`` is `NO_TERM` for the default graph. ``line`` is
    None if the parser gives no lines."""

    subject: Ids
    predicate: Ids
    kind: NDArray[np.int8]
    object: NDArray[np.int64]
    graph: Ids
    line: NDArray[np.int32] | None

    def __len__(self) -> int:
        return len(self.subject)

    def take(self, rows: NDArray[np.int64]) -> Statements:
        """Return the statements at ``rows``, in that order."""
        line = None if self.line is None else self.line[rows]
        subject, predicate, graph = self.subject[rows], self.predicate[rows], self.graph[rows]
        return Statements(subject, predicate, self.kind[rows], self.object[rows], graph, line)


class TripleReader(TermTable):
    """Reads texts into the ids of one dictionary, and remembers each spelling of a term.

    Law (tests/laws): the triples equal those of pyoxigraph's parser, objects as `from_terms` holds
    them; a text that it refuses raises `WireError` with line and column.

    Cost: about 2 ns a byte, and Python once per distinct term of a text. Numbers of 16 and 17
    digits cost some Python each; unusual spellings (``1.50``, ``1E2``) are terms like others. The
    loops decline some texts, such as those with ``_:b.`` or triple terms: pyoxigraph parses these,
    3 µs a triple. Memory: the spellings of the terms in the dictionary.
    """

    def __init__(self, dictionary: TermDictionary, least: int = cells.LEAST) -> None:
        self.dictionary = dictionary
        self._least = least
        self._known: dict[bytes, int] = {}
        self.size = 0
        """Bytes of the spellings that it has remembered so far."""
        dictionary.follow(self)

    def forget(self, freed: NDArray[np.bool_]) -> None:
        """See `dictionary.TermTable`."""
        self._known = {text: id for text, id in self._known.items() if not freed[id]}

    def triples(self, data: bytes, time: int) -> TimedTriples:
        """N-Triples, all at ``time`` (ns), which is their valid time too."""
        found = self.statements(data, RdfFormat.N_TRIPLES)
        times = np.full(len(found), time, np.int64)
        return timed_tables(found, times, times, self.dictionary)

    def graphs(self, data: bytes, format: RdfFormat = RdfFormat.N_QUADS) -> TimedTriples:
        """Timestamped graphs, in N-Quads or (slowly) TriG."""
        told, times = self.with_times(self.statements(data, format))
        return timed_tables(told, times, times, self.dictionary)

    def with_times(self, found: Statements) -> tuple[Statements, Times]:
        """Timestamped graphs: the statements in graphs, and the time of each. Those of the default
        graph give the times. Raises `WireError` for a graph without a time, and for any other
        statement of the default graph."""
        telling = found.graph == NO_TERM
        times = self._times(found.take(np.flatnonzero(telling)))
        told = found.take(np.flatnonzero(~telling))
        graphs, place = np.unique(told.graph, return_inverse=True)
        lacking = [i for i, graph in enumerate(graphs.tolist()) if graph not in times]
        if lacking:
            row = int(np.flatnonzero(np.isin(place, lacking))[0])
            graph = self.dictionary.term(int(told.graph[row]))
            raise WireError(line_of(told, row), f"graph {graph} has no time", _TIME_HINT)
        known = np.array([times[graph] for graph in graphs.tolist()], np.int64)
        return told, known[place]

    def time_at(self, found: Statements, row: int) -> int:
        """The object of a statement as a time (ns). Raises `WireError`."""
        kind = Kind(found.kind[row])
        value = object_value(kind, found.object[row])
        return _time(make_term(kind, value, self.dictionary), line_of(found, row))

    def statements(self, data: bytes, format: RdfFormat, most: int | None = None) -> Statements:
        """All statements of a text, in order; blank nodes keep their labels. Raises `WireError`,
        also for more than ``most``."""
        if JIT and format in _LINES and self._least <= len(data) < 2**31:
            try:
                found = self._quickly(data, quads=format == RdfFormat.N_QUADS)
            except cells.Irregular:
                pass
            else:
                if most is not None and len(found) > most:
                    raise too_many(most)
                return found
        return self._exactly(data, format, most)

    def _exactly(self, data: bytes, format: RdfFormat, most: int | None) -> Statements:
        _check(data, format)
        parts = []
        count = 0
        # A short text may say many statements (`<a> <b> 1,1,1`), and as objects they are large.
        quads = iter(parse(data, format=format))
        while part := self._part(quads):
            parts.append(np.array(part, np.int64))
            count += len(part)
            if most is not None and count > most:
                raise too_many(most)
        columns = np.concatenate(parts).T if parts else np.empty((5, 0), np.int64)
        ids = columns.astype(np.int32)
        return Statements(ids[0], ids[1], ids[2].astype(np.int8), columns[3], ids[4], None)

    def _part(self, quads: Iterator[Quad]) -> list[tuple[int, int, int, int, int]]:
        """The next statements, as ids of subject and predicate, kind and bits of the object, and
        id of the graph; none at the end."""
        id = self.dictionary.transient_id
        rows = []
        try:
            for quad in islice(quads, PART):
                if isinstance(quad.subject, Triple) or isinstance(quad.object, Triple):
                    raise WireError(None, f"a triple about triples cannot be timed: {quad}")
                kind, value = split_term(quad.object, id)
                graph = quad.graph_name
                rows.append(
                    (
                        id(quad.subject),
                        id(quad.predicate),
                        int(kind),
                        object_bits(kind, value),
                        NO_TERM if isinstance(graph, DefaultGraph) else id(graph),
                    )
                )
        except SyntaxError as error:
            raise _refusal(error) from None
        return rows

    def _quickly(self, raw: bytes, *, quads: bool) -> Statements:
        data = np.frombuffer(raw, np.uint8)
        most = raw.count(b"\n") + raw.count(b"\r") + 1
        starts, ends, lines = statements(data, most, quads=quads)
        kind, object = self._numbers(raw, data, starts[2], ends[2])
        # Numbers need no look-up in the dictionary.
        ends[2][kind != Kind.TERM] = 0
        codes, first = cells.distinct(data, starts.ravel(), ends.ravel())
        kinds, values = self._terms(raw, starts.ravel()[first], ends.ravel()[first])
        of_term = codes.reshape(4, -1)
        terms = np.flatnonzero(kind == Kind.TERM)
        kind[terms] = kinds[of_term[2][terms]]
        object[terms] = values[of_term[2][terms]]
        ids = values.astype(np.int32)
        graph = np.where(ends[3] > 0, ids[of_term[3]], np.int32(NO_TERM))
        return Statements(ids[of_term[0]], ids[of_term[1]], kind, object, graph, lines)

    def _numbers(
        self, raw: bytes, data: cells.Bytes, starts: cells.Positions, ends: cells.Positions
    ) -> tuple[NDArray[np.int8], NDArray[np.int64]]:
        """Kinds and values of the objects that are plain numbers; `Kind.TERM` for all others."""
        found, until, sure = numbers(data, starts, ends)
        kind = np.full(len(starts), int(Kind.TERM), np.int8)
        value = np.zeros(len(starts), np.int64)
        for place, (_, of) in enumerate(DATATYPES, 1):
            rows = np.flatnonzero(found == place)
            if not len(rows):
                continue
            column = data, starts[rows] + 1, until[rows]
            if of is Kind.BOOLEAN:
                value[rows] = cells.booleans(*column)[0]
            elif of is Kind.INTEGER:
                value[rows] = cells.integers(*column)[0]
            else:
                decimals = floats(*column)[0]
                value[rows] = decimals.view(np.int64)
                look = np.flatnonzero(sure[rows] == LOOK)
                places = zip(*(c[look].tolist() for c in column[1:]), strict=True)
                spelled = [raw[start:end] for start, end in places]
                found[rows[look[~_canonical(of, decimals[look], spelled)]]] = 0
                rows = rows[found[rows] == place]
            kind[rows] = int(of)
        return kind, value

    def _terms(
        self, raw: bytes, starts: cells.Positions, ends: cells.Positions
    ) -> tuple[NDArray[np.int8], NDArray[np.int64]]:
        """Kind and value of distinct spellings; pyoxigraph parses the new ones in one call."""
        places = zip(starts.tolist(), ends.tolist(), strict=True)
        spelled = [raw[start:end] for start, end in places]
        known, numbers = self._known, {}
        new = [text for text in spelled if text not in known]
        if new:
            lines = b"".join(b"<x:s> <x:p> %b .\n" % text for text in new)
            try:
                objects = [quad.object for quad in parse(lines, format=RdfFormat.N_TRIPLES)]
            except SyntaxError:
                raise cells.Irregular from None
            if len(objects) != len(new) or not all(
                isinstance(term, NamedNode | BlankNode | Literal) for term in objects
            ):
                raise cells.Irregular
            for text, term in zip(new, objects, strict=True):
                kind, value = split_term(term, self.dictionary.transient_id)
                if kind is Kind.TERM:
                    known[text] = value
                    self.size += len(text)
                else:
                    numbers[text] = int(kind), object_bits(kind, value)
        if not numbers:
            ids = [known[text] for text in spelled] or [0]
            return np.full(len(ids), int(Kind.TERM), np.int8), np.array(ids, np.int64)
        pairs = [numbers.get(text) or (int(Kind.TERM), known[text]) for text in spelled]
        kinds, values = np.array(pairs, np.int64).T
        return kinds.astype(np.int8), values

    def _times(self, told: Statements) -> dict[int, int]:
        """The time of each graph, from the triples of the default graph."""
        times: dict[int, int] = {}
        generated = self.dictionary.find(GENERATED)
        for row in range(len(told.subject)):
            line = line_of(told, row)
            if told.predicate[row] != generated:
                raise WireError(line, "a triple in no graph has no time", _TIME_HINT)
            graph = int(told.subject[row])
            time = self.time_at(told, row)
            if times.setdefault(graph, time) != time:
                name = self.dictionary.term(graph)
                raise WireError(line, f"graph {name} has two times", _TIME_HINT)
        return times


def too_many(most: int) -> WireError:
    """The error for a text of more statements."""
    return WireError(None, f"a batch has at most {most} statements", "send several batches")


def timed_tables(
    found: Statements, time: Times, valid: Times, dictionary: TermDictionary
) -> TimedTriples:
    """The statements as timed triples: a table per predicate and kind of object, in order of
    appearance."""
    groups, first, place = np.unique(
        found.predicate.astype(np.int64) * len(Kind) + found.kind,
        return_index=True,
        return_inverse=True,
    )
    tables = []
    for group in np.argsort(first).tolist():
        rows = np.flatnonzero(place == group)
        predicate, kind = divmod(int(groups[group]), len(Kind))
        column = ObjectColumn(Kind(kind), _values(Kind(kind), found.object[rows]))
        tables.append(TripleRows(time[rows], valid[rows], found.subject[rows], {predicate: column}))
    return TimedTriples(dictionary, tuple(tables))


def decode_ntriples(data: bytes, time: int, dictionary: TermDictionary) -> TimedTriples:
    """The triples of one text, all at ``time``; a `TripleReader` for several texts is faster."""
    return TripleReader(dictionary).triples(data, time)


def decode_nquads(data: bytes, dictionary: TermDictionary) -> TimedTriples:
    """The triples of timestamped graphs; see `TripleReader`."""
    return TripleReader(dictionary).graphs(data)


_LINES = (RdfFormat.N_TRIPLES, RdfFormat.N_QUADS)
_GUARDS = {RdfFormat.JSON_LD: "jsonld"}


def line_of(found: Statements, row: int) -> int | None:
    """The line of a statement, counted from 1; None if the parser gives none."""
    return None if found.line is None else int(found.line[row])


def _check(data: bytes, format: RdfFormat) -> None:
    """Refuse a text that nests too deeply for the parser, which recurses."""
    try:
        check_document(data.decode(errors="replace"), _GUARDS.get(format, "turtle"))
    except OntologyError as error:
        place = "" if error.column is None else f"column {error.column}: "
        raise WireError(error.line, f"{place}{error.message}", error.hint) from None


def _refusal(error: SyntaxError) -> WireError:
    if "LoadDocumentCallback" in str(error):
        return WireError(
            None,
            "the document names a remote JSON-LD context, and contexts are never fetched",
            "put the context into the document itself",
        )
    cause = error.msg.partition(": ")[2] or error.msg
    return WireError(error.lineno, f"column {error.offset}: {cause}")


def _time(term: Term, line: int | None) -> int:
    datatype = term.datatype.value.removeprefix(XSD) if isinstance(term, Literal) else ""
    try:
        if datatype in ("dateTime", "dateTimeStamp"):
            return parse_time(term.value)
        if datatype == "integer" and TIME_MIN <= int(term.value) <= TIME_MAX:
            return int(term.value)
    except ValueError as error:
        raise WireError(line, str(error)) from None
    raise WireError(line, f"{term} is no time", "write an xsd:dateTime, or an xsd:integer in ns")


def object_bits(kind: Kind, value: Any) -> int:
    """The value of an object as an integer of 64 bits, for `Statements`."""
    if kind.dtype == np.float64:
        return int(np.float64(value).view(np.int64))
    return int(value)


def _canonical(kind: Kind, values: NDArray[np.float64], spelled: list[bytes]) -> NDArray[np.bool_]:
    """Which texts equal `number_text` of their values."""
    # JSON's shortest digits nearly always agree, at a tenth of the cost.
    shortest = msgspec.json.encode(values.tolist())[1:-1].split(b",") if spelled else ()
    return np.array(
        [
            short == text or number_text(kind, value) == text.decode()
            for value, short, text in zip(values.tolist(), shortest, spelled, strict=True)
        ],
        np.bool_,
    )


def object_value(kind: Kind, bits: np.int64) -> Any:
    """The value of an object of `Statements`; the inverse of `object_bits`."""
    return _values(kind, np.array([bits]))[0]


def _values(kind: Kind, bits: NDArray[np.int64]) -> NDArray[Any]:
    return bits.view(np.float64) if kind.dtype == np.float64 else bits.astype(kind.dtype)
