"""Laws of instances: each has, of every window, what its own query over the same input gives."""

from __future__ import annotations

import importlib.util
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import Literal, Variable

from dyknow.continuous.algebra.options import Options
from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.sharing import instance_kernel, instance_table
from dyknow.continuous.sharing.instance_results import InstancesInBulk
from dyknow.continuous.sharing.template_instances import TemplateEvaluator
from dyknow.continuous.windows import window_schedule
from dyknow.languages.csparql import bind, parse_template
from dyknow.rdf.dictionary import TermDictionary

_place = importlib.util.spec_from_file_location(
    "continuous_laws", Path(__file__).with_name("test_continuous.py")
)
assert _place is not None
assert _place.loader is not None
laws = importlib.util.module_from_spec(_place)
sys.modules[_place.name] = laws
_place.loader.exec_module(laws)

A, B, ON, UAV, ROAD, INPUT = laws.A, laws.B, laws.ON, laws.UAV, laws.ROAD, laws.INPUT

AVERAGE = f"?o a ?k . ?o {A} ?v"
BODIES = [
    # Joined, fixed and searched for: the paper's.
    f"CONSTRUCT {{ ?o {B} ?x }} WHERE {{ {AVERAGE} }} "
    "AGGREGATE {(?x, AVG, {?v}) FILTER (?x > ?t)}",
    f"CONSTRUCT {{ ?o {B} ?x . ?x {A} ?t . ?k {B} ?t }} WHERE {{ {AVERAGE} }} "
    "AGGREGATE {(?x, SUM, {?v}) FILTER (?t >= ?x)}",
    f"SELECT ?o (COUNT(*) AS ?x) WHERE {{ ?o {A} ?v . ?o {B} ?k }} GROUP BY ?o HAVING(?x <= ?t)",
    f"SELECT ?o ?v WHERE {{ ?o {A} ?v . ?o {ON} ?k FILTER(?v < ?t) }}",
    f"SELECT DISTINCT ?k WHERE {{ ?o {A} ?v . ?o {ON} ?k FILTER(?v != ?t || ?v > 3) }}",
    f"SELECT DISTINCT ?v ?t WHERE {{ ?o {A} ?v . ?o {ON} ?k FILTER(?v > ?t && ?v < 2 * ?t) }}",
    f"ASK WHERE {{ ?o {A} ?t . ?o {ON} ?k }}",
    f"SELECT * WHERE {{ ?o {A} ?v . ?o {ON} ?k FILTER(?v > ?t) }}",
    f"SELECT ?o ?w ?t WHERE {{ ?o {A} ?v FILTER(?v >= ?t) BIND(?v + ?t AS ?w) "
    f"OPTIONAL {{ ?o {ON} ?k }} }}",
    # Above a sub-select, below an aggregate, in what may be missing.
    f"SELECT ?o ?x WHERE {{ {{ SELECT ?o (MAX(?v) AS ?x) WHERE {{ {AVERAGE} }} GROUP BY ?o }} "
    "FILTER(?x > ?t) }",
    f"SELECT ?o (SUM(?v) AS ?x) WHERE {{ {AVERAGE} FILTER(?v > ?t) }} GROUP BY ?o",
    f"SELECT ?o (SUM(?v * ?t) AS ?x) WHERE {{ {AVERAGE} FILTER(?t != 77) }} GROUP BY ?o",
    f"SELECT ?o ?v ?w WHERE {{ ?o {A} ?v OPTIONAL {{ ?o {B} ?w FILTER(?w > ?t) }} ?o {ON} ?k }}",
    f"SELECT ?o ?v WHERE {{ ?o {A} ?v FILTER NOT EXISTS {{ ?o {ON} ?k }} FILTER(?v < ?t) }}",
    f"SELECT ?o ?v WHERE {{ ?o {A} ?v MINUS {{ ?o {B} ?t }} ?o ?k ?z }}",
    f"SELECT ?o ?v WHERE {{ {{ ?o {A} ?v }} UNION {{ ?o {B} ?v }} FILTER(?v > ?t) ?o ?p ?k }}",
    f"SELECT ?o ?v WHERE {{ ?o {A} ?v . ?o {ON} ?k FILTER(?v > ?t) }} ORDER BY DESC(?v) ?o LIMIT 1",
    f"SELECT ?o (COUNT(?v) AS ?x) WHERE {{ ?o {A} ?v . ?k {ON} ?t }} GROUP BY ?o",
    f"SELECT ?o ?k WHERE {{ ?o {A}|{B} ?v . ?o {ON}* ?k FILTER(?v > ?t) }}",
]
bodies = st.sampled_from(BODIES)
arguments = st.fixed_dictionaries(
    {},
    optional={
        "o": st.sampled_from([*laws.OBJECTS, laws.node("nobody")]),
        "k": st.sampled_from([UAV, laws.RMAX, ROAD, ON, laws.node("r1"), Literal(2)]),
        "t": st.one_of(
            laws.numbers,
            laws.any_value,
            st.sampled_from([Literal(float("nan")), Literal(2**60), laws.node("r1")]),
        ),
    },
)
adding = st.tuples(st.integers(0, 25), arguments, st.integers(1, 25) | st.none())
"""After which element an instance comes, with what, and how many later it goes."""


def parameters(body: str) -> list[str]:
    """Those of o, k and t that stand in the body."""
    return [name for name in "okt" if f"?{name} " in body[body.index("WHERE") :].replace(")", " ")]


def template(body: str, size: tuple[int, int]):
    range, step = size
    names = ", ".join(f"?{name}" for name in parameters(body))
    return parse_template(
        f"REGISTER TEMPLATE {laws.node('T')}({names}) AS {body} "
        f"WINDOW [RANGE {range}ns STEP {step}ns]"
    ).query


def fed(evaluator, dictionary, elements, cuts, at=None) -> list:
    """Its results; ``at``: what to do before an element."""
    results = []
    places = sorted({min(cut, len(elements)) for cut in cuts} | {0, len(elements)} | set(at or ()))
    for start, stop in pairwise(places):
        for act in (at or {}).get(start, ()):
            act()
        part = elements[start:stop]
        evaluator.push(INPUT, laws.triples(part, dictionary))
        results += evaluator.advance(INPUT, part[-1].time)
    for act in (at or {}).get(len(elements), ()):
        act()
    return results + evaluator.end(INPUT)


def columns(results, dictionary) -> dict[int, object]:
    """What each instance has by the columns of all, as `laws.shown`."""
    found: dict[int, list] = {}
    for numbers, solutions in results.solutions():
        for number, row in zip(numbers.tolist(), solutions.rows(), strict=True):
            found.setdefault(number, []).append(
                tuple(sorted((k, laws.canonical(v)) for k, v in row.items()))
            )
    for numbers, rows in results.triples():
        for i, number in enumerate(numbers.tolist()):
            one = laws.TimedTriples(dictionary, (rows.take(np.array([i])),))
            for _, s, p, o in one:
                found.setdefault(number, []).append(tuple(laws.canonical(x) for x in (s, p, o)))
    return {number: laws.Counter(rows) for number, rows in found.items()}


def check(body, size, elements, cuts, instances, opts) -> None:
    query = template(body, size)
    dictionary = TermDictionary()
    evaluator = TemplateEvaluator(query, dictionary, laws.background(), [INPUT], opts)
    at: dict[int, list] = {}
    lives: dict[int, list] = {}
    closed: list = []

    def come(key, given):
        lives[key] = [evaluator.add(given), evaluator._windows._last_end, None]

    def go(key):
        evaluator.remove(lives[key][0])
        last = evaluator._windows._last_end
        lives[key][2] = -(10**9) if last is None else last

    given_to = {}
    for key, (start, one, stay) in enumerate(instances):
        given_to[key] = {
            Variable(name): term for name, term in one.items() if name in parameters(body)
        }
        start = min(start, len(elements))
        at.setdefault(start, []).append(lambda key=key: come(key, given_to[key]))
        if stay is not None and start + stay <= len(elements):
            at.setdefault(start + stay, []).append(lambda key=key: go(key))
    closed = fed(evaluator, dictionary, elements, cuts, at)
    assert evaluator.late == 0
    by_end = {result.end: result for result in closed}
    assert len(by_end) == len(closed)
    for key, (number, after, until) in lives.items():
        bound = bind(query, given_to[key])
        own = ContinuousEvaluator(bound, dictionary, laws.background(), [INPUT], opts)
        shift = own.schedule.shift
        wanted = {
            result.end: result
            for result in fed(own, dictionary, elements, [])
            if (after is None or result.end > after - shift)
            and (until is None or result.end <= until - shift)
        }
        mine = {end: r.of(number) for end, r in by_end.items() if r.of(number) is not None}
        assert list(mine) == list(wanted), (body, given_to[key])
        for end, result in mine.items():
            assert (result.start, result.end) == (wanted[end].start, end)
            assert laws.shown(result) == laws.shown(wanted[end]), (body, given_to[key], end)
            assert number in by_end[end].instances
            if result.answer is not None:
                assert (number in by_end[end].holding()) == result.answer
            else:
                told = columns(by_end[end], dictionary).get(number, laws.Counter())
                assert told == laws.shown(result)
    for end, results in by_end.items():
        there = [n for n, _, _ in lives.values() if results.of(n) is not None]
        assert results.instances.tolist() == sorted(there), end


sizes = st.tuples(st.integers(1, 9), st.integers(1, 9))
law = settings(deadline=None, max_examples=200)
several = st.lists(adding, min_size=1, max_size=6)
values = st.one_of(laws.doubles, laws.integers)


@law
@given(bodies, sizes, laws.elements_of(values), laws.cuts, several, laws.options)
def test_an_instance_has_what_its_own_query_gives(body, size, elements, cuts, some, opts) -> None:
    check(body, size, elements, cuts, some, opts)


@law
@given(bodies, sizes, laws.elements_of(laws.any_value), laws.cuts, several, laws.options)
def test_also_where_terms_are_mixed(body, size, elements, cuts, some, opts) -> None:
    check(body, size, elements, cuts, some, opts)


@pytest.mark.long
@law
@given(
    st.sampled_from(BODIES[:4]),
    sizes,
    laws.elements_of(values, 40, 10),
    laws.cuts,
    st.lists(adding, min_size=8, max_size=20),
)
def test_many_instances_come_and_go(body, size, elements, cuts, some) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(instance_table, "RECENT", 1)
        check(body, size, elements, cuts, some, Options())


def of_one_cohort(names: dict) -> st.SearchStrategy:
    """Instances that bind the same parameters, and agree on the sort."""
    given = st.fixed_dictionaries({"k": st.just(UAV), "t": laws.numbers, **names})
    one = st.tuples(st.integers(0, 25), given, st.integers(1, 25) | st.none())
    return st.lists(one, min_size=1, max_size=6)


@law
@given(
    st.sampled_from(BODIES[:2]),
    sizes,
    laws.elements_of(values, 40, 10),
    st.lists(st.integers(0, 40), max_size=2),
    st.one_of(of_one_cohort({}), of_one_cohort({"o": st.sampled_from(laws.OBJECTS)})),
)
def test_windows_that_are_due_at_once_change_nothing(body, size, elements, cuts, some) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(window_schedule, "FEWEST", 2)
        check(body, size, elements, cuts, some, Options(semantics="bag"))


def test_windows_are_evaluated_in_one_pass_in_the_law(monkeypatch) -> None:
    monkeypatch.setattr(window_schedule, "FEWEST", 2)
    dictionary = TermDictionary()
    evaluator = TemplateEvaluator(
        template(BODIES[0], (3, 1)), dictionary, laws.background(), [INPUT]
    )
    evaluator.splits = False
    evaluator.add({Variable("k"): UAV, Variable("t"): Literal(0)})
    said = [laws.Element(i, laws.OBJECTS[0], A, Literal(1.0), UAV) for i in range(9)]
    found = fed(evaluator, dictionary, said, [])
    assert any(isinstance(one, InstancesInBulk) for one in found)


limits = st.lists(st.sampled_from([-1.0, 0.0, 0.5, 2.0, float("nan"), float("inf")]), max_size=12)
rows = st.lists(st.tuples(st.integers(-1, 3), st.sampled_from([-1.0, 0.5, 2.0, float("nan")])))


@law
@given(st.lists(limits, min_size=4, max_size=4), rows, st.booleans())
def test_the_kernel_equals_its_twins(groups, rows, strict) -> None:
    # No group of a table is empty.
    groups = [one or [np.nan] for one in groups]
    starts = np.cumsum([0, *map(len, groups)])
    ordered = np.concatenate([np.sort(np.array(one, np.float64)) for one in groups])
    group = np.array([g for g, _ in rows], np.int64)
    value = np.array([v for _, v in rows], np.float64)
    least = instance_kernel.least_of(starts, ordered)
    room = np.empty((2, len(ordered) * len(rows)), np.int64)
    count = instance_kernel.kernel.py_func(
        group, value, starts, ordered, least, strict, room[0], room[1]
    )
    found = [
        instance_kernel.find_pairs(group, value, starts, ordered, least, strict),
        instance_kernel.find_pairs_plain(group, value, starts, ordered, strict),
        room[:, :count],
    ]
    found = [list(zip(at.tolist(), places.tolist(), strict=True)) for at, places in found]
    assert found[0] == found[1] == found[2]
