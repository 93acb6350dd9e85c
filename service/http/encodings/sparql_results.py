"""Answers to queries in the formats of SPARQL 1.1, for ``/sparql`` and ``/queries``.

Results of continuous queries are columns. This module makes SPARQL JSON of them, and Oxigraph
makes every other format of that, so that both routes write alike.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from fastapi import Request, Response
from pyoxigraph import (
    BlankNode,
    DefaultGraph,
    Literal,
    NamedNode,
    Quad,
    QueryResultsFormat,
    Triple,
    parse_query_results,
    serialize,
)

from ....continuous.operators.results import WindowResult
from ....converters.rdf.ntriples import GENERATED
from ....rdf.dictionary import Term
from ....rdf.namespaces import PREFIXES, XSD
from ....streams.time import format_time
from ...config.media_types import JSON, NQUADS, SPARQL_JSON, SPARQL_XML, TRIG
from ..negotiation import accepted
from ..problems import Problem
from . import sparql_formats

RESULTS = sparql_formats.TABLES
GRAPHS = sparql_formats.GRAPHS
# SPARQL 1.1 has no CSV or TSV of a boolean.
BOOLEANS = {kind: RESULTS[kind] for kind in (SPARQL_JSON, JSON, SPARQL_XML)}
WINDOW_END = "window_end"
"""The column with the end of a row's window, in a table of several windows."""
ANSWER = "answer"
"""The column of the answers of ASK there."""
_STRING = XSD + "string"
_DATE_TIME = NamedNode(XSD + "dateTime")


def answer(body: bytes | None, kind: str) -> Response:
    """The answer with a serialized result."""
    return Response(body or b"", media_type=kind)


def one_window(request: Request, result: WindowResult, most: int) -> Response:
    """The answer with the result of a window.

    Raises a 406 `Problem`, and a 422 one if its terms have more than ``most`` characters: columns
    keep a text once, an answer repeats it for every solution.
    """
    if result.triples is not None:
        return _graph(request, [result], most)
    if result.solutions is not None:
        return _table(request, result.solutions.variables, result.solutions.rows(), most)
    kind = accepted(request, tuple(BOOLEANS))
    told = json.dumps({"head": {}, "boolean": bool(result.answer)})
    return answer(_written(told, BOOLEANS[kind]), kind)


def many_windows(
    request: Request,
    results: Sequence[WindowResult],
    form: str,
    variables: Sequence[str],
    most: int,
    stream: str,
) -> Response:
    """The answer with the results of several windows: one table, whose first column is the end of
    a row's window, or one graph; in N-Quads and TriG a timestamped graph for each window, named
    after ``stream`` (an IRI). ``variables`` are the columns if no window has solutions.

    Raises `Problem` as `one_window`.
    """
    if form in ("CONSTRUCT", "DESCRIBE"):
        return _graph(request, results, most, stream)
    told = next(
        (each.solutions.variables for each in results if each.solutions is not None), variables
    )
    names = [ANSWER] if form == "ASK" else list(told)
    end = WINDOW_END
    while end in names:
        end += "_"
    rows: list[Mapping[str, Term]] = []
    for result in results:
        time = Literal(format_time(result.end), datatype=NamedNode(XSD + "dateTime"))
        if result.solutions is not None:
            rows += [{end: time, **row} for row in result.solutions.rows()]
        else:
            rows.append({end: time, ANSWER: Literal(bool(result.answer))})
    return _table(request, [end, *names], rows, most)


def _table(
    request: Request, variables: Sequence[str], rows: Sequence[Mapping[str, Term]], most: int
) -> Response:
    kind = accepted(request, tuple(RESULTS))
    told = json.dumps(_table_json(variables, rows, most))
    return answer(_written(told, RESULTS[kind]), kind)


def result_json(result: WindowResult, most: int) -> dict[str, Any]:
    """The result of a window as SPARQL JSON; a graph as N-Triples, under ``graph``. Raises a 422
    `Problem` as `one_window`."""
    if result.solutions is not None:
        return _table_json(result.solutions.variables, result.solutions.rows(), most)
    if result.triples is None:
        return {"head": {}, "boolean": bool(result.answer)}
    lines = [f"{s} {p} {o} ." for _, s, p, o in result.triples]
    if sum(map(len, lines)) > most:
        raise result_too_large(f"{most} bytes")
    return {"graph": "\n".join(lines)}


def _table_json(
    variables: Sequence[str], rows: Sequence[Mapping[str, Term]], most: int
) -> dict[str, Any]:
    bindings, size = [], 0
    for row in rows:
        bindings.append({name: _json_term(term) for name, term in row.items()})
        size += sum(len(told["value"]) for told in bindings[-1].values())
        if size > most:
            raise result_too_large(f"{most} bytes")
    return {"head": {"vars": list(variables)}, "results": {"bindings": bindings}}


def _graph(
    request: Request, results: Sequence[WindowResult], most: int, stream: str = ""
) -> Response:
    """One graph; with ``stream`` (an IRI), in formats of several graphs, a timestamped graph for
    each window."""
    kind = accepted(request, tuple(GRAPHS))
    is_timed = bool(stream) and kind in (TRIG, NQUADS)
    quads: dict[Quad, None] = {}
    size = 0
    for result in results:
        assert result.triples is not None
        graph: NamedNode | DefaultGraph = DefaultGraph()
        if is_timed and len(result.triples):
            end = format_time(result.end)
            graph = NamedNode(f"{stream}/{end}")
            quads[Quad(graph, GENERATED, Literal(end, datatype=_DATE_TIME))] = None
        for _, subject, predicate, object in result.triples:
            assert isinstance(subject, NamedNode | BlankNode)
            quad = Quad(subject, predicate, object, graph)
            if quad not in quads:
                size += sum(len(term.value) for term in (subject, predicate, object))
                if size > most:
                    raise result_too_large(f"{most} bytes")
                quads[quad] = None
    if is_timed:
        prefixes = PREFIXES if kind == TRIG else {}
        written = serialize(quads, format=GRAPHS[kind], prefixes=dict(prefixes))
        return answer(written, kind)
    return graph_answer((quad.triple for quad in quads), kind)


def graph_answer(
    triples: Iterable[Triple], kind: str, prefixes: Mapping[str, str] = PREFIXES
) -> Response:
    """The answer with a graph. Raises a 400 `Problem` if the format cannot express it."""
    written = io.BytesIO()
    try:
        sparql_formats.write_graph(triples, written, kind, prefixes)
    except sparql_formats.NotWritable as error:
        raise Problem(400, "query failed", str(error)) from error
    return answer(written.getvalue(), kind)


def result_too_large(most: str) -> Problem:
    """The problem of a result with more than ``most``."""
    return Problem(
        422,
        "result too large",
        f"the result has more than {most}",
        hint="ask for less: add a LIMIT, name the variables that are needed",
    )


def _written(told: str, format: QueryResultsFormat) -> bytes | None:
    if format is QueryResultsFormat.JSON:
        return told.encode()
    return parse_query_results(told, format=QueryResultsFormat.JSON).serialize(format=format)


def _json_term(term: Term) -> dict[str, str]:
    if isinstance(term, NamedNode):
        return {"type": "uri", "value": term.value}
    if isinstance(term, BlankNode):
        return {"type": "bnode", "value": term.value}
    told = {"type": "literal", "value": term.value}
    if term.language is not None:
        told["xml:lang"] = term.language
    elif term.datatype.value != _STRING:
        told["datatype"] = term.datatype.value
    return told
