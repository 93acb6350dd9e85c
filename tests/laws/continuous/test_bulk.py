"""Laws of windows in bulk: windows that are due at once have the results of windows one by one, and
the short way of a lone window those of the long one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pyoxigraph import Literal, NamedNode, Quad, Store, Variable

from dyknow.continuous.algebra.options import Options
from dyknow.continuous.columns.budget import UNLIMITED, Budget
from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.incremental import aggregation, bulk_aggregation
from dyknow.continuous.incremental.sliding_aggregates import SlidingPartial
from dyknow.continuous.operators.background import Background
from dyknow.continuous.windows import window_schedule
from dyknow.languages.csparql import bind, parse_query
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.namespaces import RDF_TYPE
from dyknow.rdf.terms_to_columns import from_terms
from dyknow.rdf.timed import TimedTriples, TripleRows

PLACE = "http://d.example/"
INPUTS = [PLACE + "s", PLACE + "t"]


def node(name: str) -> NamedNode:
    return NamedNode(PLACE + name)


SPEED, HEIGHT, UAV, MINI = node("speed"), node("height"), node("UAV"), node("Mini")
OBJECTS = [node(f"o{i}") for i in range(5)]
HEADS = {
    "SELECT ?o {calls}": "",
    "SELECT DISTINCT {calls}": "",
    "SELECT ?o {calls} ": "ORDER BY DESC(?a) ?o",
    "SELECT ?o ({first} * 2 AS ?twice)": "",
}
"""Heads that work row by row, each with what follows GROUP BY and HAVING."""
CONSTRUCTED = ("?o <{s}> ?a", "?o <{s}> ?a ; <{h}> ?a", "<{u}> <{s}> ?a", "?o a <{u}> . ?o <{h}> 1")


@st.composite
def texts(draw: st.DrawFn) -> str:
    """Draw the text of a query with an aggregate by subject."""
    functions = draw(
        st.lists(st.sampled_from(["AVG", "SUM", "COUNT", "MIN", "MAX"]), min_size=1, max_size=3)
    )
    calls = " ".join(f"({f}(?v) AS ?{name})" for f, name in zip(functions, "abc", strict=False))
    body = f"?o <{SPEED.value}> ?v"
    body += draw(st.sampled_from(["", f" . ?o a <{UAV.value}>"]))
    group = "GROUP BY ?o"
    if draw(st.booleans()):
        group += f" HAVING ({functions[0]}(?v) {draw(st.sampled_from(['>', '<=', '!=']))} 2)"
    length, step = draw(st.sampled_from([(3, 1), (6, 2), (5, 5), (2, 3), (30, 1), (4, 3)]))
    windows = " ".join(
        f"FROM STREAM <{one}> [RANGE {length}ns STEP {step}ns]"
        for one in INPUTS[: draw(st.integers(1, 2))]
    )
    operator = draw(st.sampled_from(["", "", "ISTREAM ", "DSTREAM "]))
    if draw(st.booleans()):
        head = draw(st.sampled_from(CONSTRUCTED))
        head = head.format(s=SPEED.value, h=HEIGHT.value, u=UAV.value)
        text = f"CONSTRUCT {operator}{{ {head} }} {windows} WHERE {{ "
        return f"REGISTER QUERY q AS {text} SELECT ?o {calls} WHERE {{ {body} }} {group} }}"
    head = draw(st.sampled_from(sorted(HEADS))).replace("SELECT ", f"SELECT {operator}", 1)
    shown = head.format(calls=calls, first=f"{functions[0]}(?v)")
    order = HEADS[head.replace(operator, "", 1)]
    return f"REGISTER QUERY q AS {shown} {windows} WHERE {{ {body} }} {group} {order}"


LIMIT = node("limit")
JOINED = (
    ("", ("?o", "")),
    (f" . ?o <{LIMIT.value}> ?l", ("?o", "?l", "", "?o ?l")),
    (f" . ?o <{LIMIT.value}> ?l FILTER(?l > 1)", ("?o", "?l")),
    (f" . ?o <{HEIGHT.value}> ?l", ("?o", "?l", "")),
    (f" . ?o <{HEIGHT.value}> ?l . ?p <{LIMIT.value}> ?l", ("?p", "")),
    (" . ?o a ?l", ("?l", "?o ?l")),
    (f" VALUES (?o ?l) {{ (<{OBJECTS[0].value}> 1) (<{OBJECTS[3].value}> 2) }}", ("?l",)),
)
"""What an aggregate is joined with, each with keys of its groups."""


@st.composite
def selecting(draw: st.DrawFn) -> str:
    """Draw the text of a query that selects rows below its aggregate, computes what it aggregates,
    joins other patterns, or groups by other keys than the subject."""
    value = draw(st.sampled_from(["?v", "?v", "?v * 2", "?v - 1.5e0", "IF(?v > 2, ?v, 1)"]))
    functions = draw(
        st.lists(st.sampled_from(["AVG", "SUM", "COUNT", "MIN", "MAX"]), min_size=1, max_size=2)
    )
    calls = " ".join(f"({f}({value}) AS ?{name})" for f, name in zip(functions, "ab", strict=False))
    subject = draw(st.sampled_from(["?o", "?o", f"<{OBJECTS[1].value}>"]))
    body, keys = draw(st.sampled_from(JOINED if subject == "?o" else [("", ("",))]))
    body = f"{subject} <{SPEED.value}> ?v" + body
    if draw(st.booleans()):
        body = f"{subject} <{SPEED.value}> 2.0e0"
        body, calls, keys = body, "(COUNT(*) AS ?a)", ("?o", "") if subject == "?o" else ("",)
    else:
        conditions = ["", "FILTER(?v > 2)", "FILTER(?v < 2 || ?v >= 2.5)", "FILTER(1 / ?v > 0)"]
        body += " " + draw(st.sampled_from(conditions))
    if draw(st.booleans()) and subject == "?o":
        body += f" . ?o a <{UAV.value}>"
    key = draw(st.sampled_from(keys))
    group = f"GROUP BY {key}" if key else ""
    if draw(st.booleans()):
        group += " HAVING (COUNT(*) > 1)"
    length, step = draw(st.sampled_from([(3, 1), (6, 2), (5, 5), (2, 3), (4, 3)]))
    windows = f"FROM STREAM <{INPUTS[0]}> [RANGE {length}ns STEP {step}ns]"
    operator = draw(st.sampled_from(["", "", "ISTREAM "]))
    return (
        f"REGISTER QUERY q AS SELECT {operator}{key} {calls} {windows} WHERE {{ {body} }} {group}"
    )


doubles = st.one_of(
    st.sampled_from([0.5, 2.0, 2.5, -3.0, -0.0, 1e9]), st.floats(-1e6, 1e6, width=32)
).map(Literal)
integers = st.one_of(st.integers(-5, 8), st.sampled_from([2**62, -(2**62), 2**53])).map(Literal)
odd = st.sampled_from(
    [
        Literal("x"),
        Literal(1e300),
        Literal("1.5", datatype=NamedNode("http://www.w3.org/2001/XMLSchema#decimal")),
        Literal("NaN", datatype=NamedNode("http://www.w3.org/2001/XMLSchema#double")),
    ]
)
some = st.one_of(
    st.just(doubles),
    st.just(integers),
    st.just(st.one_of(doubles, doubles, doubles, integers)),
    st.just(st.one_of(doubles, doubles, doubles, doubles, doubles, odd)),
)


@st.composite
def elements(draw: st.DrawFn) -> list[tuple[int, NamedNode, NamedNode, object, NamedNode | None]]:
    """Draw triples in order of time, with the sort that their table states of their subjects."""
    values = draw(some)
    times = st.one_of(st.integers(0, 40), st.integers(0, 40), st.integers(200, 210))
    sorts = draw(st.sampled_from([[None], [UAV], [None, None, UAV, MINI]]))
    speed = st.tuples(
        times, st.sampled_from(OBJECTS), st.just(SPEED), values, st.sampled_from(sorts)
    )
    other = st.tuples(
        times, st.sampled_from(OBJECTS), st.just(HEIGHT), st.just(Literal(1)), st.just(None)
    )
    kind = st.tuples(times, st.sampled_from(OBJECTS), st.just(RDF_TYPE), st.just(UAV), st.none())
    found = draw(st.lists(st.one_of(speed, speed, speed, speed, other, kind), max_size=60))
    return sorted(found, key=lambda one: one[0])


def triples(part: list, dictionary: TermDictionary) -> TimedTriples:
    tables: list[TripleRows] = []
    for sort in dict.fromkeys(one[4] for one in part):
        rows = from_terms([one[:4] for one in part if one[4] == sort], dictionary)
        id = None if sort is None else dictionary.id(sort)
        tables += [
            TripleRows(one.time, one.valid, one.subject, one.objects, id) for one in rows.tables
        ]
    return TimedTriples(dictionary, tuple(tables))


def background(static: list) -> Background:
    store = Store()
    store.add(Quad(MINI, NamedNode("http://www.w3.org/2000/01/rdf-schema#subClassOf"), UAV))
    store.extend(Quad(*one) for one in static)
    return Background(store)


statics = st.lists(
    st.sampled_from([(OBJECTS[0], RDF_TYPE, UAV), (OBJECTS[4], SPEED, Literal(2.5))]), unique=True
)
sorts = st.sampled_from([[], [(OBJECTS[0], RDF_TYPE, UAV)]])
limits = st.lists(
    st.tuples(st.sampled_from(OBJECTS), st.just(LIMIT), st.integers(1, 3).map(Literal)), max_size=6
)


@contextmanager
def at_most(windows: int) -> Iterator[None]:
    """Let one pass evaluate ``windows`` windows."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(window_schedule, "MOST", windows)
        patch.setattr(window_schedule, "FEWEST", 2)
        patch.setattr(bulk_aggregation, "PASS", -(10**9))
        yield


def run(
    text: str,
    found: list,
    cuts: list[int],
    static: list,
    options: Options,
    budget: Budget = UNLIMITED,
    who: NamedNode | None = None,
) -> tuple[list, list]:
    """Return the results, and what else a run leaves; ``who``: the only object asked for."""
    query = parse_query(text)
    if who is not None:
        query = bind(query, {Variable("o"): who})
    dictionary = TermDictionary()
    inputs = [one for one in INPUTS if f"<{one}>" in text]
    evaluator = ContinuousEvaluator(query, dictionary, background(static), inputs, options, budget)
    results = []
    places = sorted({min(cut, len(found)) for cut in cuts} | {0, len(found)})
    for start, stop in pairwise(places):
        part = found[start:stop]
        for i, name in enumerate(inputs):
            evaluator.push(name, triples(part[i :: len(inputs)], dictionary))
        for name in inputs:
            results += evaluator.advance(name, part[-1][0])
    for name in inputs:
        results += evaluator.end(name)
    overruns = [(one.end, one.reason, one.number) for one in evaluator.overruns]
    return [shown(one) for one in results], [overruns, evaluator.quarantine, evaluator.closed]


def shown(result) -> object:
    """Everything of a result, in order, as it would be printed."""
    if result.solutions is not None:
        rows = [{k: str(v) for k, v in row.items()} for row in result.solutions.rows()]
        return result.start, result.end, rows
    assert all(time == result.end for time, *_ in result.triples)
    return result.start, result.end, [str((s, p, o)) for _, s, p, o in result.triples]


law = settings(deadline=None)
cuts = st.lists(st.integers(1, 60), max_size=4)
options = st.builds(
    Options,
    st.sampled_from(["bag", "set"]),
    st.sampled_from(["(]", "[)"]),
    st.sampled_from([0, 1, -7]),
)


@law
@given(texts(), elements(), cuts, statics, options)
def test_windows_in_bulk_equal_windows_one_by_one(text, found, cuts, static, opts) -> None:
    with at_most(1):
        wanted = run(text, found, cuts, static, opts)
    for windows in (2, 7, 512):
        with at_most(windows):
            assert run(text, found, cuts, static, opts) == wanted


@law
@given(texts(), elements(), cuts, statics, options, st.sampled_from(OBJECTS))
def test_so_do_windows_of_one_object(text, found, cuts, static, opts, who) -> None:
    with at_most(1):
        wanted = run(text, found, cuts, static, opts, who=who)
    for windows in (2, 512):
        with at_most(windows):
            assert run(text, found, cuts, static, opts, who=who) == wanted


@example(  # The sum of no rows is an integer, though that of another window is a double.
    f"REGISTER QUERY q AS SELECT (SUM(?v) AS ?a) FROM STREAM <{INPUTS[0]}> [RANGE 4ns STEP 3ns] "
    f"WHERE {{ ?o <{SPEED.value}> ?v FILTER(?v > 2) }}",
    [(1, OBJECTS[0], SPEED, Literal(2.0), None), (9, OBJECTS[0], SPEED, Literal(3.0), None)],
    [],
    [],
    [],
    Options("bag"),
)
@law
@given(selecting(), elements(), cuts, limits, sorts, options)
def test_so_do_aggregates_of_selected_and_joined_rows(
    text, found, cuts, limits, static, opts
) -> None:
    with at_most(1):
        wanted = run(text, found, cuts, limits + static, opts)
    for windows in (2, 512):
        with at_most(windows):
            assert run(text, found, cuts, limits + static, opts) == wanted


@law
@given(texts(), elements(), cuts, options, st.integers(1, 9), st.integers(8, 150))
def test_small_tables_and_forgotten_groups_change_nothing(
    text, found, cuts, opts, most, cells
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(aggregation, "COMPACT", most)
        with at_most(1):
            wanted = run(text, found, cuts, [], opts)
        patch.setattr(bulk_aggregation, "CELLS", cells)
        patch.setattr(window_schedule, "FEWEST", 2)
        patch.setattr(bulk_aggregation, "PASS", -(10**9))
        assert run(text, found, cuts, [], opts) == wanted


@law
@given(texts(), elements(), cuts, statics, options)
def test_a_pane_folded_in_one_call_changes_nothing(text, found, cuts, static, opts) -> None:
    with at_most(1), pytest.MonkeyPatch.context() as patch:
        quick = run(text, found, cuts, static, opts)
        patch.setattr(aggregation, "FEW", -1)
        patch.setattr(aggregation, "SELECTIVE", 0)
        patch.setattr(SlidingPartial, "present", lambda *_: None)
        assert run(text, found, cuts, static, opts) == quick


@law
@given(texts(), elements(), cuts, options, st.integers(0, 3))
def test_budgets_are_of_one_window(text, found, cuts, opts, solutions) -> None:
    budget = Budget(results=solutions)
    with at_most(1):
        wanted = run(text, found, cuts, [], opts, budget)
    with at_most(512):
        assert run(text, found, cuts, [], opts, budget) == wanted
