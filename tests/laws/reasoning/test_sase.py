"""SASE+: what its plans find is what the text means, however the rows are cut."""

from __future__ import annotations

import math
from collections import Counter
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pyoxigraph import RdfFormat, parse
from sase_definition import Event, Match, matches
from sase_patterns import KEYS, KINDS, TYPES, EqualityDrawing, PatternDrawing, TrendDrawing, rows_of

from dyknow.languages.errors import LanguageError
from dyknow.languages.mtl.ast import Symbol, Variable
from dyknow.languages.mtl.checked import Constant, Kind, ObjectConstant
from dyknow.languages.rewriting import rewritten
from dyknow.languages.sase import (
    CheckedPattern,
    bound_sase,
    check_sase,
    check_sase_template,
    format_sase,
    parse_sase,
    parse_sase_template,
)
from dyknow.ontology.vocabulary import Vocabulary
from dyknow.rdf.namespaces import DYKNOW, PREFIXES
from dyknow.reasoning.patterns.compilation.sase_plans import sase_query
from dyknow.reasoning.patterns.plans.plan import NO_VALUE
from dyknow.reasoning.patterns.plans.query import Keys, PatternQuery, with_numbers
from dyknow.reasoning.patterns.plans.rows import Matches
from dyknow.reasoning.patterns.recognition.choice import evaluator_of

SEEDS = st.integers(0, 2**32)
ONTOLOGY = "".join(f"dyknow:{each} a owl:Class .\n" for each in TYPES)


def vocabulary() -> Vocabulary:
    prefixes = "".join(f"@prefix {name}: <{iri}> .\n" for name, iri in PREFIXES.items())
    quads = parse(prefixes + ONTOLOGY, format=RdfFormat.TURTLE)
    return Vocabulary.from_triples(quad.triple for quad in quads)


VOCABULARY = vocabulary()


def results_of(query: PatternQuery, keys: Keys, found: Matches) -> list[tuple[Any, ...]]:
    columns = [
        [_value(value, result.kind, keys) for value in found.outputs[result.name]]
        for result in query.results
    ]
    starts, ends = (found.outputs[name].tolist() for name in ("start", "end"))
    return list(zip(starts, ends, *columns, strict=True))


def _value(value: Any, kind: Kind, keys: Keys) -> Any:
    if isinstance(value, np.ndarray):
        return tuple(_value(each, kind, keys) for each in value)
    if value == NO_VALUE or (isinstance(value, float) and math.isnan(value)):
        return None
    match kind:
        case Kind.TEXT:
            return keys.key(int(value))[1:]
        case Kind.OBJECT:
            return keys.key(int(value))
        case _:
            return float(value)


def wanted_of(events: list[Event], found: list[Match]) -> list[tuple[Any, ...]]:
    times = {event.number: event.time for event in events}
    return [
        (times[each.events[0][0]], times[each.events[-1][-1]], *map(_plain, each.results))
        for each in found
    ]


def _plain(value: Any) -> Any:
    return float(value) if isinstance(value, int | float) else value


def run(checked: CheckedPattern, events: list[Event], draw: Random) -> Counter[Any]:
    """The results of a pattern over events, in random batches."""
    query, keys = sase_query(checked, KINDS), Keys()
    running = evaluator_of(with_numbers(query.plans[0], keys), capacity=8)
    found: list[tuple[Any, ...]] = []
    cut = draw.choice([1, 2, 5, len(events)])
    for start in range(0, len(events), cut):
        batch = events[start : start + cut]
        found += results_of(query, keys, running.push(rows_of(query, keys, batch, draw)))
        if draw.random() < 0.2:
            found += results_of(query, keys, running.advance(batch[-1].time))
    return Counter(found + results_of(query, keys, running.end()))


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
    assert run(checked, events, case.random) == Counter(wanted), text
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
        found = run(bound, events, case.random)
        known = rewritten(bound.text, lambda node, iri=iri: _with_object(node, iri))
        wanted = wanted_of(events, matches(known, events, KEYS))
        assert found == Counter((*w[:2], f"<{iri}>", *w[2:]) for w in wanted), (text, iri)
        united += found
    free = run(bound_sase(checked, {"limit": limit}), events, case.random)
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
