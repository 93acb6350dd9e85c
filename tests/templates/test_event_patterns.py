"""Patterns as event templates: arguments of a request in place of parameters."""

from __future__ import annotations

import pytest
from chronicle_worlds import vocabulary
from pyoxigraph import Literal, NamedNode, Variable

from dyknow.languages.chronicle import parse_chronicle_template
from dyknow.languages.errors import LanguageError
from dyknow.languages.patterns import parse_pattern, parse_pattern_template
from dyknow.rdf.namespaces import DYKNOW, XSD
from dyknow.reasoning.patterns.plans.plan import OWN, Condition, Constant, Key, Value
from dyknow.reasoning.patterns.plans.query import Argument
from dyknow.templates.event_patterns import bound_pattern, bound_pattern_template
from dyknow.templates.instantiate import ArgumentError

TEMPLATE = parse_chronicle_template(
    """REGISTER TEMPLATE Odd(?x in Car, ?limit, ?who, ?name, ?is) AS chronicle Odd(?x, ?y) {
      event(speed[?x]:(?, > ?limit [km.h-1]), t); event(near[?x, ?y]:(?, ?is), t);
      event(owner[?y]:(?, != ?who), t); event(label[?y]:(?, ?name), t);
      noevent(stopped[?y], (t - 1s, t));
    }"""
)
LIMIT, WHO, NAME, IS = Literal(36), NamedNode(DYKNOW + "a"), Literal("red"), Literal(True)
X = Variable("x")


def test_values_stand_in_the_plan() -> None:
    query = bound_pattern_template(TEMPLATE, [X, LIMIT, WHO, NAME, IS], vocabulary()).query({})
    assert set(query.plans[0].conditions) == {
        Condition(">", Value(0, "number"), Constant(10.0)),
        Condition("=", Value(1, "truth"), Constant(1)),
        Condition("!=", Value(2, "object"), Key(f"<{DYKNOW}a>")),
        Condition("=", Value(3, "text"), Key('"red')),
    }
    assert [each.name for each in query.results] == ["x", "y"]
    assert query.results[0].argument == Argument(DYKNOW + "Car")


def test_an_object_is_that_of_the_sources() -> None:
    query = bound_pattern_template(
        TEMPLATE, [NamedNode(DYKNOW + "b"), LIMIT, WHO, NAME, IS], vocabulary()
    ).query({})
    by_kind = {each.kind: each for each in query.sources}
    only = Argument(DYKNOW + "Car", DYKNOW + "b")
    assert by_kind["dyknow:speed"].arguments == (only,)
    assert by_kind["dyknow:near"].arguments[0] == only
    assert query.results[0].argument == only
    assert next(each for each in query.plans[0].outputs if each.name == "x").value == Key(
        f"<{DYKNOW}b>"
    )


def test_an_object_among_others_is_a_condition() -> None:
    template = parse_chronicle_template(
        "REGISTER TEMPLATE N(?x) AS chronicle N(?x) "
        "{ event(speed[?x], t1); event(speed[?y], t2); t2 - t1 in [0s, 1s]; }"
    )
    query = bound_pattern_template(template, [NamedNode(DYKNOW + "b")], vocabulary()).query({})
    own = Condition("=", Value(OWN, "object 1"), Key(f"<{DYKNOW}b>"))
    assert [each.conditions for each in query.plans[0].elements] == [(own,), ()]


@pytest.mark.parametrize(
    ("place", "argument", "message"),
    [
        (0, Literal("b"), "it stands for an object"),
        (1, Variable("limit"), "it must be given"),
        (1, Literal("fast"), '"fast" is not a number'),
        (2, Literal("a"), "it is an object in the template"),
        (3, Literal(3), "it is a text in the template"),
        (4, Literal("yes"), "it is a truth in the template"),
    ],
)
def test_arguments_of_another_kind(place: int, argument: object, message: str) -> None:
    arguments = [X, LIMIT, WHO, NAME, IS]
    arguments[place] = argument
    with pytest.raises(ArgumentError, match=message):
        bound_pattern_template(TEMPLATE, arguments, vocabulary()).query({})
    with pytest.raises(ArgumentError, match="takes 5 arguments, not 4"):
        bound_pattern_template(TEMPLATE, arguments[:4], vocabulary()).query({})


# -- durations ---------------------------------------------------------------------------------

CHRONICLE = "chronicle E(?x) {{ event(speed[?x], t1); event(near[?x, ?], t2); {} }}"
SASE = "PATTERN SEQ(speed a, speed b) WHERE [id] {}"
EP = "SELECT ?a WHERE {{ ?a dyknow:speed ?v }} SEQ {{ ?a dyknow:speed ?w }} {}"
DURATIONS = [
    (CHRONICLE, "t2 - t1 in [-{0}, {0}];"),
    (CHRONICLE, "t2 - t1 in [0s, {0} - 1ns];"),
    (CHRONICLE, "t1 < t2; t2 - t1 < {0};"),
    (CHRONICLE, "t1 <= t2; t2 - 1s < t1 + {0};"),
    (CHRONICLE, "t1 = t2; noevent(speed[?], (t1 - {0}, t2)); hold(speed[?x]:> 3, (t1, t2 + {0}));"),
    (SASE, "WITHIN {0}"),
    (SASE, "and b.valid - a.valid > {0} WITHIN 1h"),
    (SASE, "and a.valid + {0} < b.valid WITHIN 1h RETURN b.valid - a.valid - {0} AS over"),
    (EP, "WITHIN {0}"),
    (EP, "FILTER (getDURATION() < {0})"),
    (EP, "FILTER ({0} >= getDURATION()) WITHIN 1h"),
    (EP, "FILTER ({0} < getDURATION() || ?v > ?w) WITHIN 1h"),
]


def duration(text: str, datatype: str = "duration") -> Literal:
    return Literal(text, datatype=NamedNode(XSD + datatype))


@pytest.mark.parametrize(("body", "rest"), DURATIONS)
@pytest.mark.parametrize("datatype", ["duration", "dayTimeDuration", "string"])
def test_a_duration_is_given_by_a_request(body: str, rest: str, datatype: str) -> None:
    """The plans are those of the text that has the duration."""
    written = '"PT5S"^^xsd:duration'
    text = body.format(rest.format(written))
    direct = bound_pattern(parse_pattern(text), text, vocabulary()).query({})
    pattern = body.format(rest.format("?d"))
    template = parse_pattern_template(f"REGISTER TEMPLATE E(?d) AS {pattern}")
    given = [Literal("5s") if datatype == "string" else duration("PT5S", datatype)]
    query = bound_pattern_template(template, given, vocabulary()).query({})
    assert query.plans == direct.plans
    assert query.branches == direct.branches
    assert query.sources == direct.sources


@pytest.mark.parametrize(("body", "rest"), DURATIONS)
def test_what_is_no_duration(body: str, rest: str) -> None:
    pattern = body.format(rest.format("?d"))
    template = parse_pattern_template(f"REGISTER TEMPLATE E(?d) AS {pattern}")
    for argument, message in (
        (Literal(5), 'it is a duration in the template, and "5" is none'),
        (Literal("soon"), "soon"),
        (duration("5s"), 'it is a duration in the template, and "5s" is none'),
        (duration("P1Y"), "P1Y"),
        (duration("P40000D"), "exceeds 36 years"),
        (Variable("d"), "it must be given"),
    ):
        with pytest.raises(ArgumentError, match=message):
            bound_pattern_template(template, [argument], vocabulary())
    with pytest.raises(LanguageError, match=r"`\?d` (has no value|is no duration|is not bound)"):
        bound_pattern(parse_pattern(pattern), pattern, vocabulary())


def test_a_duration_that_does_not_fit() -> None:
    template = parse_pattern_template(
        f"REGISTER TEMPLATE E(?d) AS {SASE.format('WITHIN ?d').replace('b)', 'b, speed c)')}"
    )
    with pytest.raises(LanguageError, match="3 events that follow each other do not fit"):
        bound_pattern_template(template, [duration("PT0.000000001S")], vocabulary())
    template = parse_pattern_template(
        f"REGISTER TEMPLATE E(?d) AS {EP.format('FILTER (getDURATION() < ?d)')}"
    )
    with pytest.raises(LanguageError, match="nothing lasts less than no time"):
        bound_pattern_template(template, [duration("PT0S")], vocabulary())


def test_a_duration_is_of_one_kind() -> None:
    for body, rest in ((SASE, "and a.value > ?d WITHIN ?d"), (EP, "FILTER (?v > ?d) WITHIN ?d")):
        text = f"REGISTER TEMPLATE E(?d) AS {body.format(rest)}"
        with pytest.raises(LanguageError, match="number"):
            bound_pattern_template(parse_pattern_template(text), [duration("PT5S")], vocabulary())
