"""Recorded timed triples as files, for ``dyknow run``: NDJSON or CSV of time, s, p, o, or graphs.

    {"time": "2021-10-07T19:12:53Z", "s": "dyknow:uav1", "p": "dyknow:speed", "o": 31.5}
    time,s,p,o
    1633633973000000000,dyknow:uav1,dyknow:speed,31.5

A time is ISO-8601 or integer nanoseconds. A term is written as in a request: ``dyknow:uav1``,
``<iri>``, ``31.5``, ``"text"@en``; an absolute IRI may stand without brackets, ``_:b`` is a blank
node. In NDJSON a number or boolean stands for itself.

N-Quads and TriG (``.nq``, ``.trig``) hold timestamped graphs, see `converters.rdf.ntriples`:

    <urn:g1> <http://www.w3.org/ns/prov#generatedAtTime> "2021-10-07T19:12:53Z"^^xsd:dateTime .
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import IO

import msgspec
from pyoxigraph import BlankNode, NamedNode, RdfFormat, Variable

from ....converters.errors import WireError
from ....converters.rdf.ntriples import TripleReader
from ....converters.recordings.text_files import ending, read_whole
from ....converters.wire import not_json
from ....languages.csparql import parse_argument
from ....languages.errors import LanguageError
from ....rdf.dictionary import Term, TermDictionary
from ....rdf.timed import TimedTriples
from ....streams.time import format_time, parse_time, read_time

TimedTriple = tuple[int, Term, NamedNode, Term]
_COLUMNS = ("time", "s", "p", "o")
_IRI = re.compile(r"(?:https?|urn|tag|file):[^\s<>\"{}|^`\\]*\Z")
_GRAPHS = {".nq": RdfFormat.N_QUADS, ".trig": RdfFormat.TRIG}


def holds_graphs(path: Path) -> bool:
    """Whether `read_timed_graphs` reads the file, and not `read_timed_triples`."""
    return ending(path) in _GRAPHS


def read_timed_graphs(path: Path, dictionary: TermDictionary) -> TimedTriples:
    """The triples of a file of timestamped graphs, each at its graph's time.

    Raises `WireError` with the line, `OSError` when the file cannot be read.
    """
    return TripleReader(dictionary).graphs(read_whole(path), _GRAPHS[ending(path)])


def read_timed_triples(path: Path) -> Iterator[TimedTriple]:
    """The file's triples in its own order.

    Raises `WireError` with the line, `OSError` when the file cannot be read.
    """
    kind = ending(path)
    if kind not in (".ndjson", ".jsonl", ".csv"):
        if kind in (".nt", ".ttl"):
            raise WireError(
                None,
                f"{path.name} says no times",
                "put its triples into graphs with prov:generatedAtTime, in a file .nq or .trig",
            )
        raise WireError(
            None,
            f"{path.name}: unknown kind of triples",
            "timed triples end in .ndjson, .csv, .nq or .trig; for a table of samples give --ssl",
        )
    file = io.StringIO(_text(read_whole(path)), newline="")
    for line, values in _csv_rows(file) if kind == ".csv" else _json_rows(file):
        try:
            yield _triple(values)
        except (ValueError, LanguageError) as error:
            cause = error.message if isinstance(error, LanguageError) else str(error)
            raise WireError(line, cause) from error


def _text(data: bytes) -> str:
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise WireError(line, f"no UTF-8: {error.reason}") from error


class TripleWriter:
    """Writes timed triples as NDJSON that `read_timed_triples` reads, one by one.

    Refuses a name that would not be read again with `WireError`; ``OSError`` as of files.
    """

    def __init__(self, path: Path) -> None:
        if not path.name.lower().endswith((".ndjson", ".jsonl")):
            raise WireError(
                None, f"{path.name}: timed triples are written as .ndjson", "name the file so"
            )
        self._file = path.open("wb")
        self._encoder = msgspec.json.Encoder()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def write(self, triple: TimedTriple) -> None:
        """Append a triple."""
        time, *terms = triple
        row = dict(zip(_COLUMNS, (format_time(time), *map(str, terms)), strict=True))
        self._file.write(self._encoder.encode(row) + b"\n")


def _json_rows(file: IO[str]) -> Iterator[tuple[int, list[object]]]:
    for number, line in enumerate(file, 1):
        if not line.strip():
            continue
        try:
            row = msgspec.json.decode(line)
        except RecursionError:
            raise WireError(number, "the value is nested too deeply") from None
        except msgspec.MsgspecError as error:
            raise WireError(number, not_json(error)) from error
        if not isinstance(row, dict) or set(row) != set(_COLUMNS):
            raise WireError(number, 'a timed triple is {"time", "s", "p", "o"}')
        yield number, [row[name] for name in _COLUMNS]


def _csv_rows(file: IO[str]) -> Iterator[tuple[int, list[object]]]:
    reader = csv.reader(file)
    names = [name.strip().lower() for name in next(reader, [])]
    if sorted(names) != sorted(_COLUMNS):
        raise WireError(1, "the columns of timed triples are time,s,p,o")
    order = [names.index(name) for name in _COLUMNS]
    for row in reader:
        if not row:
            continue
        if len(row) != len(names):
            raise WireError(reader.line_num, f"{len(row)} cells, but the header has 4")
        yield reader.line_num, [row[i] for i in order]


def _triple(values: list[object]) -> TimedTriple:
    time, subject, predicate, object = values
    if isinstance(time, str):
        moment = read_time(time)
    elif isinstance(time, int):
        moment = parse_time(time)
    else:
        raise ValueError(f"{time!r} is no time")
    property = _term(predicate)
    if not isinstance(property, NamedNode):
        raise ValueError(f"a predicate is an IRI, got {predicate!r}")
    return moment, _term(subject), property, _term(object)


def _term(value: object) -> Term:
    if isinstance(value, bool):
        return _parsed("true" if value else "false")
    if isinstance(value, int | float):
        return _parsed(repr(value))
    if isinstance(value, str):
        return _parsed(value.strip())
    raise ValueError(f"{value!r} is no term")


@lru_cache(maxsize=100_000)
def _parsed(text: str) -> Term:
    if _IRI.match(text):
        return NamedNode(text)
    if text.startswith("_:"):
        return BlankNode(text[2:])
    term = parse_argument(text)
    if isinstance(term, Variable):
        raise ValueError(f"{text} is a variable, not a term")
    return term
