"""EP-SPARQL compiled and evaluated gives the solutions of its definition, however the samples are
cut into batches."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from random import Random

import pytest
from epsparql_definition import Definition, Sample, Value
from epsparql_drawing import (
    STATIC,
    STATIC_NAMES,
    QueryDrawing,
    suits,
    vocabulary,
)
from epsparql_running import Result, Running
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pyoxigraph import Literal

from dyknow.languages.epsparql import check_epsparql, parse_epsparql
from dyknow.languages.errors import LanguageError
from dyknow.rdf.namespaces import DYKNOW
from dyknow.reasoning.patterns.compilation.epsparql_plans import epsparql_query
from dyknow.reasoning.patterns.plans.plan import PlanError
from dyknow.reasoning.patterns.plans.query import PatternQuery
from dyknow.streams.time import TIME_MAX

SEEDS = st.integers(0, 2**32)
VOCABULARY = vocabulary()


def compiled(text: str) -> PatternQuery | None:
    """The query; None for one that is refused."""
    try:
        return epsparql_query(check_epsparql(parse_epsparql(text), VOCABULARY))
    except LanguageError:
        return None


def wanted_of(query: Definition) -> list[tuple[Result, bool]]:
    """All results by the definition, and whether each had to wait."""
    ends = {sample.number: sample.end for sample in query.samples}
    found = []
    for solution, values in query.results():
        own = max(ends[number] for number in solution.samples)
        due = max(own, int(solution.due)) if solution.due > -math.inf else own
        shown = tuple(
            (name, of_static(value) if f"?{name}" in STATIC_NAMES else of_result(value))
            for name, value in values.items()
        )
        found.append(((solution.samples, shown, due), due > own))
    return found


def of_static(value: Value | None) -> Value | None:
    """What static triples tell is a text: of an object its name, of a number its digits."""
    if value is None:
        return None
    text = Literal(value[1]).value if value[0] == "number" else str(value[1])
    return "text", text.removeprefix(DYKNOW)


def of_result(value: Value | None) -> Value | None:
    """A duration is a number of seconds in a result."""
    if value is not None and value[0] == "duration":
        return "number", value[1] / 1e9
    return value


def in_time(samples: list[Sample]) -> list[Sample]:
    """Those that are not late."""
    found: list[Sample] = []
    for each in samples:
        if not found or each.end >= found[-1].end:
            found.append(each)
    return found


def check(text: str, samples: list[Sample], draw: Random) -> int:
    query = compiled(text)
    if query is None:
        assume(False)
        return 0
    samples = [each for each in samples if any(suits(each, source) for source in query.sources)]
    taken = in_time(samples)
    wanted = wanted_of(Definition(parse_epsparql(text), taken, {}, STATIC))
    running = Running(query)
    cut = draw.choice([0.0, 0.3, 1.0])
    batch: list[Sample] = []
    got: list[Result] = []
    for each in samples:
        batch.append(each)
        if draw.random() < cut:
            got += running.push(batch)
            batch = []
            if draw.random() < 0.2:
                running.reopen()
            assert_decided(got, wanted, each.number, running)
            if draw.random() < 0.1:
                last = max(one.end for one in samples if one.number <= each.number)
                got += running.advance(last)
    got += running.push(batch)
    if samples:
        assert_decided(got, wanted, samples[-1].number, running)
    got += running.advance(TIME_MAX)
    assert running.rows.pending == 0
    assert running.rows.next_due() is None
    assert Counter(got) == Counter(each for each, _ in wanted)
    places = [(each[2], max(each[0])) for each in got]
    assert places == sorted(places)
    return len(wanted)


def assert_decided(
    got: list[Result], wanted: list[tuple[Result, bool]], last: int, running: Running
) -> None:
    """What came until the sample ``last`` is what it decides."""
    watermark = running.rows._watermark
    decided = [
        each
        for each, is_waiting in wanted
        if (each[2] <= watermark if is_waiting else max(each[0]) <= last)
    ]
    assert Counter(got) == Counter(decided)
    due = min(
        (each[2] for each, w in wanted if w and max(each[0]) <= last and each[2] > watermark),
        default=None,
    )
    if due is not None:
        assert running.rows.next_due() is not None
        assert running.rows.next_due() <= due


@settings(deadline=None, max_examples=1000)
@given(SEEDS)
def test_all_operators(seed: int) -> None:
    case = QueryDrawing(seed)
    check(
        case.text,
        case.samples(case.random.randint(1, 10), case.random.choice([8, 20])),
        case.random,
    )


@settings(deadline=None, max_examples=300)
@given(SEEDS)
def test_optional_parts(seed: int) -> None:
    """Alone is what is in no joined solution; it waits only where a sample may still come."""
    case = QueryDrawing(seed, ("SEQ", "OPTIONALSEQ", "EQUALSOPTIONAL"))
    check(case.text, case.samples(case.random.randint(4, 10), 6), case.random)


@settings(deadline=None, max_examples=300)
@given(SEEDS)
def test_static_triples(seed: int) -> None:
    """A result comes once for each solution of the static triples, and tells it."""
    case = QueryDrawing(seed, has_static=True)
    assume("?a" in case.names)
    check(
        case.text,
        case.samples(case.random.randint(1, 10), case.random.choice([8, 20])),
        case.random,
    )


@settings(deadline=None, max_examples=300)
@given(SEEDS)
def test_samples_in_any_order(seed: int) -> None:
    """Without optional parts a result comes with its last sample, whatever the order."""
    case = QueryDrawing(seed, ("SEQ", "EQUALS", "UNION"))
    samples = case.samples(case.random.randint(1, 8), 12)
    query = compiled(case.text)
    assume(query is not None)
    assert query is not None
    wanted = wanted_of(Definition(parse_epsparql(case.text), samples, {}))
    case.random.shuffle(samples)
    places = {each.number: place for place, each in enumerate(samples)}
    running = Running(query, is_ordered=False)
    got: list[Result] = []
    for place, each in enumerate(samples):
        found = running.push([each])
        assert all(max(places[number] for number in result[0]) == place for result in found)
        got += found
    assert Counter(got) == Counter(each for each, _ in wanted)


@settings(deadline=None, max_examples=40)
@given(SEEDS)
def test_what_is_kept_is_bounded(seed: int) -> None:
    """Over a long stream no more is kept than its last part needs."""
    case = QueryDrawing(seed, ("OPTIONALSEQ", "EQUALSOPTIONAL"))
    query = compiled(case.text)
    assume(query is not None)
    assert query is not None
    running = Running(query)
    most = 0
    for i in range(150):
        shifted = [
            replace(each, start=each.start + 40 * i, end=each.end + 40 * i)
            for each in case.samples(6, 8)
        ]
        running.push(shifted)
        if i < 30:
            most = max(most, running.rows.kept)
        assert i < 30 or running.rows.kept <= 2 * most + 50


def test_optional_parts_need_order() -> None:
    query = compiled("SELECT * { ?a dyknow:price ?v } OPTIONALSEQ { ?a dyknow:open ?t } WITHIN 5s")
    assert query is not None
    with pytest.raises(PlanError, match="order of time"):
        Running(query, is_ordered=False)


@pytest.mark.parametrize("operator", ["SEQ", "EQUALS", "OPTIONALSEQ", "EQUALSOPTIONAL", "UNION"])
def test_the_drawing_has_results(operator: str) -> None:
    """The laws above see results, and samples that wait or exclude others."""
    rich = 0
    for seed in range(120):
        case = QueryDrawing(seed, (operator,))
        samples = case.samples(8, 8)
        if compiled(case.text) is not None:
            rich += bool(Definition(parse_epsparql(case.text), samples, {}).solutions())
    assert rich >= 20
