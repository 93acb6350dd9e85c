"""docs/how-to/ask-the-system.md: each of its questions, asked, has the answer that is printed
there."""

import re

import pytest
from places import ROOT
from pyoxigraph import NamedNode

from dyknow.engine.engine import Engine
from dyknow.rdf.namespaces import shorten

PAGE = (ROOT / "docs" / "how-to" / "ask-the-system.md").read_text(encoding="utf-8")
QUESTIONS = re.findall(r"^## (\d+)\. .*\n\n```sparql\n([^`]*)```\n\n((?:\|.*\n)+)", PAGE, re.M)


def block(kind: str) -> str:
    found = re.search(rf"```{kind}\n(.*?)```", PAGE, re.S)
    assert found is not None
    return found[1]


@pytest.fixture(scope="module")
def system() -> Engine:
    """As the page describes it."""
    engine = Engine()
    template = ROOT / "templates" / "library" / "high_speed.rq"
    engine.annotate(block("ssl"))
    engine.register_template(template.read_text(encoding="utf-8"))
    engine.request_event(engine.parse_request("dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)"))
    engine.add_kpl(block("kpl"))
    engine.tick(10**9)
    return engine


def shown(term: object) -> str:
    value = getattr(term, "value", "")
    return shorten(value).replace("dyknow-o:", ":") if isinstance(term, NamedNode) else value


@pytest.mark.parametrize(("number", "query", "table"), QUESTIONS, ids=[q[0] for q in QUESTIONS])
def test_the_page_has_the_answer(system: Engine, number: str, query: str, table: str) -> None:
    header, _, *lines = table.splitlines()
    names, rows = system.ontology.query_rows(query)
    assert [cell.strip() for cell in header.strip("|").split("|")] == list(names)
    expected = [[cell.strip().strip("`") for cell in line.strip("|").split("|")] for line in lines]
    answer = [[shown(term) for term in row] for row in rows]
    if "ORDER BY" not in query:
        expected, answer = sorted(expected), sorted(answer)
    assert answer == expected


def test_there_are_twenty_questions() -> None:
    assert [int(number) for number, _, _ in QUESTIONS] == list(range(1, 21))
