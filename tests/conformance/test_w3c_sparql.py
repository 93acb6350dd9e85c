"""The W3C's SPARQL 1.1 query tests, each as a continuous query over one window of its data.

How a test is put as a continuous query, which are left out and why, and which fail, is in
`w3c_sparql`. `DYKNOW_REWRITE=1 pytest tests/conformance/test_w3c_sparql.py` writes the tables of
docs/reference/sparql-conformance.md anew.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

import pytest
import w3c_sparql as w3c
import w3c_table
from places import ROOT
from pyoxigraph import BlankNode, Literal, NamedNode, Store
from rdflib.compare import isomorphic
from shared_data import needs
from w3c_sparql import Case, Outcome

from dyknow.sparql import LanguageError, parse_sparql, print_query

pytestmark = needs(w3c.FOLDER)

DOCUMENT = ROOT / "docs" / "reference" / "sparql-conformance.md"
BEGIN, END = "<!-- tables: begin -->\n", "<!-- tables: end -->\n"


def parameter(case: Case) -> object:
    reason = w3c.KNOWN.get(case.name)
    marks = (
        []
        if reason is None
        else [pytest.mark.xfail(raises=AssertionError, strict=True, reason=reason)]
    )
    return pytest.param(case, id=case.name, marks=marks)


def those(*kinds: str) -> list:
    """The tests of these kinds that are not left out; one stands in where there are no data."""
    found = [case for case in w3c.cases() if case.kind in kinds]
    return [parameter(case) for case in found if case.kind in w3c.SYNTAX or not w3c.left_out(case)]


@pytest.mark.parametrize("semantics", ["set", "bag"])
@pytest.mark.parametrize("case", those(*w3c.EVALUATED) or [None])
def test_evaluation(case, semantics) -> None:
    """The data are a set, so the bag gives the same, by other operators."""
    result = w3c.record(case, semantics)
    assert result.outcome in (Outcome.COLUMNS, Outcome.OXIGRAPH), result.reason


@pytest.mark.parametrize("case", those(*w3c.SYNTAX) or [None])
def test_syntax(case) -> None:
    assert w3c.is_parsed_rightly(case)


@pytest.mark.parametrize("path", sorted(w3c.FOLDER.rglob("*.rq")) or [None], ids=str)
def test_the_parser_takes_what_oxigraph_takes(path) -> None:
    """And what it prints of it is SPARQL to Oxigraph, and the same query to itself."""
    text = f"BASE <http://example.org/> {path.read_text(encoding='utf-8')}"
    assert "<<" not in text
    try:
        query = parse_sparql(text, {})
    except LanguageError:
        with pytest.raises(SyntaxError):
            read_by_oxigraph(text)
        return
    read_by_oxigraph(text)
    printed = print_query(query)
    read_by_oxigraph(printed)
    assert parse_sparql(printed, {}) == query


def read_by_oxigraph(text: str) -> None:
    """Arguments that contradict each other are refused once the text is read."""
    with pytest.raises(ValueError, match="default_graph"):
        Store().query(text, use_default_graph_as_union=True, default_graph=NamedNode("urn:none"))


def test_every_known_failure_is_a_test_that_runs() -> None:
    run = {p.values[0].name for p in those(*w3c.EVALUATED, *w3c.SYNTAX)}
    assert set(w3c.KNOWN) <= run


def test_the_document_says_what_is_measured() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    measured = f"{before}{BEGIN}\n{w3c_table.tables()}\n\n{END}{after}"
    if os.environ.get("DYKNOW_REWRITE") == "1":
        DOCUMENT.write_text(measured, encoding="utf-8")
        return
    assert text == measured


ROWS = [{"x": BlankNode("a"), "y": Literal(1)}, {"x": BlankNode("a"), "y": Literal(2)}]


@pytest.mark.parametrize(
    ("other", "ordered", "same"),
    [
        ([{"x": BlankNode("b"), "y": Literal(1)}, {"x": BlankNode("b"), "y": Literal(2)}], 0, 1),
        ([{"x": BlankNode("b"), "y": Literal(1)}, {"x": BlankNode("c"), "y": Literal(2)}], 0, 0),
        (ROWS[::-1], 0, 1),
        (ROWS[::-1], 1, 0),
        (ROWS[:1], 0, 0),
        ([*ROWS, ROWS[0]], 0, 0),
        ([ROWS[0], {"x": BlankNode("a")}], 0, 0),
        ([ROWS[0], {"x": BlankNode("a"), "y": Literal(2.0)}], 0, 0),
    ],
    ids=["names", "nodes", "order", "ordered", "fewer", "more", "unbound", "datatype"],
)
def test_the_comparison_of_tables(
    other: Sequence[Mapping[str, object]], ordered: int, same: int
) -> None:
    assert isomorphic(w3c.table(ROWS, bool(ordered)), w3c.table(other, bool(ordered))) == bool(same)
