"""docs/reference/chronicles.md: timelines are evaluated, examples compiled, errors compared."""

from __future__ import annotations

import re

import pytest
from chronicle_definition import Sample
from chronicle_worlds import Evaluation
from places import ROOT
from vocabularies import vocabulary_of

from dyknow.languages.chronicle import (
    check_chronicle,
    check_chronicle_template,
    format_chronicle,
    is_chronicle,
    parse_chronicle,
    parse_chronicle_template,
    with_arguments,
)
from dyknow.languages.chronicle.parser import MOST_ARGUMENTS, MOST_CLAUSES
from dyknow.languages.errors import LanguageError
from dyknow.languages.mtl.checked import Constant, Kind
from dyknow.rdf.namespaces import DYKNOW
from dyknow.reasoning.patterns.compilation.chronicle_plans import chronicle_query
from dyknow.reasoning.patterns.plans.plan import MOST_ELEMENTS, MOST_PROBES
from dyknow.reasoning.patterns.plans.query import PatternQuery

PAGE = (ROOT / "docs" / "reference" / "chronicles.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```chronicle\n(.*?)```", PAGE, re.S)
TEMPLATES = re.findall(r"```chronicle template\n(.*?)```", PAGE, re.S)
REFUSED = re.findall(r"```chronicle refused\n(.*?)```\n\n```text\n(.*?)```", PAGE, re.S)
TIMELINES = re.findall(r"```text timeline\n(.*?)```", PAGE, re.S)
ONTOLOGY = """
dyknow:Thing a owl:Class .
dyknow:UAV a owl:Class ; rdfs:subClassOf dyknow:Thing .
dyknow:RMAX a owl:Class ; rdfs:subClassOf dyknow:UAV , dyknow:Thing .
dyknow:speed a dyknow-o:Feature ; dyknow-o:hasUnit "km.h-1" .
dyknow:altitude a dyknow-o:Feature ; dyknow-o:hasUnit "ft" .
dyknow:distance a dyknow-o:Feature ; dyknow-o:hasArity 2 ; dyknow-o:hasUnit "m" .
dyknow:behind a dyknow-o:Feature ; dyknow-o:hasArity 2 ; rdfs:range xsd:boolean .
dyknow:beside a dyknow-o:Feature ; dyknow-o:hasArity 2 ; rdfs:range xsd:boolean .
dyknow:inFront a dyknow-o:Feature ; dyknow-o:hasArity 2 ; rdfs:range xsd:boolean .
dyknow:stopped a dyknow-o:Event .
dyknow:E a dyknow-o:Event .
dyknow:p a dyknow-o:Feature ; rdfs:range xsd:boolean .
"""
S = 10**9


VOCABULARY = vocabulary_of(ONTOLOGY)


def compiled(text: str) -> PatternQuery:
    checked = check_chronicle(parse_chronicle(text), text, VOCABULARY)
    return chronicle_query(checked, text, VOCABULARY)


def table(timeline: str) -> list[tuple[str, list[str]]]:
    """The rows of a timeline: a label, and a mark for each time."""
    lines = [re.split(r"\s{2,}", line, maxsplit=1) for line in timeline.strip().splitlines()]
    return [(label, marks.split()) for label, marks in lines]


def samples(rows: list[tuple[str, list[str]]]) -> list[Sample]:
    """The samples of the rows ``p`` and ``E``: at equal times those of the upper row first."""
    marked = [
        (time, name, mark == "#")
        for name, marks in rows
        if name in ("p", "E")
        for time, mark in enumerate(marks)
        if mark != "-"
    ]
    marked.sort(key=lambda each: each[0])
    return [
        Sample(number, DYKNOW + name, (DYKNOW + "a",), value, time * S)
        for number, (time, name, value) in enumerate(marked)
    ]


def matched(clauses: str, rows: list[tuple[str, list[str]]]) -> list[str]:
    text = f"chronicle N {{ {clauses}; when recognized {{ emit event(N, t) }} }}"
    evaluation = Evaluation(compiled(text))
    found = evaluation.push(samples(rows)) + evaluation.end()
    times = {each.valid // S for each in found}
    return ["#" if time in times else "-" for time in range(len(rows[0][1]))]


@pytest.mark.parametrize("timeline", TIMELINES)
def test_timelines_are_what_the_evaluator_gives(timeline: str) -> None:
    rows = table(timeline)
    clauses = [(label, marks) for label, marks in rows if "(" in label]
    assert clauses
    for label, marks in clauses:
        assert matched(label, rows) == marks, label


@pytest.mark.parametrize("text", EXAMPLES)
def test_examples_are_right(text: str) -> None:
    chronicle = parse_chronicle(text)
    assert is_chronicle(text)
    assert parse_chronicle(format_chronicle(chronicle)) == chronicle
    assert compiled(text).plans


@pytest.mark.parametrize("text", TEMPLATES)
def test_templates_are_right(text: str) -> None:
    assert is_chronicle(text)
    template = check_chronicle_template(parse_chronicle_template(text), VOCABULARY)
    values = {
        "limit": Constant(100.0, Kind.NUMBER),
        "longest": Constant(10**11, Kind.DURATION),
    }
    assert chronicle_query(with_arguments(template.chronicle, values, {}), text, VOCABULARY).plans


@pytest.mark.parametrize(("text", "error"), REFUSED)
def test_errors(text: str, error: str) -> None:
    with pytest.raises(LanguageError) as caught:
        compiled(text)
    assert caught.value.render().strip() == error.strip()


def test_the_page_shows_each_clause_and_each_limit() -> None:
    shown = "\n".join(TIMELINES)
    assert all(f"{word}(" in shown for word in ("event", "noevent", "occurs", "hold"))
    assert len(EXAMPLES) >= 3
    assert TEMPLATES
    assert len(REFUSED) == PAGE.count("```chronicle refused") >= 6
    for limit in (MOST_ELEMENTS, MOST_PROBES, MOST_CLAUSES, MOST_ARGUMENTS):
        assert f"| {limit} |" in PAGE
