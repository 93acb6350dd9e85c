"""Laws of continuous queries: columns = definition = Oxigraph, however the input is cut."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import continuous_definition as definition
import pytest
from continuous_definition import Element, Spec
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import Literal, NamedNode, Quad, Store, Variable

from dyknow.continuous.algebra.options import Options
from dyknow.continuous.columns import exact_sums as sums_of
from dyknow.continuous.columns import fold_kernels
from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.incremental import (
    aggregation,
    pair_index,
    sort_facts,
)
from dyknow.continuous.operators.background import Background
from dyknow.languages.csparql import bind, parse_query, parse_template
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.terms_to_columns import from_terms
from dyknow.rdf.timed import TimedTriples, TripleRows

D = "http://d.example/"
INPUT = D + "s"


def node(name: str) -> NamedNode:
    return NamedNode(D + name)


A, B, ON, NAME = node("a"), node("b"), node("on"), node("name")
UAV, RMAX, ROAD = node("UAV"), node("RMAX"), node("Road")
OBJECTS = [node(f"o{i}") for i in range(4)]
STATIC = [
    (RMAX, definition.SUB_CLASS, UAV),
    (node("Tiny"), definition.SUB_CLASS, RMAX),
    (OBJECTS[0], definition.RDF_TYPE, UAV),
    (OBJECTS[1], ON, node("r1")),
    (OBJECTS[0], ON, node("r1")),
    (OBJECTS[2], ON, node("r2")),
    (OBJECTS[2], ON, node("r1")),
    (node("r1"), definition.RDF_TYPE, ROAD),
    (OBJECTS[3], B, Literal(5)),
]


def background() -> Background:
    store = Store()
    store.extend(Quad(s, p, o) for s, p, o in STATIC)
    return Background(store)


doubles = st.sampled_from([0.5, 1.0, 2.0, 2.5, -3.0, 40.25, 100.0, 1e9]).map(Literal)
integers = st.integers(-5, 8).map(Literal)
reals = st.floats(-1e6, 1e6).map(lambda x: Literal(x if abs(x) > 1e-250 else 0.0))
any_value = st.one_of(
    doubles,
    integers,
    st.sampled_from([Literal("x"), node("r1"), Literal(True), Literal("x", language="en")]),
    st.sampled_from(["1.5", "2.0", "7"]).map(
        lambda t: Literal(t, datatype=NamedNode(definition.XSD + "decimal"))
    ),
)


def elements_of(values: st.SearchStrategy, count: int = 25, least: int = 0) -> st.SearchStrategy:
    one = st.builds(
        Element,
        st.one_of(st.integers(-12, 30), st.integers(200, 210)),
        st.sampled_from(OBJECTS),
        st.sampled_from([A, A, B]),
        values,
        st.sampled_from([None, None, UAV, RMAX, node("Tiny"), ROAD]),
    )
    on = st.builds(
        Element,
        st.integers(-12, 30),
        st.sampled_from(OBJECTS),
        st.just(ON),
        st.sampled_from([node("r1"), node("r2")]),
    )
    kind = st.builds(
        Element,
        st.integers(-12, 30),
        st.sampled_from(OBJECTS),
        st.just(definition.RDF_TYPE),
        st.sampled_from([UAV, ROAD]),
    )
    return st.lists(st.one_of(one, one, one, one, on, kind), min_size=least, max_size=count).map(
        lambda found: sorted(found, key=lambda e: e.time)
    )


PATTERNS = [
    (("?s", A, "?v"),),
    (("?s", A, "?v"), ("?s", definition.RDF_TYPE, UAV)),
    (("?s", A, "?v"), ("?s", definition.RDF_TYPE, UAV), ("?s", ON, "?r")),
    (("?s", A, "?v"), ("?s", ON, "?r"), ("?r", definition.RDF_TYPE, ROAD)),
    (("?s", A, "?v"), ("?s", B, "?w")),
    ((OBJECTS[1], A, "?v"),),
    (("?s", B, "?v"),),
    (("?s", A, Literal(2)), ("?s", B, "?v")),
    (("?s", definition.RDF_TYPE, "?r"), ("?s", A, "?v")),
]
numbers = st.sampled_from([Literal(1), Literal(2.5), Literal(0), Literal(40)])
comparison = st.tuples(
    st.just("?v"), st.sampled_from(sorted(definition.ORDER)), st.one_of(numbers, st.just("?s"))
)
condition = st.one_of(
    comparison,
    st.tuples(comparison, st.sampled_from(["&&", "||"]), comparison),
    st.tuples(comparison, st.just("!"), st.none()),
)


def spec_of(draw, functions: list[str], forms=("select", "aggregate", "construct", "ask")) -> Spec:
    patterns = draw(st.sampled_from(PATTERNS))
    names = sorted({p for pattern in patterns for p in pattern if isinstance(p, str)})
    filters = tuple(draw(st.lists(condition, max_size=1))) if "?s" in names else ()
    form = draw(st.sampled_from(forms))
    if form == "ask":
        return Spec(patterns, filters, head=None)
    if form == "select":
        return Spec(patterns, filters, head=tuple(names))
    if form == "construct" and "?s" in names:
        return Spec(
            patterns, filters, head=(("?s", B, "?v"), ("?v", A, Literal(1))), construct=True
        )
    keys = tuple(draw(st.sets(st.sampled_from([n for n in names if n != "?v"] or ["?v"]))))
    chosen = draw(st.lists(st.sampled_from(functions), min_size=1, max_size=3, unique=True))
    aggregates = tuple(
        (f"?x{i}", f, "*" if f == "COUNT" and draw(st.booleans()) else "?v")
        for i, f in enumerate(chosen)
    )
    having = ()
    if draw(st.booleans()):
        operator = draw(st.sampled_from([">", "<=", "!="]))
        having = (("?x0", operator, draw(numbers)),)
    head = (*sorted(keys), *(a[0] for a in aggregates))
    if form == "construct":
        return Spec(patterns, filters, keys, aggregates, having, ((A, B, "?x0"),), construct=True)
    return Spec(patterns, filters, keys, aggregates, having, head)


specs = st.composite(lambda draw: spec_of(draw, ["COUNT", "SUM", "AVG", "MIN", "MAX"]))()
aggregates = st.composite(
    lambda draw: spec_of(draw, ["COUNT", "SUM", "AVG", "MIN", "MAX"], ("aggregate",))
)()
sums = st.composite(lambda draw: spec_of(draw, ["COUNT", "SUM", "AVG"]))()


def text(spec: Spec, range: int, step: int) -> str:
    def show(term) -> str:
        return term if isinstance(term, str) else str(term)

    def show_condition(c, aliases: dict[str, str]) -> str:
        left, operator, right = c
        if operator == "!":
            return f"(!{show_condition(left, aliases)})"
        if isinstance(left, tuple):
            return f"({show_condition(left, aliases)} {operator} {show_condition(right, aliases)})"
        return f"({aliases.get(left, show(left))} {operator} {show(right)})"

    body = " . ".join(" ".join(map(show, pattern)) for pattern in spec.patterns) + " . "
    body += " ".join(f"FILTER {show_condition(c, {})}" for c in spec.filters)
    calls = {alias: f"{f}({variable})" for alias, f, variable in spec.aggregates}
    group = f" GROUP BY {' '.join(spec.keys)}" if spec.keys else ""
    having = "".join(f" HAVING {show_condition(c, calls)}" for c in spec.having)
    shown = " ".join([*spec.keys, *(f"({call} AS {alias})" for alias, call in calls.items())])
    inner = f"SELECT {shown} WHERE {{ {body} }}{group}{having}"
    if spec.head is None:
        query = f"ASK WHERE {{ {body} }}"
    elif spec.construct:
        template = " . ".join(" ".join(map(show, t)) for t in spec.head)
        where = f"{{ {inner} }}" if spec.aggregates else body
        query = f"CONSTRUCT {{ {template} }} WHERE {{ {where} }}"
    elif spec.aggregates:
        head = [(calls.get(n) and f"({calls[n]} AS {n})") or n for n in spec.head]
        query = f"SELECT {' '.join(head)} WHERE {{ {body} }}{group}{having}"
    else:
        query = f"SELECT {' '.join(spec.head)} WHERE {{ {body} }}"
    at = query.index("WHERE")
    window = f"FROM STREAM <{INPUT}> [RANGE {range}ns STEP {step}ns] "
    return f"REGISTER QUERY q AS {query[:at]}{window}{query[at:]}"


def triples(elements: list, dictionary: TermDictionary) -> TimedTriples:
    tables: list[TripleRows] = []
    for sort in dict.fromkeys(e.sort for e in elements):
        part = [(e.time, e.subject, e.predicate, e.object) for e in elements if e.sort == sort]
        for table in from_terms(part, dictionary).tables:
            id = None if sort is None else dictionary.id(sort)
            tables.append(
                TripleRows(table.time, table.valid, table.subject, table.objects, sort=id)
            )
    return TimedTriples(dictionary, tuple(tables))


def run(query, elements: list, cuts: list[int], options: Options) -> list:
    dictionary = TermDictionary()
    evaluator = ContinuousEvaluator(query, dictionary, background(), [INPUT], options)
    results = []
    places = sorted({min(cut, len(elements)) for cut in cuts} | {0, len(elements)})
    for start, stop in pairwise(places):
        part = elements[start:stop]
        evaluator.push(INPUT, triples(part, dictionary))
        results += evaluator.advance(INPUT, part[-1].time)
    results += evaluator.end(INPUT)
    assert evaluator.late == 0
    return results


def canonical(term) -> object:
    """Numbers by datatype and nine digits, so that orders of summation do not count."""
    value = definition.number(term)
    if value is None:
        return str(term)
    return (value[0], f"{float(value[1]):.9g}")


def shown(result) -> object:
    if result.solutions is not None:
        rows = result.solutions.rows()
        return Counter(tuple(sorted((k, canonical(v)) for k, v in row.items())) for row in rows)
    if result.triples is not None:
        return Counter(tuple(canonical(x) for x in (s, p, o)) for _, s, p, o in result.triples)
    return result.answer


def expected(spec: Spec, content: list, semantics: str) -> object:
    found = definition.answer(spec, content, STATIC, semantics)
    if isinstance(found, bool):
        return found
    if spec.construct:
        return Counter(tuple(canonical(x) for x in triple) for triple in found)
    return Counter(tuple(sorted((k[1:], canonical(v)) for k, v in row.items())) for row in found)


def mixed_extremes(spec: Spec) -> bool:
    return any(f in ("MIN", "MAX") for _, f, _ in spec.aggregates)


options = st.builds(
    Options, st.sampled_from(["bag", "set"]), st.sampled_from(["(]", "[)"]), st.integers(-7, 7)
)
sizes = st.tuples(st.integers(1, 9), st.integers(1, 9))
many_panes = st.tuples(st.integers(1, 50), st.integers(1, 3))
cuts = st.lists(st.integers(0, 25), max_size=6)
law = settings(deadline=None, max_examples=150)


many = settings(deadline=None, max_examples=60)


def check(spec: Spec, elements: list, cuts: list[int], opts: Options, size) -> None:
    query = parse_query(text(spec, *size))
    results = run(query, elements, cuts, opts)
    wanted = {
        end: expected(spec, content, opts.semantics)
        for end, content in definition.windows(elements, *size, opts.origin, opts.bounds)
    }
    assert [result.end for result in results] == list(wanted)
    for result in results:
        assert shown(result) == wanted[result.end], (result.end, text(spec, *size))


@law
@given(specs, elements_of(doubles), cuts, options, sizes)
def test_columns_equal_the_definition_over_doubles(spec, elements, cuts, opts, size) -> None:
    check(spec, elements, cuts, opts, size)


@law
@given(specs, elements_of(integers), cuts, options, sizes)
def test_columns_equal_the_definition_over_integers(spec, elements, cuts, opts, size) -> None:
    check(spec, elements, cuts, opts, size)


@law
@given(aggregates, elements_of(doubles, 40, 10), cuts, st.integers(-7, 7), sizes)
def test_sliding_aggregates_equal_the_definition(spec, elements, cuts, origin, size) -> None:
    check(spec, elements, cuts, Options(origin=origin), size)


@law
@given(aggregates, elements_of(doubles, 40, 10), cuts, options, st.one_of(sizes, many_panes))
def test_groups_that_left_the_window_can_be_forgotten(spec, elements, cuts, opts, size) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(aggregation, "COMPACT", 1)
        check(spec, elements, cuts, opts, size)


@many
@given(
    aggregates,
    st.one_of(elements_of(doubles, 40, 10), elements_of(integers, 40, 10)),
    cuts,
    options,
    many_panes,
)
def test_sliding_aggregates_of_many_panes_equal_the_definition(
    spec, elements, cuts, opts, size
) -> None:
    check(spec, elements, cuts, opts, size)


@many
@given(sums, elements_of(any_value), cuts, options, many_panes)
def test_sliding_sums_of_mixed_terms_equal_the_definition(spec, elements, cuts, opts, size) -> None:
    check(spec, elements, cuts, opts, size)


def of_many_objects(values: st.SearchStrategy) -> st.SearchStrategy:
    one = st.builds(
        Element,
        st.integers(0, 60),
        st.sampled_from([node(f"o{i}") for i in range(40)]),
        st.just(A),
        values,
        st.sampled_from([None, None, UAV]),
    )
    return st.lists(one, min_size=10, max_size=60).map(
        lambda found: sorted(found, key=lambda e: e.time)
    )


having = st.composite(
    lambda draw: Spec(
        draw(st.sampled_from(PATTERNS[:2])),
        keys=("?s",),
        aggregates=tuple(
            (f"?x{i}", f, "?v")
            for i, f in enumerate(
                draw(
                    st.lists(
                        st.sampled_from(["AVG", "SUM", "COUNT", "MIN", "MAX"]),
                        min_size=1,
                        max_size=3,
                        unique=True,
                    )
                )
            )
        ),
        having=(("?x0", draw(st.sampled_from([">", "<="])), draw(numbers)),),
        head=("?s", "?x0"),
    )
)()


@many
@given(
    having, st.one_of(of_many_objects(reals), of_many_objects(integers)), cuts, options, many_panes
)
def test_looking_at_touched_groups_alone_changes_no_bit(spec, elements, cuts, opts, size) -> None:
    check(spec, elements, cuts, opts, size)
    query, found = parse_query(text(spec, *size)), []
    # All groups in every window; only the touched ones, however many.
    for share in (2**60, 0):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(aggregation, "DENSE", share)
            patch.setattr(aggregation, "SELECTIVE", 0)
            found.append([exact(result) for result in run(query, elements, cuts, opts)])
    assert found[0] == found[1]


@many
@given(aggregates, elements_of(st.one_of(reals, integers), 40, 10), cuts, options, many_panes)
def test_numpy_in_place_of_compiled_loops_changes_no_bit(spec, elements, cuts, opts, size) -> None:
    query, found = parse_query(text(spec, *size)), []
    for jit in (True, False):
        with pytest.MonkeyPatch.context() as patch:
            for module in (fold_kernels, sums_of, pair_index, sort_facts):
                patch.setattr(module, "JIT", jit)
            found.append([exact(result) for result in run(query, elements, cuts, opts)])
    assert found[0] == found[1]


@law
@given(sums, elements_of(any_value), cuts, options, sizes)
def test_columns_equal_the_definition_over_mixed_terms(spec, elements, cuts, opts, size) -> None:
    check(spec, elements, cuts, opts, size)


@law
@given(specs, elements_of(any_value), options, sizes)
def test_columns_equal_oxigraph(spec, elements, opts, size) -> None:
    query = parse_query(text(spec, *size))
    dictionary = TermDictionary()
    direct = ContinuousEvaluator(query, dictionary, background(), [INPUT], opts)
    oracle = ContinuousEvaluator(query, dictionary, background(), [INPUT], opts)
    oracle._solver.execution = None
    rows = triples(elements, dictionary)
    for evaluator in (direct, oracle):
        evaluator.push(INPUT, rows)
    pairs = zip(direct.end(INPUT), oracle.end(INPUT), strict=True)
    for mine, theirs in pairs:
        assert mine.end == theirs.end
        assert not theirs.merged
        if mine.solutions is not None and mixed_extremes(spec):
            # Equal numbers of two kinds: either may be the least.
            assert len(mine.solutions) == len(theirs.solutions)
        else:
            assert shown(mine) == shown(theirs)


@law
@given(specs, elements_of(st.floats(-1e6, 1e6).map(Literal)), cuts, options, sizes)
def test_batch_cuts_change_no_bit(spec, elements, cuts, opts, size) -> None:
    same_however_cut(spec, elements, cuts, opts, size)


@many
@given(aggregates, elements_of(st.one_of(reals, integers), 40, 10), cuts, options, many_panes)
def test_batch_cuts_change_no_bit_of_sliding_aggregates(spec, elements, cuts, opts, size) -> None:
    same_however_cut(spec, elements, cuts, opts, size)


def same_however_cut(spec, elements, cuts, opts, size) -> None:
    query = parse_query(text(spec, *size))
    whole = run(query, elements, [], opts)
    parts = run(query, elements, cuts, opts)
    assert [r.end for r in whole] == [r.end for r in parts]
    for one, other in zip(whole, parts, strict=True):
        assert exact(one) == exact(other)


def exact(result) -> object:
    if result.solutions is not None:
        return [{k: str(v) for k, v in row.items()} for row in result.solutions.rows()]
    if result.triples is not None:
        return [str((s, p, o)) for _, s, p, o in result.triples]
    return result.answer


@law
@given(elements_of(doubles), st.sampled_from(OBJECTS), st.sampled_from([UAV, ROAD]), sizes)
def test_bound_parameters_join_as_terms(elements, who, kind, size) -> None:
    patterns = (("?s", definition.RDF_TYPE, "?k"), ("?s", A, "?v"))
    spec = Spec(
        patterns,
        aggregates=(("?x0", "AVG", "?v"),),
        keys=("?s",),
        having=(("?x0", ">", "?limit"),),
        head=(("?s", B, "?x0"),),
        construct=True,
    )
    bindings = {"?k": kind, "?limit": Literal(2)}
    if who != OBJECTS[0]:
        bindings["?s"] = who
    range, step = size
    source = (
        f"REGISTER TEMPLATE {node('Fast')}(?s, ?k, ?limit) COMPUTE EVERY {step}ns AS "
        f"CONSTRUCT {{ ?s {B} ?x0 }} WHERE {{ ?s a ?k . ?s {A} ?v }} "
        "AGGREGATE {(?x0, AVG, {?v}) FILTER (?x0 > ?limit)} "
        f"WINDOW [RANGE {range}ns STEP {step}ns]"
    )
    arguments = {Variable(name[1:]): term for name, term in bindings.items()}
    query = bind(parse_template(source).query, arguments)
    results = run(query, elements, [3, 9], Options())
    wanted = list(definition.windows(elements, *size))
    assert [r.end for r in results] == [end for end, _ in wanted]
    bound = Spec(**{**spec.__dict__, "bindings": bindings, "keys": ("?s",)})
    for result, (_, content) in zip(results, wanted, strict=True):
        assert shown(result) == expected(bound, content, "bag")
