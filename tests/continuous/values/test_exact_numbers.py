"""Integers and decimals are exact in every operator, and a row's answer depends on that row alone
(SPARQL 1.1 §17.2-17.4, §18.5.1)."""

from __future__ import annotations

import operator
import random
from collections.abc import Sequence
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import Literal, NamedNode

from dyknow.continuous.evaluate import evaluate
from dyknow.continuous.values import decimals
from dyknow.rdf.namespaces import DYKNOW, XSD

X = "http://d.example/x"
SPEED = NamedNode(DYKNOW + "speed")
GREAT = 2**63


def typed(text: str, name: str) -> Literal:
    return Literal(text, datatype=NamedNode(XSD + name))


def integer(value: int) -> Literal:
    return typed(str(value), "integer")


def decimal(text: str) -> Literal:
    return typed(text, "decimal")


def double(text: str) -> Literal:
    return typed(text, "double")


def rows(body: str, values: Sequence[Literal], per: int = 1) -> list[dict]:
    """The solutions over one window with these values, ``per`` to a subject."""
    elements = [
        (1, NamedNode(f"{DYKNOW}o{i // per}"), SPEED, value) for i, value in enumerate(values)
    ]
    head, where = body.split("WHERE", 1)
    text = (
        f"REGISTER QUERY q AS PREFIX d: <{DYKNOW}> PREFIX xsd: <{XSD}> {head} "
        f"FROM STREAM <{X}> [RANGE 10ns STEP 10ns] WHERE {where}"
    )
    (window,) = evaluate(text, {X: elements})
    return list(window.solutions)


def computed(expression: str, *values: Literal) -> list:
    """The value of an expression over ?v for each of the values."""
    found = rows(f"SELECT ?v ?r WHERE {{ ?o d:speed ?v BIND({expression} AS ?r) }}", values)
    by_value = {str(row["v"]): row.get("r") for row in found}
    return [by_value[str(value)] for value in values]


def passing(condition: str, *values: Literal) -> set:
    found = rows(f"SELECT ?v WHERE {{ ?o d:speed ?v FILTER({condition}) }}", values)
    return {row["v"] for row in found}


ANY = [
    integer(1),
    integer(0),
    Literal("x"),
    Literal(""),
    Literal("x", language="en"),
    Literal(True),
    Literal(False),
    decimal("0.5"),
    double("NaN"),
    double("2.5"),
    integer(GREAT),
    decimal("123456789012345678.5"),
    typed("abc", "integer"),
    typed("2020-01-01", "date"),
]
LONG, NEAR = decimal("123456789012345678.5"), decimal("123456789012345678.25")
ODD, EVEN = integer(9007199254740993), decimal("9007199254740992")
TRUE = {ANY[i] for i in (0, 2, 4, 5, 7, 9, 10, 11)}


@pytest.mark.parametrize("condition", ["?v", "COALESCE(?v)", "IF(true, ?v, ?v)", "?v && true"])
def test_the_boolean_value_of_mixed_terms(condition: str) -> None:
    """§17.2.2: of a number, a boolean and a string with or without a language; an ill-typed number
    is false; anything else has none."""
    assert passing(condition, *ANY) == TRUE
    for value in ANY:
        assert passing(condition, value) == {value} & TRUE


def test_what_is_false_is_not_what_has_no_boolean_value() -> None:
    false = passing("!?v", *ANY)
    assert false == {ANY[i] for i in (1, 3, 6, 8, 12)}


@pytest.mark.parametrize(
    "expression",
    ["?v", "?v < 2", "?v = 0.5", "?v + 1", "-?v", "?v * 2", "?v / 2", "ROUND(?v)", "STR(?v + 1)"],
)
@settings(deadline=None, max_examples=20)
@given(st.randoms())
def test_the_value_of_a_row_depends_on_that_row_alone(expression: str, chance) -> None:
    alone = [computed(expression, value)[0] for value in ANY]
    order = chance.sample(range(len(ANY)), len(ANY))[: chance.randint(1, len(ANY))]
    together = computed(expression, *(ANY[i] for i in order))
    assert list(map(str, together)) == [str(alone[i]) for i in order]


def test_false_is_less_than_true() -> None:
    """§17.3, also beside a term that Oxigraph has to be asked of."""
    date = typed("2020-01-01", "date")
    assert passing("?v < true", Literal(False), Literal(True)) == {Literal(False)}
    assert passing("?v < true", Literal(False), date) == {Literal(False)}
    assert passing("STRLEN(STR(?v < true)) = 4", Literal(False), Literal(True)) == {Literal(False)}


def test_comparisons_are_exact() -> None:
    long, near = LONG, NEAR
    assert passing("?v = 123456789012345678.5", long, near, integer(3)) == {long}
    assert passing("?v = 123456789012345678.5", near) == set()
    assert passing("?v < 123456789012345678.5", long, near) == {near}
    assert passing("?v > 9007199254740992.0", ODD) == {ODD}
    assert passing("?v > 9007199254740993.0", ODD) == set()
    assert passing(f"?v > {GREAT - 1}", integer(GREAT), integer(7)) == {integer(GREAT)}
    assert passing(f"?v = {10**20}.0", integer(10**20), integer(1)) == {integer(10**20)}
    # Their floats are equal.
    close = [decimal(f"0.1234567890123456789{digit}") for digit in "12"]
    code = decimal("0.12345678901234568")
    assert passing("?v < 0.12345678901234567892", *close, code) == {close[0]}
    assert passing("?v < 0.12345678901234568", *close, code) == set(close)
    assert passing("?v > 0", decimal("0." + "0" * 400 + "1")) != set()


def test_arithmetic_is_exact() -> None:
    least = integer(-GREAT)
    assert computed("ABS(?v)", least, integer(-3)) == [integer(GREAT), integer(3)]
    assert computed("-?v", least, integer(3)) == [integer(GREAT), integer(-3)]
    assert computed("?v + 1", integer(GREAT - 1), integer(1)) == [integer(GREAT), integer(2)]
    assert computed("?v * ?v", integer(10**12)) == [integer(10**24)]
    assert computed("?v * ?v - 1", integer(10**12)) == [integer(10**24 - 1)]
    assert computed("?v + 0.1", decimal("0.2"), decimal("123456789012345678.5")) == [
        decimal("0.3"),
        decimal("123456789012345678.6"),
    ]
    assert computed("?v * 1.1", decimal("1.1"), decimal("1.00000000001")) == [
        decimal("1.21"),
        decimal("1.100000000011"),
    ]


def test_rounding_of_doubles() -> None:
    given = [double("0.49999999999999994"), double("4503599627370497"), double("2.5")]
    assert [v.value for v in computed("ROUND(?v)", *given)] == ["0", "4503599627370497", "3"]
    assert [v.value for v in computed("ROUND(?v)", double("-2.5"), double("-0.5"))] == ["-2", "-0"]


def test_a_decimal_has_no_negative_zero() -> None:
    body = "SELECT DISTINCT ?r WHERE { ?o d:speed ?v BIND(?v * -1 AS ?r) }"
    assert rows(body, [decimal("0.0"), decimal("-0.0")]) == [{"r": decimal("0")}]
    body = "SELECT DISTINCT ?r WHERE { ?o d:speed ?v BIND(CEIL(?v) AS ?r) }"
    assert rows(body, [decimal("-0.4"), decimal("0")]) == [{"r": decimal("0")}]


def test_quotients() -> None:
    """Exact within 15 significant digits or 18 after the point, else rounded to 15 digits."""
    assert computed("?v / 8", integer(1), decimal("1.5")) == [decimal("0.125"), decimal("0.1875")]
    assert computed("?v / 3", integer(1), integer(20)) == [
        decimal("0.333333333333333"),
        decimal("6.66666666666667"),
    ]
    assert computed("?v / 1024", integer(12345678901)) == [decimal("12056327.0517578125")]
    assert computed("?v / 3", integer(10**17)) == [decimal("33333333333333333")]
    assert computed("?v / 0", integer(1), decimal("0.5")) == [None, None]


def test_numbers_of_too_many_digits_have_no_value() -> None:
    """Numbers are exact up to 1,000 digits: arithmetic beyond is an error, and so is the text."""
    long = integer(10**600 + 1)
    assert computed("?v + 1", long) == [integer(10**600 + 2)]
    assert computed("?v * ?v", long) == [None]
    assert computed("?v / 7", long)[0] is not None
    assert computed("1 / ?v", long)[0] is not None
    tiny = decimal("0." + "0" * 600 + "1")
    assert computed("?v * ?v", tiny) == [None]
    assert computed("1 / ?v", tiny) == [decimal("1" + "0" * 601)]
    assert passing("?v > 0", integer(10**1100), integer(1)) == {integer(1)}


# -- aggregates: folded (no key beside the subject), and each window anew (with OPTIONAL)


def aggregated(function: str, values: Sequence[Literal], having: str = "") -> list:
    folded = f"SELECT ?o ({function}(?v) AS ?r) WHERE {{ ?o d:speed ?v }} GROUP BY ?o {having}"
    anew = (
        f"SELECT ?o ({function}(?v) AS ?r) WHERE {{ ?o d:speed ?v OPTIONAL {{ ?o d:none ?n }} }} "
        f"GROUP BY ?o {having}"
    )
    found = [[row.get("r") for row in rows(body, values, len(values))] for body in (folded, anew)]
    assert str(found[0]) == str(found[1])
    return found[0]


@pytest.mark.parametrize(
    ("function", "values", "wanted"),
    [
        ("SUM", [integer(GREAT - 1), integer(1)], integer(GREAT)),
        ("SUM", [integer(GREAT), integer(-1)], integer(GREAT - 1)),
        ("AVG", [integer(GREAT), integer(GREAT)], decimal(str(GREAT))),
        ("AVG", [integer(1), integer(2), integer(2)], decimal("1.66666666666667")),
        ("SUM", [decimal("0.1")] * 10, decimal("1")),
        ("SUM", [decimal("100000000000000"), decimal("0.1")], decimal("100000000000000.1")),
        ("SUM", [LONG, decimal("0.25")], decimal("123456789012345678.75")),
        ("SUM", [decimal("0.001"), integer(2)], decimal("2.001")),
        ("MAX", [ODD, EVEN], ODD),
        ("MIN", [ODD, EVEN], EVEN),
        ("MAX", [integer(GREAT), integer(1)], integer(GREAT)),
        ("MIN", [LONG, NEAR], NEAR),
        ("SUM", [double("1e308"), double("1e308"), double("-1e308")], double("1e308")),
        ("SUM", [double("1e308"), double("1e308")], double("INF")),
        ("MAX", [double("NaN"), integer(3)], double("NaN")),
        ("MIN", [integer(3), double("NaN")], double("NaN")),
        ("MIN", [double("3"), double("NaN")], double("NaN")),
        ("MAX", [typed("NaN", "float"), decimal("3.5")], typed("NaN", "float")),
        ("MAX", [double("NaN"), integer(GREAT)], double("NaN")),
    ],
)
def test_aggregates_are_exact(function: str, values: list[Literal], wanted: Literal) -> None:
    for order in (values, values[::-1]):
        (found,) = aggregated(function, order)
        assert found.datatype == wanted.datatype
        if wanted.value == "1e308":
            assert float(found.value) == 1e308
        else:
            assert found == wanted


def test_having_sees_a_sum_beyond_64_bits() -> None:
    values = [integer(GREAT - 1), integer(1)]
    assert aggregated("SUM", values, "HAVING (SUM(?v) > 100)") == [integer(GREAT)]
    assert aggregated("SUM", values, f"HAVING (SUM(?v) = {GREAT})") == [integer(GREAT)]
    assert aggregated("SUM", values, f"HAVING (SUM(?v) > {GREAT})") == []


def test_distinct_grouping_and_joins_of_long_decimals() -> None:
    long, near = LONG, NEAR
    found = rows("SELECT DISTINCT ?v WHERE { ?o d:speed ?v }", [long, near, long])
    assert {row["v"] for row in found} == {long, near}
    found = rows(
        "SELECT ?v (COUNT(*) AS ?n) WHERE { ?o d:speed ?v } GROUP BY ?v", [long, near, long]
    )
    assert {row["v"]: row["n"].value for row in found} == {long: "2", near: "1"}
    found = rows("SELECT ?a ?b WHERE { ?a d:speed ?v . ?b d:speed ?v }", [long, near, long])
    assert len(found) == 5
    spelled = decimal("0123456789012345678.50")
    found = rows("SELECT DISTINCT ?v WHERE { ?o d:speed ?v }", [long, spelled])
    assert found == [{"v": long}]


def test_order_by_exact_numbers() -> None:
    values = [integer(9007199254740993), decimal("9007199254740992"), integer(GREAT), integer(3)]
    found = rows("SELECT ?v WHERE { ?o d:speed ?v } ORDER BY ?v", values)
    assert [row["v"] for row in found] == [values[3], values[1], values[0], values[2]]
    close = [decimal(f"0.1234567890123456789{digit}") for digit in "21"]
    others = [double("NaN"), double("INF"), double("-INF"), integer(0)]
    found = rows("SELECT ?v WHERE { ?o d:speed ?v } ORDER BY ?v", [*close, *others])
    nan, above, below, zero = others
    assert [row["v"] for row in found] == [nan, below, zero, close[1], close[0], above]


POOL = ["0.1", "0.2", "0.3", "-1.5", "3", "7", "1000000007", "123456.789", "0.0000001", "2.2"]


@settings(deadline=None, max_examples=40)
@given(
    st.lists(st.tuples(st.sampled_from(POOL), st.sampled_from(POOL)), min_size=1, max_size=6),
    st.sampled_from("+-*/"),
    st.sampled_from(POOL),
    st.sampled_from(POOL),
    st.sampled_from(["=", "<", ">="]),
)
def test_filters_of_joined_patterns_are_exact(pairs, sign, left, right, test) -> None:
    """They are judged by the compiled loop: it computes as columns do."""
    height = NamedNode(DYKNOW + "height")
    elements = []
    for i, (a, b) in enumerate(pairs):
        subject = NamedNode(f"{DYKNOW}o{i}")
        elements += [(1, subject, SPEED, decimal(a)), (1, subject, height, decimal(b))]
    bound = computed_pair(sign, left, right)
    query = (
        f"REGISTER QUERY q AS PREFIX d: <{DYKNOW}> SELECT ?o FROM STREAM <{X}> "
        f"[RANGE 10ns STEP 10ns] WHERE {{ ?o d:speed ?v . ?o d:height ?w "
        f"FILTER(?v {sign} ?w {test} {decimals.text(bound)}) }}"
    )
    (window,) = evaluate(query, {X: elements})
    wanted = {
        f"{DYKNOW}o{i}"
        for i, (a, b) in enumerate(pairs)
        if TESTS[test](computed_pair(sign, a, b), bound)
    }
    assert {row["o"].value for row in window.solutions} == wanted


def computed_pair(sign: str, a: str, b: str) -> Decimal:
    found = decimals.compute(sign, Decimal(a), Decimal(b))
    assert found is not None
    return found


TESTS = {"=": operator.eq, "<": operator.lt, ">=": operator.ge}


# -- the module itself


OPERATIONS = {"+": operator.add, "-": operator.sub, "*": operator.mul}
numbers = st.decimals(
    allow_nan=False, allow_infinity=False, places=3, min_value=-(10**9), max_value=10**9
)


@settings(deadline=None, max_examples=300)
@given(st.lists(st.tuples(numbers, numbers), min_size=1, max_size=8), st.sampled_from("+-*/"))
def test_columns_compute_what_fractions_do(pairs: list[tuple[Decimal, Decimal]], sign: str) -> None:
    pairs = [(a, b if b else Decimal(7)) for a, b in pairs]
    sides = [decimals.mantissas(np.array([float(pair[i]) for pair in pairs])) for i in (0, 1)]
    assert sides[0] is not None
    assert sides[1] is not None
    found = decimals.combine(sign, sides[0], sides[1])
    exact = [decimals.compute(sign, *pair) for pair in pairs]
    if found is not None:
        for code, known, wanted in zip(*found, exact, strict=True):
            assert not known or decimals.of_code(float(code)) == wanted
    for (a, b), wanted in zip(pairs, exact, strict=True):
        if sign != "/":
            assert wanted is not None
            assert Fraction(wanted) == OPERATIONS[sign](Fraction(a), Fraction(b))


def test_a_quotient_is_the_same_in_columns_and_alone() -> None:
    chance = random.Random(7)
    for _ in range(3000):
        a = chance.choice([chance.randint(-(10**15), 10**15), chance.randint(-100, 100)])
        b = chance.choice(
            [
                chance.randint(1, 10 ** chance.randint(1, 15)),
                -chance.randint(2, 20),
                2 ** chance.randint(1, 40),
            ]
        )
        scale = chance.choice([0, 3, 6])
        code, known = decimals.quotients(np.array([a]), scale, np.array([b]))
        wanted = decimals.quotient(Fraction(a, 10**scale), Fraction(b))
        assert not known[0] or decimals.of_code(float(code[0])) == wanted
        assert abs(Fraction(wanted) - Fraction(a, b * 10**scale)) <= abs(Fraction(a, b)) / 10**14


def test_decimals_leave_a_set_window_as_they_came() -> None:
    """Each is added beside other rows than those with which it is taken away."""
    stream, p = "http://d.example/s", NamedNode("http://d.example/p")
    query = (
        f"REGISTER QUERY q AS SELECT (MAX(?v) AS ?most) (SUM(?v) AS ?sum) "
        f"FROM STREAM <{stream}> [RANGE 5s STEP 1s] WHERE {{ ?o <{p.value}> ?v }}"
    )
    said = [(37, "a", "-1.5"), (37, "b", "0.0"), (93, "b", "2.25")]
    triples = [
        (t * 10**9, NamedNode(f"http://d.example/{o}"), p, decimal(text)) for t, o, text in said
    ]
    *_, last = evaluate(query, {stream: triples}, semantics="set")
    assert last.solutions == [{"most": decimal("2.25"), "sum": decimal("2.25")}]
