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
"""``xsd:integer`` and what is derived from it."""

FRACTIONS: Final = frozenset(XSD + name for name in ("decimal", "float", "double"))
NUMBERS: Final = INTEGERS | FRACTIONS

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
"""Datatypes that a value sort may be."""


def range_type(range: str | None) -> FieldType:
    """The type of a field whose values are of this datatype or class; text where it is neither
    a number nor a boolean."""
    if range in FRACTIONS:
        return FieldType.FLOAT
    if range in INTEGERS:
        return FieldType.INTEGER
    return FieldType.BOOLEAN if range == XSD + "boolean" else FieldType.STRING
