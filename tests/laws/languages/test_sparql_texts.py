"""Laws of the parser of SPARQL: it takes what rdflib and Oxigraph take, and reads the same."""

from __future__ import annotations

import re
from collections import Counter
from typing import Any

import query_ast as q
import query_drawing as drawing
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import NamedNode, Quad, Store
from rdflib.plugins.sparql.parser import parseQuery

from dyknow.sparql import LanguageError, parse_sparql, print_query

AREAS = [
    drawing.joined,
    drawing.existing,
    drawing.walked,
    drawing.expressed,
    drawing.summed,
    lambda draw: drawing.star(drawing.patterned(draw)),
]


@st.composite
def queries(draw: st.DrawFn) -> str:
    """The text of a query of any area, with its signs as close as they may stand."""
    text = q.show_query(draw(st.sampled_from(AREAS))(draw))
    if draw(st.booleans()):
        text = re.sub(r" (<=|>=|!=|[=<>+*/]|&&|\|\|) (?=[?$\d(])", r"\1", text)
    return text


def store() -> Store:
    found = Store()
    found.extend(Quad(s, p, o) for s, p, o in drawing.STATIC)
    return found


def answer(text: str) -> Any:
    found = store().query(text)
    if hasattr(found, "variables"):
        names = [variable.value for variable in found.variables]
        return sorted(names), Counter(
            frozenset((name, row[name]) for name in names) for row in found
        )
    return bool(found)


@settings(deadline=None, max_examples=300)
@given(queries())
def test_what_is_drawn_is_read_as_by_oxigraph(text: str) -> None:
    """The tree printed, in brackets and with spaces, has the answer of the text."""
    query = parse_sparql(text, {})
    printed = print_query(query)
    assert parse_sparql(printed, {}) == query
    assert answer(printed) == answer(text)


@settings(deadline=None, max_examples=100)
@given(queries())
def test_what_is_drawn_is_read_by_rdflib_printed(text: str) -> None:
    parseQuery(print_query(parse_sparql(text, {})))


WORDS = """{ } ( ) [ ] . ; , ?a ?b :p a <urn:x> _:n 1 -1 +2 .5 1e3 'x' 'x'@en true () [] < <= > = !=
&& || ! + - * / ^ | SELECT DISTINCT WHERE FILTER OPTIONAL UNION MINUS GRAPH BIND AS VALUES UNDEF
EXISTS NOT IN COUNT SUM STRLEN BOUND IF CONCAT GROUP BY HAVING ORDER LIMIT 5 OFFSET ASK"""
PIECES = WORDS.split()
BEGINNINGS = ["ASK {", "SELECT * {", "SELECT ?a {", "ASK { FILTER(", "SELECT (", "CONSTRUCT {"]
PREFIXES = {"": "http://e/"}


@st.composite
def scraps(draw: st.DrawFn) -> str:
    """Nearly a query: a beginning, pieces in any order, brackets closed."""
    text = draw(st.sampled_from(BEGINNINGS))
    text += " " + " ".join(draw(st.lists(st.sampled_from(PIECES), max_size=8)))
    opened: list[str] = []
    for sign in text:
        if sign in "({[":
            opened.append({"(": ")", "{": "}", "[": "]"}[sign])
        elif opened and sign == opened[-1]:
            opened.pop()
    return text + " " + " ".join(reversed(opened))


def refusal(text: str) -> LanguageError | None:
    try:
        parse_sparql(text, PREFIXES)
    except LanguageError as error:
        return error
    return None


def taken_by_oxigraph(text: str) -> bool:
    """Arguments that contradict each other are refused once the text is read."""
    try:
        Store().query(
            text,
            prefixes=PREFIXES,
            use_default_graph_as_union=True,
            default_graph=NamedNode("urn:none"),
        )
    except SyntaxError:
        return False
    except ValueError as error:
        if "default_graph" not in str(error):
            raise
    return True


@settings(deadline=None, max_examples=600)
@given(scraps())
def test_scraps_are_taken_as_by_oxigraph(text: str) -> None:
    error = refusal(text)
    assert (error is None) == taken_by_oxigraph(text)
    if error is not None:
        assert error.source == text
        assert 0 <= error.span.start <= error.span.end <= len(text)
