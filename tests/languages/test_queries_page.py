"""docs/reference/queries.md: what it shows is parsed, printed and refused as it says."""

import re

import pytest
from places import ROOT

from dyknow.languages.csparql import (
    Dialect,
    body_sparql,
    format_query,
    parse_query,
    parse_template,
)
from dyknow.languages.errors import LanguageError

PAGE = (ROOT / "docs" / "reference" / "queries.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```sparql\n(.*?)```", PAGE, re.S)
REFUSED = re.findall(r"```sparql refused\n(.*?)```\n\n```text\n(.*?)```", PAGE, re.S)


def rows(heading: str) -> list[list[str]]:
    """The rows of the table below a heading, cell by cell."""
    table = re.search(rf"\| {heading} .*\n\|[-|]+\n((?:\|.*\n)+)", PAGE)
    assert table is not None
    return [[c.strip() for c in line.strip("|").split("|")] for line in table[1].splitlines()]


@pytest.mark.parametrize("text", EXAMPLES)
def test_examples_are_parsed(text: str) -> None:
    if "TEMPLATE" in text:
        assert body_sparql(parse_template(text).query)
        return
    query = parse_query(text)
    assert format_query(parse_query(format_query(query))) == format_query(query)


def test_there_is_one_question_in_each_dialect() -> None:
    queries = [parse_query(text) for text in EXAMPLES[:4]]
    assert [query.dialect for query in queries] == [*[Dialect.C_SPARQL] * 3, Dialect.RSP_QL]
    assert [query.streams[0].window for query in queries] == [queries[0].streams[0].window] * 4


@pytest.mark.parametrize(("what", "dialect", "clause"), rows("clause"))
def test_clauses(what: str, dialect: str, clause: str) -> None:
    text = clause.strip("`")
    register = text if text.startswith("REGISTER") else ""
    prefix = text if text.startswith("PREFIX") else ""
    source = text if text.startswith("FROM") else ""
    end = text if text.startswith("WINDOW") else "WINDOW [RANGE 5s STEP 1s]"
    query = parse_query(
        f"PREFIX : <http://e/> {prefix}\n{register}\nSELECT ?x {source}\n"
        f"WHERE {{ ?x ?p ?y }}\n{end}"
    )
    if dialect != "both":
        assert query.dialect == dialect
    assert what


@pytest.mark.parametrize(("written", "holds", "printed"), rows("written"))
def test_windows(written: str, holds: str, printed: str) -> None:
    query = parse_query(
        "PREFIX xsd: <http://www.w3.org/2001/XMLSchema#>\nREGISTER QUERY q EVERY 10s AS\n"
        f"SELECT ?x FROM STREAM <http://e/s> {written.strip('`')} {{ ?x xsd:p ?y }}"
    )
    assert printed.strip("`") in format_query(query)
    assert holds


@pytest.mark.parametrize(("function", "tells"), rows("function"))
def test_functions(function: str, tells: str) -> None:
    call = function.strip("`")
    parse_query(f"SELECT ({call} AS ?t) FROM STREAM <http://e/s> [TRIPLES 1] {{ ?s ?p ?o, ?x }}")
    assert tells


@pytest.mark.parametrize(("text", "error"), REFUSED)
def test_errors(text: str, error: str) -> None:
    with pytest.raises(LanguageError) as caught:
        parse_query(text)
    assert caught.value.render().strip() == error.strip()


def test_the_page_shows_something() -> None:
    assert len(EXAMPLES) >= 8
    assert len(REFUSED) >= 4
