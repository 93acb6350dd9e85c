"""Law of estimates: finite, never negative; exact for a pattern over the static side alone; a join
with a static pattern that has each key once gives at most the rows of the other side.
"""

from __future__ import annotations

from math import isfinite

from hypothesis import given
from hypothesis import strategies as st
from logical_plans import PREDICATES, THINGS, D, objects, plans, scans
from pyoxigraph import Quad, Store

from dyknow.continuous.algebra.expressions import Var
from dyknow.continuous.algebra.options import Options
from dyknow.continuous.algebra.plan import Join, Scan, walk
from dyknow.continuous.columns.relation import TermValues
from dyknow.continuous.estimation.cardinality import Sizes
from dyknow.continuous.estimation.estimates import estimate
from dyknow.continuous.estimation.input_rates import Flow
from dyknow.continuous.estimation.pattern_sizes import Known
from dyknow.continuous.operators.background import Background
from dyknow.continuous.operators.executor import execute
from dyknow.continuous.operators.sources import EmptyWindows, StaticSide
from dyknow.continuous.windows.grid import schedule
from dyknow.languages.csparql import parse_query
from dyknow.rdf.dictionary import TermDictionary

X = D + "x"
SILENT = Flow(0.0, 0.0, {})
QUERY = parse_query(f"SELECT * FROM STREAM <{X}> [RANGE 5s STEP 1s] WHERE {{ ?s ?p ?o }}")

triples = st.sets(st.tuples(st.sampled_from(THINGS), st.sampled_from(PREDICATES), objects))
rates = st.floats(0, 1e9)
flows = st.builds(Flow, st.none() | rates, st.none() | rates)


def known(data, flow: Flow, *, distinct: bool = False) -> Known:
    store = Store()
    store.extend(Quad(*triple) for triple in data)
    static = StaticSide(Background(store), TermValues(TermDictionary()))
    return Known(schedule(QUERY, [X], Options()), static, {X: flow}, distinct)


@given(plans, triples, flows, st.booleans())
def test_estimates_are_finite_and_not_negative(plan, data, flow, distinct) -> None:
    found = estimate(plan, known(data, flow, distinct=distinct))
    assert found.keys() == {id(node) for node in walk(plan)}
    for one in found.values():
        assert one.rows is not None
        assert isfinite(one.rows)
        assert isfinite(one.nanoseconds)
        assert one.rows >= 0
        assert one.nanoseconds >= 0


@given(scans, triples)
def test_a_pattern_over_the_static_side_alone_is_exact(scan, data) -> None:
    given = known(data, SILENT)
    source = EmptyWindows(given.static, (), False, None)
    size = Sizes(given).of(scan)
    relation = execute(scan, source, given.static.terms)
    solutions = relation_rows(relation, given)
    assert size.rows == len(solutions)
    for name in relation.columns:
        assert size.v(name) == len({solution[name] for solution in solutions})


@given(st.lists(st.sampled_from(THINGS)), st.dictionaries(st.sampled_from(THINGS), objects))
def test_a_join_with_keys_that_are_there_once_gives_at_most_the_other_side(many, once) -> None:
    data = {(THINGS[i % 4], PREDICATES[0], key) for i, key in enumerate(many)}
    data |= {(subject, PREDICATES[1], value) for subject, value in once.items()}
    left = Scan(Var("a"), PREDICATES[0], Var("b"))
    right = Scan(Var("b"), PREDICATES[1], Var("c"))
    sizes = Sizes(known(data, SILENT))
    assert 0 <= sizes.of(Join((left, right))).rows <= sizes.of(left).rows
    assert 0 <= sizes.of(Join((right, left))).rows <= sizes.of(left).rows


def relation_rows(relation, given: Known) -> list[dict[str, object]]:
    dictionary = given.static.terms.dictionary
    return [
        {name: column.term_at(row, dictionary) for name, column in relation.columns.items()}
        for row in range(relation.rows)
    ]
