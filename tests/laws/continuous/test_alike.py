"""Laws of queries that differ in constants: the form with the constants put back is the query, and
each has, of every window, what it gives by itself over the same input."""

from __future__ import annotations

import importlib.util
import sys
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pyoxigraph import Literal

from dyknow.continuous.algebra.constant_lifting import (
    generalize,
    lift_constants,
    match_constants,
    put_constants,
)
from dyknow.continuous.algebra.expressions import Var
from dyknow.continuous.algebra.options import Options
from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.evaluation.solver import QueryBody
from dyknow.continuous.sharing import cohorts
from dyknow.continuous.sharing.similar_queries import (
    SimilarQueriesEvaluator,
    Unshared,
    form_of,
)
from dyknow.continuous.windows.grid import schedule
from dyknow.languages.csparql import parse_query
from dyknow.rdf.dictionary import TermDictionary

_place = importlib.util.spec_from_file_location(
    "alike_continuous_laws", Path(__file__).with_name("test_continuous.py")
)
assert _place is not None
assert _place.loader is not None
laws = importlib.util.module_from_spec(_place)
sys.modules[_place.name] = laws
_place.loader.exec_module(laws)

A, B, ON, UAV, ROAD, INPUT = laws.A, laws.B, laws.ON, laws.UAV, laws.ROAD, laws.INPUT

BODIES = [
    # Thresholds above an aggregate, constants in the head, objects that a pattern names.
    f"CONSTRUCT {{ ?o {B} ?x }} WHERE {{ ?o a @k . ?o {A} ?v }} "
    "AGGREGATE {(?x, AVG, {?v}) FILTER (?x > @t)}",
    f"CONSTRUCT {{ ?o {B} ?x . @o {A} @t }} WHERE {{ ?o {A} ?v }} "
    "AGGREGATE {(?x, SUM, {?v}) FILTER (@t >= ?x && ?x != @u)}",
    f"SELECT ?o (COUNT(*) AS ?x) WHERE {{ ?o {A} ?v . ?o {B} @t }} GROUP BY ?o HAVING(?x <= @u)",
    f"SELECT ?v (COUNT(*) AS ?x) WHERE {{ @o {A} ?v }} GROUP BY ?v",
    f"SELECT (COUNT(*) AS ?x) (MAX(?v) AS ?y) WHERE {{ @o {A} ?v }}",
    f"SELECT (COUNT(*) AS ?x) WHERE {{ ?o {A} ?v }} HAVING(?x > @t)",
    f"SELECT ?v ?w WHERE {{ @o {A} ?v . @o {B} ?w FILTER(?v < @t) }}",
    f"SELECT DISTINCT ?r WHERE {{ ?o {A} ?v . ?o {ON} ?r FILTER(?v != @t || ?v > @u) }}",
    f"SELECT DISTINCT ?v (@t AS ?w) WHERE {{ ?o {A} ?v . ?o {ON} @r "
    "FILTER(?v > @t && ?v < 2 * @u) }",
    f"ASK WHERE {{ ?o {A} @t . ?o {ON} @r }}",
    f"SELECT * WHERE {{ ?o {A} ?v . ?o {ON} ?r FILTER(?v > @t) FILTER(?o != @o) }}",
    f"SELECT ?o ?w WHERE {{ ?o {A} ?v FILTER(?v >= @t) BIND(?v + @u AS ?w) "
    f"OPTIONAL {{ ?o {ON} @r }} }}",
    # Above a sub-select, below an aggregate, in what may be missing: some stay in the plan.
    f"SELECT ?o ?x WHERE {{ {{ SELECT ?o (MAX(?v) AS ?x) WHERE {{ ?o {A} ?v . ?o {ON} @r }} "
    "GROUP BY ?o } FILTER(?x > @t) }",
    f"SELECT ?o (SUM(?v) AS ?x) WHERE {{ ?o {A} ?v FILTER(?v > @t) }} GROUP BY ?o HAVING(?x > @u)",
    f"SELECT ?o (SUM(?v * @t) AS ?x) WHERE {{ ?o {A} ?v }} GROUP BY ?o HAVING (COUNT(?v) > @u)",
    f"SELECT ?o ?v ?w WHERE {{ ?o {A} ?v OPTIONAL {{ ?o {B} ?w FILTER(?w > @t) }} ?o {ON} @r }}",
    f"SELECT ?o ?v WHERE {{ ?o {A} ?v FILTER NOT EXISTS {{ ?o {ON} @r }} FILTER(?v < @t) }}",
    f"SELECT ?o ?v WHERE {{ ?o {A} ?v MINUS {{ ?o {B} @t }} ?o {ON} @r }}",
    f"SELECT ?o ?v WHERE {{ {{ ?o {A} ?v }} UNION {{ ?o {B} ?v }} FILTER(?v > @t) ?o ?p @r }}",
    f"SELECT ?o ?r WHERE {{ ?o {A}|{B} ?v . @o {ON}* ?r FILTER(?v > @t) }}",
    f"SELECT ?o (IF(?v > @t, STR(@o), CONCAT(@s, STR(?v))) AS ?w) WHERE {{ ?o {A} ?v }}",
    f"SELECT ?o ?v WHERE {{ ?o {A} ?v VALUES ?o {{ {laws.OBJECTS[0]} {laws.OBJECTS[1]} }} "
    "FILTER(?v IN (@t, @u)) }",
]
terms = st.fixed_dictionaries(
    {
        "o": st.sampled_from([*laws.OBJECTS, laws.node("nobody")]),
        "k": st.sampled_from([UAV, UAV, laws.RMAX]),
        "r": st.sampled_from([laws.node("r1"), laws.node("r2")]),
        "t": st.one_of(laws.numbers, laws.numbers, laws.any_value, st.just(Literal(2**60))),
        "u": laws.numbers,
        "s": st.sampled_from([Literal("x"), Literal("y", language="en")]),
    }
)
sizes = st.tuples(st.integers(1, 9), st.integers(1, 9))
lives = st.tuples(st.integers(0, 25), terms, st.integers(1, 25) | st.none())
"""After which element a query comes, with what constants, and how many later it goes."""
law = settings(deadline=None, max_examples=200)
values = st.one_of(laws.doubles, laws.integers)


def query_of(body, size, given):
    for name, term in given.items():
        body = body.replace(f"@{name}", str(term))
    at = body.index("WHERE")
    window = f"FROM STREAM <{INPUT}> [RANGE {size[0]}ns STEP {size[1]}ns] "
    return parse_query(f"REGISTER QUERY q AS {body[:at]}{window}{body[at:]}")


def fed(evaluator, dictionary, elements, cuts, at):
    """Its results; ``at``: what to do before an element."""
    results = []
    places = sorted({min(cut, len(elements)) for cut in cuts} | {0, len(elements)} | set(at))
    for start, stop in pairwise(places):
        for act in at.get(start, ()):
            act()
        part = elements[start:stop]
        evaluator.push(INPUT, laws.triples(part, dictionary))
        results += evaluator.advance(INPUT, part[-1].time)
    for act in at.get(len(elements), ()):
        act()
    return results + evaluator.end(INPUT)


def check(body, size, elements, cuts, some, opts):
    queries = [query_of(body, size, given) for _, given, _ in some]
    try:
        forms = [form_of(query, [INPUT], opts) for query in queries]
        form, _ = forms[0]
        members = [constants for other, constants in forms if other == form]
        pattern = generalize(members)
        assert all(match_constants(pattern, constants) is not None for constants in members)
        dictionary = TermDictionary()
        evaluator = SimilarQueriesEvaluator(
            queries[0], form, pattern, dictionary, laws.background(), [INPUT]
        )
    except Unshared:
        return 0
    at, there = {}, {}

    def come(key):
        number = evaluator.add(queries[key], forms[key][1])
        there[key] = [number, evaluator._windows._last_end, None]

    def go(key):
        last = evaluator._windows._last_end
        there[key][2] = -(10**9) if last is None else last
        evaluator.remove(there[key][0])

    for key, (start, _, stay) in enumerate(some):
        if forms[key][0] == form:
            start = min(start, len(elements))
            at.setdefault(start, []).append(lambda key=key: come(key))
            if stay is not None and start + stay <= len(elements):
                at.setdefault(start + stay, []).append(lambda key=key: go(key))
    found = {result.end: result for result in fed(evaluator, dictionary, elements, cuts, at)}
    assert evaluator.explain()
    for key, (number, after, until) in there.items():
        own = ContinuousEvaluator(queries[key], dictionary, laws.background(), [INPUT], opts)
        shift = own.schedule.shift
        wanted = {
            result.end: result
            for result in fed(own, dictionary, elements, [], {})
            if (after is None or result.end > after - shift)
            and (until is None or result.end <= until - shift)
        }
        mine = {end: r.of(number) for end, r in found.items() if r.of(number) is not None}
        assert list(mine) == list(wanted), queries[key].source
        for end, result in mine.items():
            assert (result.start, result.end) == (wanted[end].start, end)
            assert laws.shown(result) == laws.shown(wanted[end]), (queries[key].source, end)
            silent = {n: told for numbers, told in found[end].silent() for n in numbers.tolist()}
            assert (number in silent) == (result.answer is None and result.size == 0)
            assert (number in found[end].answered) != (number in silent)
            if number in silent:
                assert laws.shown(silent[number]) == laws.shown(result)
    return len(there)


several = st.lists(lives, min_size=1, max_size=6)


@law
@given(st.sampled_from(BODIES), sizes, laws.elements_of(values), laws.cuts, several, laws.options)
def test_a_query_has_among_others_what_it_gives_alone(body, size, elements, cuts, some, opts):
    check(body, size, elements, cuts, some, opts)


@law
@given(
    st.sampled_from(BODIES),
    sizes,
    laws.elements_of(laws.any_value),
    laws.cuts,
    several,
    laws.options,
)
def test_also_where_terms_are_mixed(body, size, elements, cuts, some, opts):
    check(body, size, elements, cuts, some, opts)


@law
@given(st.sampled_from(BODIES), sizes, laws.elements_of(values), several)
def test_many_are_looked_at_a_piece_at_a_time(body, size, elements, some):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cohorts, "PAIRS_AT_ONCE", 1)
        check(body, size, elements, [], some, Options())


GIVEN = {"o": laws.OBJECTS[0], "k": UAV, "r": laws.node("r1"), "t": Literal(1), "u": Literal(2)}


@pytest.mark.parametrize("body", [body for i, body in enumerate(BODIES) if i not in (4, 17, 19)])
def test_most_of_them_are_shared_in_the_law(body):
    given = GIVEN | {"s": Literal("x")}
    other = {"o": laws.OBJECTS[1], "r": laws.node("r2"), "t": Literal(3), "u": Literal(4)}
    counts = [
        check(body, (3, 1), [], [], [(0, given, None), (0, given | {name: term}, None)], Options())
        for name, term in other.items()
        if f"@{name}" in body
    ]
    assert max(counts) == 2


@law
@given(st.sampled_from(BODIES), terms, terms)
def test_a_form_with_the_constants_put_back_is_the_query(body, one, other):
    forms = []
    for chosen in (one, other):
        query = query_of(body, (3, 1), chosen)
        found = QueryBody.of(query, schedule(query, [INPUT], Options())).translate({})
        form = lift_constants(found)
        assert put_constants(form.query, form.constants) == found
        forms.append(form)
    assume(forms[0].query == forms[1].query)
    pattern = generalize([form.constants for form in forms])
    for form in forms:
        fit = match_constants(pattern, form.constants)
        put = tuple(fit[one.name] if isinstance(one, Var) else one for one in pattern)
        assert put == form.constants
    # The most special one: a constant that both have is no parameter.
    pairs = zip(*(form.constants for form in forms), strict=True)
    assert [isinstance(one, Var) for one in pattern] == [a != b for a, b in pairs]
