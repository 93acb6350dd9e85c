"""XML specifications: units to insert and remove ([Introspection15 §3.2, Listing 1], SPEC §6)."""

from .ast import (
    Input,
    Parameter,
    Removal,
    Specification,
    StreamReference,
    UnitSpecification,
)
from .parser import parse_specification
from .printer import format_element, format_specification

__all__ = [
    "Input",
    "Parameter",
    "Removal",
    "Specification",
    "StreamReference",
    "UnitSpecification",
    "format_element",
    "format_specification",
    "parse_specification",
]
