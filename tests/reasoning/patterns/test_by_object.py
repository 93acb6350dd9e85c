"""Which patterns are the same for each object, with the object left free
(reasoning/patterns/plans/by_object.py)."""

import pytest
from pyoxigraph import Literal, NamedNode, Variable

from dyknow.languages.templates import parse_any_template
from dyknow.ontology.ontology import Ontology
from dyknow.rdf.namespaces import DYKNOW
from dyknow.reasoning.patterns.plans.by_object import PART, pattern_by_object
from dyknow.templates.reasoning import bound_template

UAV1 = DYKNOW + "uav1"
EP = "PREFIX dyknow: <http://www.ida.liu.se/dyknow/> REGISTER TEMPLATE dyknow:Odd(?x, ?limit) AS "
CHRONICLE = "REGISTER TEMPLATE Odd(?x in UAV, ?limit) AS chronicle odd(?x) {{ {} }}"
SASE = "REGISTER TEMPLATE Odd(?x in UAV, ?limit) AS PATTERN {} WITHIN 3 seconds"
EVENTS = "event(speed[?x]:(?, > ?limit), t1); event(altitude[?x], t2); t2 - t1 in [0s, 3s];"


def found(text):
    template = parse_any_template(text)
    vocabulary = Ontology.open(None).vocabulary
    free, own = (
        bound_template(template, [first, Literal(30)], vocabulary).query({})
        for first in (Variable("x"), NamedNode(UAV1))
    )
    return pattern_by_object(free, own, UAV1)


@pytest.mark.parametrize(
    ("text", "column", "objects"),
    [
        (CHRONICLE.format(EVENTS), "object 1", ("x",)),
        (
            CHRONICLE.format(f"{EVENTS} noevent(speed[?x]:(?, < 5), (t1, t2));"),
            "object 1",
            ("x",),
        ),
        (CHRONICLE.format(f"{EVENTS} hold(speed[?x]:> 5, (t1, t2));"), "object 1", ("x",)),
        (
            CHRONICLE.format("event(speed[?x]:(<= ?limit, > ?limit), t1);"),
            "object 1",
            ("x",),
        ),
        (SASE.format("SEQ(speed a, altitude b) WHERE { [id = ?x] and a.value > ?limit }"), "id",
         ("x", "a", "b")),
        (SASE.format("SEQ(speed+ a[], altitude b) WHERE [id = ?x] AND b.value > ?limit")
         + " RETURN COUNT(*) AS n", "id", ("x",)),
        (SASE.format("SEQ(speed a, altitude b) WHERE skip_till_next_match [id = ?x] AND "
                     "b.value > ?limit"), "id", ("x", "a", "b")),
        (f"{EP} SELECT ?x ?v WHERE {{ ?x dyknow:speed ?v }} SEQ {{ ?x dyknow:altitude ?w "
         "FILTER (?w > ?limit) } WITHIN 3 s", "object 1", ("x",)),
        (f"{EP} SELECT ?v WHERE {{ ?x dyknow:speed ?v }} SEQ {{ ?x dyknow:altitude ?w "
         "FILTER (?w > ?limit) } WITHIN 3 s", "object 1", ()),
    ],
)  # fmt: skip
def test_the_column_of_the_object(text, column, objects):
    pattern = found(text)
    assert (pattern.column, pattern.objects) == (column, objects)
    assert pattern.query.plans[0].outputs[-1].name == PART


@pytest.mark.parametrize(
    "text",
    [
        # Another object is read, or compared with this one.
        CHRONICLE.format(
            "event(speed[?x]:(?, > ?limit), t1); event(altitude[uav2], t2); t2 - t1 in [0s, 3s];"
        ),
        CHRONICLE.format(
            "event(speed[?x]:(?, > ?limit), t1); event(altitude[?y], t2); ?x != ?y; "
            "t2 - t1 in [0s, 3s];"
        ),
        CHRONICLE.format(f"{EVENTS} noevent(speed[uav2]:(?, < 5), (t1, t2));"),
        # The objects of several events are listed.
        SASE.format(
            "SEQ(speed+ a[], altitude b) WHERE skip_till_next_match [id = ?x] AND b.value > ?limit"
        )
        + " RETURN a[].id AS all",
        # With a maximal delay; over the streams of a sort.
        CHRONICLE.format(EVENTS) + " with max delay 2s",
        SASE.format("SEQ(UAV a, altitude b) WHERE { [id = ?x] and b.value > ?limit }"),
        # Several plans.
        f"{EP} SELECT ?x ?v WHERE {{ {{ ?x dyknow:speed ?v }} OPTIONALSEQ "
        "{ ?x dyknow:altitude ?w FILTER (?w > ?limit) } } WITHIN 3 s",
    ],
)
def test_there_is_none(text):
    assert found(text) is None
