"""The W3C's SPARQL 1.1 tests as continuous queries: one window that holds the test's data.

A test's text is registered by putting `REGISTER QUERY q AS` before it and a WINDOW clause behind
it; its data are the elements of one stream at one time, read as a set. What Oxigraph and what our
own operators have answered is told apart by who is asked.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from enum import StrEnum
from functools import cache
from pathlib import Path

import pyoxigraph
import rdflib
from pyoxigraph import BlankNode, Literal, NamedNode, QuerySolutions, RdfFormat
from rdflib.collection import Collection
from rdflib.compare import isomorphic
from rdflib.namespace import RDF, XSD
from rdflib_definition import to_rdflib
from shared_data import DATA

from dyknow.continuous.algebra.options import Options, Semantics
from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.operators.background import Background
from dyknow.languages.csparql import parse_query
from dyknow.languages.errors import LanguageError
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.terms_to_columns import from_terms

FOLDER = DATA / "w3c" / "sparql" / "sparql11"
MF = rdflib.Namespace("http://www.w3.org/2001/sw/DataAccess/tests/test-manifest#")
QT = rdflib.Namespace("http://www.w3.org/2001/sw/DataAccess/tests/test-query#")
RS = rdflib.Namespace("http://www.w3.org/2001/sw/DataAccess/tests/result-set#")
UNRELATED = (NamedNode("urn:unrelated"),) * 3
STREAM = "urn:data"
EVALUATED = ("QueryEvaluationTest", "CSVResultFormatTest")
SYNTAX = ("PositiveSyntaxTest11", "NegativeSyntaxTest11")


NEEDS_NOTHING = {"aggregates/agg-avg-03", "construct/constructwhere04"}
"""Tests over no data that see every triple. All others without data get one of fresh terms, which
their patterns do not match: they name other predicates, or have no pattern at all."""

KNOWN = {
    "csv-tsv-res/tsv03": "xsd:negativeInteger is read as xsd:integer "
    "(docs/explanation/semantics.md, Values)",
    "syntax-query/test_4": "refused on purpose: a function that nobody knows",
    "functions/bnode01": "Oxigraph 0.5: BNODE(text) is one blank node for all solutions",
}
"""Tests that fail, and why. Each is expected to fail: one that passes has to leave this list."""


class Outcome(StrEnum):
    """How a test went; what was left out has its reason in ``Record.reason``."""

    COLUMNS = "columns"
    OXIGRAPH = "Oxigraph"
    LEFT_OUT = "left out"
    FAILED = "failed"


@dataclass(frozen=True)
class Case:
    """A test of a manifest. ``name`` is folder/identifier, unique in the suite."""

    folder: str
    name: str
    kind: str
    query: Path | None
    data: tuple[Path, ...]
    named: tuple[Path, ...]
    service: bool
    result: Path | None

    @property
    def text(self) -> str:
        assert self.query is not None
        return self.query.read_text(encoding="utf-8")


@dataclass(frozen=True)
class Record:
    """What became of a test; ``reason`` says why it was left out or how it failed."""

    case: Case
    outcome: Outcome
    reason: str = ""


@cache
def cases() -> tuple[Case, ...]:
    """Every entry of every folder's manifest, in their order."""
    found: list[Case] = []
    for manifest in sorted(FOLDER.glob("*/manifest.ttl")):
        graph = rdflib.Graph().parse(manifest, publicID=manifest.as_uri())
        for entries in graph.objects(None, MF.entries):
            found += [_case(graph, manifest, entry) for entry in Collection(graph, entries)]
    return tuple(found)


def _case(graph: rdflib.Graph, manifest: Path, entry: rdflib.URIRef) -> Case:
    action = graph.value(entry, MF.action)
    query = action if isinstance(action, rdflib.URIRef) else graph.value(action, QT.query)
    kind = graph.value(entry, RDF.type)
    return Case(
        folder=manifest.parent.name,
        name=f"{manifest.parent.name}/{str(entry).rpartition('#')[2]}",
        kind="" if kind is None else str(kind).rpartition("#")[2],
        query=_path(query),
        data=tuple(_path(one) for one in sorted(graph.objects(action, QT.data))),
        named=tuple(_path(one) for one in sorted(graph.objects(action, QT.graphData))),
        service=(action, QT.serviceData, None) in graph,
        result=_path(graph.value(entry, MF.result)),
    )


def _path(node: object) -> Path | None:
    text = str(node)
    return Path(text.removeprefix("file://")) if text.startswith("file://") else None


def registered(case: Case) -> str:
    """The text as a continuous query; the line end is for a comment that ends it.

    Relative IRIs in it are relative to its file, which no text can tell by itself.
    """
    assert case.query is not None
    base = f"BASE <{case.query.as_uri()}>"
    return f"REGISTER QUERY q AS {base} {case.text}\nWINDOW [RANGE 1s STEP 1s]"


def is_parsed_rightly(case: Case) -> bool:
    """Whether the product takes a text of right syntax and refuses one of wrong syntax."""
    try:
        parse_query(registered(case))
    except LanguageError:
        return case.kind == "NegativeSyntaxTest11"
    return case.kind == "PositiveSyntaxTest11"


def record(case: Case, semantics: Semantics = "set") -> Record:
    """Runs one evaluation test."""
    reason = left_out(case)
    if reason:
        return Record(case, Outcome.LEFT_OUT, reason)
    try:
        result, evaluated_by = solve(case, semantics)
    except (LanguageError, ValueError) as error:
        return Record(case, Outcome.FAILED, f"{type(error).__name__}: {error}")
    if not agrees(case, result):
        return Record(case, Outcome.FAILED, "another result")
    return Record(case, evaluated_by)


def left_out(case: Case) -> str:
    """Why a test cannot be put as a continuous query, or ''."""
    if case.kind == "ProtocolTest" or case.kind == "ServiceDescriptionTest":
        return "of the HTTP protocol, not of queries"
    if case.kind not in EVALUATED:
        return "syntax only: see the second table"
    if case.service or "SERVICE" in case.text:
        return "SERVICE: a continuous query asks no other endpoint"
    if case.name in NEEDS_NOTHING:
        return "no data: a window without elements gives no result"
    return ""


def triples(case: Case) -> list:
    """The default graph; IRIs are relative to the file they stand in."""
    return [
        (t.subject, t.predicate, t.object)
        for path in case.data
        for t in pyoxigraph.parse(
            path.read_bytes(),
            format=RdfFormat.from_extension(path.suffix[1:]),
            base_iri=path.as_uri(),
        )
    ]


def solve(case: Case, semantics: Semantics = "set") -> tuple[object, Outcome]:
    """The result of the one window, and who has evaluated it."""
    dictionary = TermDictionary()
    graphs = {path.as_uri(): path for path in case.named}
    # The test's dataset comes from outside: as if its text had a FROM NAMED for each graph.
    query = replace(parse_query(registered(case)), static_named=tuple(graphs))
    graphs |= {iri: Path(iri.removeprefix("file://")) for iri in query.static}
    background = Background.from_files(graphs, default=query.static)
    evaluator = ContinuousEvaluator(query, dictionary, background, [STREAM], Options(semantics))
    asked: list[int] = []
    original = evaluator._solver.oxigraph.solve

    def counted(*arguments):
        asked.append(1)
        return original(*arguments)

    evaluator._solver.oxigraph.solve = counted
    elements = [(1, *triple) for triple in triples(case) or [UNRELATED]]
    evaluator.push(STREAM, from_terms(elements, dictionary))
    (result,) = evaluator.end(STREAM)
    return result, Outcome.OXIGRAPH if asked else Outcome.COLUMNS


# -- comparing -------------------------------------------------------------------------------


def agrees(case: Case, result) -> bool:
    """Whether a window's result is the expected one: blank nodes by a bijection, rows in order
    where the query has ORDER BY, numbers and booleans of one datatype by value."""
    assert case.result is not None
    if result.triples is not None:
        expected = rdflib.Graph().parse(case.result, publicID=case.result.as_uri())
        return isomorphic(
            _graph((s, p, o) for _, s, p, o in result.triples), _graph(iter(expected))
        )
    if result.answer is not None:
        return result.answer == _expected_answer(case.result)
    ordered = "ORDER BY" in case.text.upper()
    found = result.solutions.rows()
    if case.result.suffix == ".csv":
        return _csv_agrees(case.result, result.solutions.variables, found)
    names, rows = _expected_rows(case.result)
    return set(names) == set(result.solutions.variables) and isomorphic(
        table(found, ordered), table(rows, ordered)
    )


def _expected_answer(path: Path) -> bool:
    return bool(pyoxigraph.parse_query_results(path=str(path)))


def _expected_rows(path: Path) -> tuple[list[str], list[Mapping[str, object]]]:
    if path.suffix == ".ttl":
        return _result_set(rdflib.Graph().parse(path))
    found = pyoxigraph.parse_query_results(path=str(path))
    assert isinstance(found, QuerySolutions)
    names = [variable.value for variable in found.variables]
    return names, [{name: row[name] for name in names if row[name] is not None} for row in found]


def _result_set(graph: rdflib.Graph) -> tuple[list[str], list[Mapping[str, object]]]:
    """A table in the result-set vocabulary."""
    (table,) = graph.subjects(RDF.type, RS.ResultSet)
    names = [str(name) for name in graph.objects(table, RS.resultVariable)]
    return names, [
        {
            str(graph.value(binding, RS.variable)): graph.value(binding, RS.value)
            for binding in graph.objects(row, RS.binding)
        }
        for row in graph.objects(table, RS.solution)
    ]


def table(rows: Sequence[Mapping[str, object]], ordered: bool) -> rdflib.Graph:
    """Rows as a graph: equal up to the names of blank nodes iff the graphs are isomorphic."""
    graph = rdflib.Graph()
    for number, row in enumerate(rows):
        node = rdflib.BNode()
        graph.add((node, RDF.type, RS.ResultSolution))
        if ordered:
            graph.add((node, RS["index"], rdflib.Literal(number)))
        for name, value in row.items():
            graph.add((node, RS[name], _by_value(value)))
    return graph


def _graph(triples: Iterable[tuple]) -> rdflib.Graph:
    graph = rdflib.Graph()
    for triple in triples:
        graph.add(tuple(map(_by_value, triple)))
    return graph


def _by_value(term: object) -> object:
    """A number in one spelling of its datatype; any other term as it is."""
    term = to_rdflib(term)
    if not isinstance(term, rdflib.Literal):
        return term
    text, kind = str(term), term.datatype
    if kind == XSD.string:
        return rdflib.Literal(text)
    try:
        if kind in (XSD.double, XSD.float):
            text = f"{float(text):.12g}"
        elif kind in (XSD.decimal, XSD.integer):
            text = f"{Decimal(text).normalize():f}"
        elif kind == XSD.boolean:
            text = {"0": "false", "1": "true"}.get(text, text)
        elif term.language:
            return rdflib.Literal(text, lang=term.language.lower())
    except (InvalidOperation, ValueError):
        pass
    return rdflib.Literal(text, datatype=kind, normalize=False)


def _csv_agrees(path: Path, variables: Sequence[str], found: Sequence[Mapping]) -> bool:
    with path.open(newline="", encoding="utf-8") as file:
        names, *rows = csv.reader(file)
    ours = [[_plain(row.get(name)) for name in names] for row in found]
    return set(names) == set(variables) and sorted(map(_csv_row, rows)) == sorted(
        map(_csv_row, ours)
    )


def _csv_row(row: Iterable[str]) -> list[str]:
    return [_csv_value(value) for value in row]


def _plain(term: object) -> str:
    match term:
        case None:
            return ""
        case BlankNode():
            return "_:"
        case NamedNode() | Literal():
            return term.value
    raise AssertionError(f"{term} is no term of a stream")


def _csv_value(text: str) -> str:
    """CSV has no datatypes: numbers by value, blank nodes without their name."""
    if text.startswith("_:"):
        return "_:"
    try:
        return f"{float(text):.12g}"
    except ValueError:
        return text
