"""Chronicles as event templates: arguments of a request in place of parameters."""

from __future__ import annotations

import pytest
from chronicle_worlds import vocabulary
from pyoxigraph import Literal, NamedNode, Variable

from dyknow.languages.chronicle import parse_chronicle_template
from dyknow.rdf.namespaces import DYKNOW
from dyknow.reasoning.patterns.plans.plan import OWN, Condition, Constant, Key, Value
from dyknow.reasoning.patterns.plans.query import Argument
from dyknow.templates.event_patterns import bound_pattern_template
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
    own = Condition("=", Value(OWN, "argument 1"), Key(f"<{DYKNOW}b>"))
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
