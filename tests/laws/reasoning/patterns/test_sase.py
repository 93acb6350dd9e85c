"""SASE+: what its plans find is what the text means, however the rows are cut."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from sase_definition import matches
from sase_patterns import KEYS, KINDS, TYPES, EqualityDrawing, PatternDrawing, TrendDrawing
from sase_running import run, wanted_of
from vocabularies import vocabulary_of

from dyknow.languages.errors import LanguageError
from dyknow.languages.mtl.ast import Symbol, Variable
from dyknow.languages.mtl.checked import Constant, Kind, ObjectConstant
from dyknow.languages.rewriting import rewritten
from dyknow.languages.sase import (
    bound_sase,
    check_sase,
    check_sase_template,
    format_sase,
    parse_sase,
    parse_sase_template,
)
from dyknow.rdf.namespaces import DYKNOW

SEEDS = st.integers(0, 2**32)
VOCABULARY = vocabulary_of("".join(f"dyknow:{each} a owl:Class .\n" for each in TYPES))


def check(case: PatternDrawing, count: int, span: int) -> int:
    """Compare a random pattern with its definition; return the number of matches."""
    text = case.text()
    pattern = parse_sase(text)
    assert parse_sase(format_sase(pattern)) == pattern
    try:
        checked = check_sase(pattern, text, VOCABULARY)
    except LanguageError:
        assume(False)
        raise
    events = case.events(count, span)
    wanted = wanted_of(events, matches(checked.text, events, KEYS))
    assert run(checked, KINDS, events, case.random) == Counter(wanted), text
    return len(wanted)


def check_template(case: PatternDrawing, count: int, span: int) -> int:
    """Compare requests of a random template with the definition; a request for all objects under
    any match with those for each; return the number of matches."""
    text = case.template()
    try:
        checked = check_sase_template(parse_sase_template(text), VOCABULARY)
    except LanguageError:
        assume(False)
        raise
    events = case.events(count, span)
    limit = Constant(case.random.choice([0.0, 1.0, 2.0]), Kind.NUMBER)
    united: Counter[Any] = Counter()
    for iri in (DYKNOW + "o1", DYKNOW + "o2"):
        bound = bound_sase(checked, {"x": ObjectConstant(iri), "limit": limit})
        found = run(bound, KINDS, events, case.random)
        known = rewritten(bound.text, lambda node, iri=iri: _with_object(node, iri))
        wanted = wanted_of(events, matches(known, events, KEYS))
        assert found == Counter((*w[:2], f"<{iri}>", *w[2:]) for w in wanted), (text, iri)
        united += found
    free = run(bound_sase(checked, {"limit": limit}), KINDS, events, case.random)
    if case.strategy == "skip_till_any_match":
        assert free == united, text
    return united.total()


def _with_object(node: Any, iri: str) -> Any:
    return Symbol(f"<{iri}>", node.span) if isinstance(node, Variable) else node


@settings(deadline=None, max_examples=600)
@given(SEEDS)
def test_plans_find_what_texts_mean(seed: int) -> None:
    case = PatternDrawing(seed)
    check(case, case.random.randint(1, 11), case.random.choice([8, 20, 40]))


@settings(deadline=None, max_examples=300)
@given(SEEDS)
def test_aggregates_over_all_matches(seed: int) -> None:
    case = TrendDrawing(seed)
    check(case, case.random.randint(1, 10), case.random.choice([8, 20, 40]))


@settings(deadline=None, max_examples=300)
@given(SEEDS)
def test_equalities_that_select(seed: int) -> None:
    case = EqualityDrawing(seed)
    check(case, case.random.randint(5, 11), 30)


@settings(deadline=None, max_examples=300)
@given(SEEDS)
def test_requests_of_templates(seed: int) -> None:
    case = PatternDrawing(seed)
    check_template(case, case.random.randint(1, 11), case.random.choice([8, 20]))


@pytest.mark.parametrize("seed", range(3))
def test_the_drawing_has_matches(seed: int) -> None:
    """The law sees matches of each strategy: of random cases a fair share has some."""
    rich: Counter[str] = Counter()
    for each in range(1000 * seed, 1000 * seed + 200):
        case = PatternDrawing(each)
        text = case.text()
        try:
            checked = check_sase(parse_sase(text), text, VOCABULARY)
        except LanguageError:
            continue
        rich[case.strategy] += bool(matches(checked.text, case.events(10, 20), KEYS))
    assert len(rich) == 4
    assert min(rich.values()) >= 5, rich
