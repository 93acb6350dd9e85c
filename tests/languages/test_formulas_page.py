"""docs/reference/formulas.md: timelines are evaluated, examples parsed, errors compared."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from places import ROOT
from vocabularies import vocabulary_of

from dyknow.engine.engine import Engine
from dyknow.languages.errors import LanguageError
from dyknow.languages.mtl import (
    check_mtl,
    format_monitor,
    is_formula_template,
    parse_monitor,
)
from dyknow.languages.mtl.ast import Report
from dyknow.languages.mtl.normal_form import normal_form
from dyknow.languages.mtl.parser import parse_formula
from dyknow.ontology.vocabulary import Vocabulary
from dyknow.rdf.namespaces import DYKNOW
from dyknow.reasoning.mtl.evaluator import MonitorEvaluator
from dyknow.reasoning.states.states import States, Values

PAGE = (ROOT / "docs" / "reference" / "formulas.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```mtl\n(.*?)```", PAGE, re.S)
TEMPLATES = re.findall(r"```mtl template\n(.*?)```", PAGE, re.S)
REFUSED = re.findall(r"```mtl refused\n(.*?)```\n\n```text\n(.*?)```", PAGE, re.S)
TIMELINES = re.findall(r"```text timeline\n(.*?)```", PAGE, re.S)

MARKS = {1: "#", 0: ".", -1: "?"}
ONTOLOGY = """
dyknow:UAV a owl:Class .
dyknow:p a dyknow-o:Feature ; rdfs:range xsd:boolean .
dyknow:q a dyknow-o:Feature ; rdfs:range xsd:boolean .
"""


def table(timeline: str) -> list[tuple[str, list[str]]]:
    """The rows of a timeline: a label, and a mark for each state."""
    lines = [re.split(r"\s{2,}", line, maxsplit=1) for line in timeline.strip().splitlines()]
    return [(label, marks.split()) for label, marks in lines]


def states_of(rows: dict[str, list[str]]) -> States:
    """The states of the rows ``p``, ``q``, or ``p(uav1)``, ``p(uav2)``; `-`: not present."""
    seconds = np.array(list(map(int, rows["time"])), np.int64)
    own = {label: marks for label, marks in rows.items() if re.fullmatch(r"[pq](\(\w+\))?", label)}
    objects = {label: DYKNOW + label[2:-1] for label in own if "(" in label}
    sort = DYKNOW + "UAV"
    values = {}
    for feature in sorted({label[0] for label in own}):
        columns = [marks for label, marks in own.items() if label[0] == feature]
        marks = np.array(columns).T if objects else np.array(columns[0])
        arguments = (sort,) if objects else ()
        values[DYKNOW + feature, arguments] = Values(marks == "#", np.isin(marks, ["#", "."]))
    there = np.array([own[label] for label in objects]).T != "-"
    present = there.reshape(len(seconds), len(objects))
    valid = seconds * 10**9
    names = {sort: tuple(objects.values())}
    return States(valid, valid, names, {sort: present}, values)


def verdicts(formula: str, states: States) -> tuple[list[str], list[str]]:
    """The verdict of each start, and the time (s) of the state that decides it; the states end."""
    text = f"monitor m = {formula} with report verdicts"
    evaluator = MonitorEvaluator(check_mtl(parse_monitor(text), text, vocabulary_of(ONTOLOGY)))
    needed = {term: states.values[term] for term in evaluator.terms}
    given = States(states.valid, states.valid, states.objects, states.present, needed)
    found = [evaluator.push(given), evaluator.end()]
    marks, decided = {}, {}
    for part in found:
        for i, start in enumerate(part.start_time.tolist()):
            marks[start] = MARKS[int(part.value[i])]
            decided[start] = str(int(part.decided_time[i]) // 10**9)
    return [marks[s] for s in sorted(marks)], [decided[s] for s in sorted(decided)]


@pytest.mark.parametrize("timeline", TIMELINES)
def test_timelines_are_what_the_evaluator_gives(timeline: str) -> None:
    rows = table(timeline)
    states = states_of(dict(rows))
    formulas = 0
    for i, (label, marks) in enumerate(rows):
        if label in ("time", "decided at") or re.fullmatch(r"[pq](\(\w+\))?", label):
            continue
        formulas += 1
        found, decided = verdicts(label, states)
        assert marks == found, label
        if rows[i + 1 : i + 2] and rows[i + 1][0] == "decided at":
            assert rows[i + 1][1] == decided, label
    assert formulas


@pytest.mark.parametrize("text", EXAMPLES)
def test_examples_are_right(text: str) -> None:
    monitor = parse_monitor(text)
    assert parse_monitor(format_monitor(monitor)) == monitor
    check_normal_form(text, Engine(epoch="e1").ontology.vocabulary)


def check_normal_form(text: str, vocabulary: Vocabulary) -> str:
    """Check a monitor and, instead of its formula, the normal form; return that."""
    monitor = parse_monitor(text)
    checked = check_mtl(monitor, text, vocabulary)
    found = normal_form(checked.formula)
    again = replace(monitor, formula=parse_formula(found))
    assert check_mtl(again, found, vocabulary) == checked, found
    return found


@pytest.mark.parametrize(
    ("formula", "normal"),
    [
        (
            "speed(?x) >= 10 [m.s-1] -> eventually [0s, 2s] altitude(?x) - 1.5 < 3 [m] * 2",
            "not dyknow:speed(?x) >= 36 [km.h-1] or eventually [0s, 2s] "
            "dyknow:altitude(?x) - 1.5 < 3 * 2 * 3.2808398950131235",
        ),
        (
            "forall ?y in Car (?x != ?y and not once [1s, 2s] speed(?y) = speed(car1))",
            "forall ?y in dyknow:Car (?x != ?y and not once [1s, 2s] "
            "dyknow:speed(?y) = dyknow:speed(dyknow:car1))",
        ),
        ("previous true since [0s, oo] not false", "previous true since not false"),
    ],
)
def test_normal_forms(formula: str, normal: str) -> None:
    text = f"monitor m(?x in UAV) = {formula} with report verdicts"
    assert check_normal_form(text, Engine(epoch="e1").ontology.vocabulary) == normal


@pytest.mark.parametrize("text", TEMPLATES)
def test_templates_are_right(text: str) -> None:
    assert is_formula_template(text)
    engine = Engine(epoch="e1")
    engine.register_template(text)
    request = engine.parse_request("Reckless(?car, 100)")
    assert "dyknow:speed of every dyknow:Thing" in engine.explain(event=request.source)


@pytest.mark.parametrize(("text", "error"), REFUSED)
def test_errors(text: str, error: str) -> None:
    with pytest.raises(LanguageError) as caught:
        check_mtl(parse_monitor(text), text, Engine(epoch="e1").ontology.vocabulary)
    assert caught.value.render().strip() == error.strip()


def test_the_page_shows_each_operator() -> None:
    shown = "\n".join(TIMELINES)
    words = "not and or always eventually until previous once historically since forall exists"
    for word in words.split():
        assert re.search(rf"\b{word}\b", shown), word
    assert "->" in shown
    assert len(EXAMPLES) >= 3
    assert TEMPLATES
    assert len(REFUSED) >= 4
    assert all(f"report {each}" in PAGE for each in Report)
