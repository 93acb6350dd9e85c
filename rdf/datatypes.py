"""The numeric datatypes of XSD ([Events14 §V.A]: "the appropriate datatype property")."""

from __future__ import annotations

from typing import Final

from ..streams.sample import FieldType
from .namespaces import XSD

INTEGERS: Final = frozenset(
    XSD + name
    for name in (
        "integer",
        "byte",
        "short",
        "int",
        "long",
        "unsignedByte",
        "unsignedShort",
        "unsignedInt",
        "unsignedLong",
        "positiveInteger",
        "negativeInteger",
        "nonPositiveInteger",
        "nonNegativeInteger",
    )
)
"""``xsd:integer`` and the datatypes derived from it."""

FRACTIONS: Final = frozenset(XSD + name for name in ("decimal", "float", "double"))
NUMBERS: Final = INTEGERS | FRACTIONS
DURATIONS: Final = frozenset(XSD + name for name in ("duration", "dayTimeDuration"))
"""Datatypes of durations; years and months may have no fixed length."""

VALUE_DATATYPES: Final = NUMBERS | frozenset(
    XSD + name
    for name in (
        "anyURI",
        "boolean",
        "date",
        "dateTime",
        "dateTimeStamp",
        "dayTimeDuration",
        "duration",
        "string",
        "time",
        "yearMonthDuration",
    )
)
"""Datatypes that KPL accepts as value sorts."""


def range_type(range: str | None) -> FieldType:
    """Return the field type for a datatype or class. Everything that is neither a number nor a
    boolean becomes text."""
    if range in FRACTIONS:
        return FieldType.FLOAT
    if range in INTEGERS:
        return FieldType.INTEGER
    return FieldType.BOOLEAN if range == XSD + "boolean" else FieldType.STRING
