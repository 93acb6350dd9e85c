"""docs/reference/sase.md: tables of matches are evaluated, examples parsed, errors compared."""

from __future__ import annotations

import re

import numpy as np
import pytest
from places import ROOT
from vocabularies import vocabulary_of

from dyknow.engine.engine import Engine
from dyknow.languages.errors import LanguageError
from dyknow.languages.mtl.checked import Kind
from dyknow.languages.sase import (
    check_sase,
    check_sase_template,
    format_sase,
    is_sase,
    parse_sase,
    parse_sase_template,
)
from dyknow.languages.sase.ast import Index, Strategy
from dyknow.reasoning.patterns.compilation.sase_plans import sase_query
from dyknow.reasoning.patterns.plans.query import Keys, text_key, value_keys, with_numbers
from dyknow.reasoning.patterns.plans.rows import Rows
from dyknow.reasoning.patterns.recognition.choice import evaluator_of

PAGE = (ROOT / "docs" / "reference" / "sase.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```sase\n(.*?)```", PAGE, re.S)
TEMPLATES = re.findall(r"```sase template\n(.*?)```", PAGE, re.S)
REFUSED = re.findall(r"```sase refused\n(.*?)```\n\n```text\n(.*?)```", PAGE, re.S)
TABLES = re.findall(r"```text matches\n(.*?)```", PAGE, re.S)

S = 10**9
TYPES = ("A", "B", "C")
KINDS = {(type_, field): kind for type_ in TYPES for field, kind in
         (("tag", Kind.TEXT), ("x", Kind.NUMBER), ("t", Kind.TIME))}  # fmt: skip
ONTOLOGY = "".join(f"dyknow:{each} a owl:Class .\n" for each in TYPES)


def found(body: str, table: dict[str, list[str]]) -> list[str]:
    """The matches of a pattern over the events of a table: the times of their events. Of a pattern
    that returns something: the time of each event at the end, and the first result."""
    body, clause, limit = body.partition(" LIMIT ")
    text = f"PATTERN {body}"
    if "WITHIN" not in body:
        head, later, rest = re.split("( HAVING | RETURN |$)", text, maxsplit=1)
        text = f"{head} WITHIN 10s{later}{rest}"
    parts = [part for part in parse_sase(text).parts if not part.is_negated]
    is_over_matches = "RETURN" in body
    if not is_over_matches:
        items = [f"{p.name}{'[]' * p.is_kleene}.t AS {p.name}" for p in parts]
        text += f" RETURN {', '.join(items)}{clause}{limit}"
    checked = check_sase(parse_sase(text), text, vocabulary_of(ONTOLOGY))
    query, keys = sase_query(checked, KINDS), Keys()
    plan = with_numbers(query.plans[0], keys)
    running = evaluator_of(plan)
    kinds = tuple(source.kind for source in query.sources)
    mine = [i for i, type_ in enumerate(table["event"]) if type_ in kinds]
    times = np.array([int(table["time"][i]) for i in mine], np.int64) * S
    columns = {"t": times}
    if "tag" in table:
        columns["tag"] = np.array([keys.number(text_key(table["tag"][i])) for i in mine], np.int64)
    if "x" in table:
        columns["x"] = np.array([float(table["x"][i]) for i in mine])
        columns["x as a key"] = value_keys(columns["x"])
    kind = np.array([kinds.index(table["event"][i]) for i in mine], np.int64)
    decided = [running.push(Rows(kinds, kind, times, times, columns)), running.end()]
    shown = []
    for batch in decided:
        for i in range(len(batch)):
            if is_over_matches:
                name = query.results[0].name
                shown.append(f"{batch.outputs['end'][i] // S}:{batch.outputs[name][i]:g}")
                continue
            values = [np.atleast_1d(batch.outputs[part.name][i]) for part in parts]
            shown.append("-".join(str(int(t) // S) for row in values for t in row))
    return shown


@pytest.mark.parametrize("text", TABLES)
def test_tables_are_what_is_found(text: str) -> None:
    lines = [re.split(r"\s{2,}", line, maxsplit=1) for line in text.strip().splitlines()]
    table = {
        label: values.split() for label, values in lines if label in ("time", "event", "tag", "x")
    }
    for label, values in lines[len(table) :]:
        wanted = [each for each in values.split() if each != "-"]
        assert sorted(found(label, table)) == sorted(wanted), label
    assert len(lines) > len(table)


@pytest.mark.parametrize("text", EXAMPLES)
def test_examples_are_right(text: str) -> None:
    assert is_sase(text)
    pattern = parse_sase(text)
    assert parse_sase(format_sase(pattern)) == pattern
    sase_query(check_sase(pattern, text, Engine(epoch="e1").ontology.vocabulary), {})


@pytest.mark.parametrize("text", TEMPLATES)
def test_templates_are_right(text: str) -> None:
    assert is_sase(text)
    slots = check_sase_template(
        parse_sase_template(text), Engine(epoch="e1").ontology.vocabulary
    ).slots
    assert [slot.name for slot in slots] == ["uav", "limit", "time"]


@pytest.mark.parametrize(("text", "error"), REFUSED)
def test_errors(text: str, error: str) -> None:
    with pytest.raises(LanguageError) as caught:
        sase_query(check_sase(parse_sase(text), text, Engine(epoch="e1").ontology.vocabulary), {})
    assert caught.value.render().strip() == error.strip()


def test_the_page_shows_each_construct() -> None:
    shown = "\n".join((*TABLES, *EXAMPLES))
    for each in (*Strategy, *(i for i in Index if i not in (Index.LAST, Index.ONE)), "~", "ANY"):
        assert each in shown, each
    assert "a[a.LEN]" in shown
    assert len(REFUSED) >= 5
    assert TEMPLATES
