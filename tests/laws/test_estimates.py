"""Law of estimates: finite, never negative; exact for a pattern over the static side alone; a join
with a static pattern that has each key once gives at most the rows of the other side.
"""

from __future__ import annotations

from math import isfinite

from hypothesis import given
from hypothesis import strategies as st
from pyoxigraph import Literal, NamedNode, Quad, Store

from dyknow.continuous.background import Background
from dyknow.continuous.cardinality import Sizes
from dyknow.continuous.columns import TermValues
from dyknow.continuous.estimates import estimate
from dyknow.continuous.expressions import Call, Const, Var
from dyknow.continuous.flows import Flow
from dyknow.continuous.logical import (
    START,
    STOP,
    Aggregate,
    Aggregation,
    AnyScan,
    Closure,
    Distinct,
    Exists,
    Extend,
    Filter,
    Join,
    LeftJoin,
    Minus,
    Order,
    Plan,
    Project,
    Scan,
    Slice,
    TypeScan,
    Union,
    walk,
)
from dyknow.continuous.options import Options
from dyknow.continuous.pattern_sizes import Known
from dyknow.continuous.relational import execute
from dyknow.continuous.sources import EmptyWindows, StaticSide
from dyknow.continuous.windows import schedule
from dyknow.languages.csparql import parse_query
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.namespaces import RDF_TYPE

D = "http://d.example/"
X = D + "x"
THINGS = [NamedNode(f"{D}o{i}") for i in range(4)]
PREDICATES = [NamedNode(D + name) for name in "pq"] + [RDF_TYPE]
SILENT = Flow(0.0, 0.0, {})
QUERY = parse_query(f"SELECT * FROM STREAM <{X}> [RANGE 5s STEP 1s] WHERE {{ ?s ?p ?o }}")

objects = st.sampled_from([*THINGS, Literal(1), Literal(2)])
triples = st.sets(st.tuples(st.sampled_from(THINGS), st.sampled_from(PREDICATES), objects))
variables = st.sampled_from([Var(name) for name in "abc"])
subjects = variables | st.sampled_from(THINGS).map(Const)
positions = variables | objects.map(Const)
predicates = st.sampled_from(PREDICATES[:2])
scans: st.SearchStrategy[Scan | TypeScan | AnyScan] = (
    st.builds(Scan, subjects, predicates, positions)
    | st.builds(TypeScan, subjects, variables | st.sampled_from(THINGS).map(Const))
    | st.builds(AnyScan, subjects, st.just(Var("d")), positions)
)
conditions = st.builds(
    lambda name, left, right: Call(name, (left, right)),
    st.sampled_from(["=", "!=", "<", "&&", "||", "REGEX"]),
    variables,
    positions,
)
steps = st.builds(Scan, st.just(Var(START)), predicates, st.just(Var(STOP)))
names = st.lists(st.sampled_from("abc"), max_size=2, unique=True).map(tuple)
counts = (Aggregation("n", "COUNT", None),)


def above(plans: st.SearchStrategy[Plan]) -> st.SearchStrategy[Plan]:
    parts = st.lists(plans, max_size=3).map(tuple)
    return st.one_of(
        st.builds(Join, parts),
        st.builds(Union, parts),
        st.builds(LeftJoin, plans, plans, st.none() | conditions),
        st.builds(Minus, plans, plans),
        st.builds(Exists, st.just("e"), plans, plans),
        st.builds(Filter, conditions, plans),
        st.builds(Extend, st.just("n"), conditions, plans),
        st.builds(Aggregate, names, st.just(counts), plans, implicit=st.booleans()),
        st.builds(Project, names, plans),
        st.builds(Distinct, plans),
        st.builds(Order, st.tuples(st.tuples(variables, st.booleans())), plans),
        st.builds(Slice, st.integers(0, 3), st.none() | st.integers(0, 3), plans),
    )


closures = st.builds(Closure, subjects, positions, steps, zero=st.booleans(), more=st.booleans())
plans: st.SearchStrategy[Plan] = st.recursive(scans | closures, above, max_leaves=8)
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
