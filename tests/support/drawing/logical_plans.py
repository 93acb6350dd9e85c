"""Random logical plans, for laws of what is said of them."""

from __future__ import annotations

from hypothesis import strategies as st
from pyoxigraph import Literal, NamedNode

from dyknow.continuous.algebra.expressions import Call, Const, Var
from dyknow.continuous.algebra.plan import (
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
)
from dyknow.rdf.namespaces import RDF_TYPE

D = "http://d.example/"
THINGS = [NamedNode(f"{D}o{i}") for i in range(4)]
PREDICATES = [NamedNode(D + name) for name in "pq"] + [RDF_TYPE]

objects = st.sampled_from([*THINGS, Literal(1), Literal(2)])
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
counts = st.sampled_from(
    [(Aggregation("n", "COUNT", None, distinct),) for distinct in (False, True)]
)


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
        st.builds(Aggregate, names, counts, plans, implicit=st.booleans()),
        st.builds(Project, names, plans),
        st.builds(Distinct, plans),
        st.builds(Order, st.tuples(st.tuples(variables, st.booleans())), plans),
        st.builds(Slice, st.integers(0, 3), st.none() | st.integers(0, 3), plans),
    )


closures = st.builds(Closure, subjects, positions, steps, zero=st.booleans(), more=st.booleans())
plans: st.SearchStrategy[Plan] = st.recursive(scans | closures, above, max_leaves=8)
