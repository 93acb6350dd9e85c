"""The numeric datatypes of XSD ([Events14 §V.A]: "the appropriate datatype property")."""

from __future__ import annotations

from typing import Final

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
