"""Defaults of parameters, drawn."""

from __future__ import annotations

from dataclasses import replace
from random import Random

from pyoxigraph import Literal, NamedNode, Variable

from dyknow.languages.arguments import Default
from dyknow.languages.errors import Span
from dyknow.languages.mtl.ast import Slot
from dyknow.rdf.namespaces import DYKNOW, XSD

NOWHERE = Span(0, 0)
VALUES = (
    Literal("100", datatype=NamedNode(XSD + "integer")),
    Literal("-1.50", datatype=NamedNode(XSD + "decimal")),
    Literal(".5", datatype=NamedNode(XSD + "decimal")),
    Literal("1.5e-3", datatype=NamedNode(XSD + "double")),
    Literal("true", datatype=NamedNode(XSD + "boolean")),
    Literal('a (b) # "c"\n'),
    Literal("PT5S", datatype=NamedNode(XSD + "duration")),
    NamedNode(DYKNOW + "uav-1"),
    NamedNode("http://example.org/a#b"),
    Variable("z"),
)


def with_defaults(slots: tuple[Slot, ...], random: Random) -> tuple[Slot, ...]:
    """The slots, with defaults from one of them on."""
    first = random.randint(0, len(slots))
    given = (
        replace(each, default=Default(random.choice(VALUES), NOWHERE)) for each in slots[first:]
    )
    return (*slots[:first], *given)
