"""KPL, the knowledge processing language: processes, and the streams between them
([DyKnow10 §5.2-5.3], SPEC §1)."""

from .ast import Specification
from .check import check_kpl, parse_label, parse_policy
from .declarations import (
    OBJECT_FIELD,
    PROCESSES,
    VALUE,
    Aggregate,
    CheckedDeclaration,
    CompunitDeclaration,
    Compute,
    ForeachDeclaration,
    FromSource,
    GeneratorDeclaration,
    JoinOf,
    Label,
    Process,
    Select,
    SelectObject,
    SinkDeclaration,
    SortDeclaration,
    SourceDeclaration,
    StreamDeclaration,
    Synchronize,
    Term,
    ValueSort,
    instantiate,
)
from .parser import parse_kpl
from .printer import format_kpl, format_policy, format_term
from .signature import Signature

__all__ = [
    "OBJECT_FIELD",
    "PROCESSES",
    "VALUE",
    "Aggregate",
    "CheckedDeclaration",
    "CompunitDeclaration",
    "Compute",
    "ForeachDeclaration",
    "FromSource",
    "GeneratorDeclaration",
    "JoinOf",
    "Label",
    "Process",
    "Select",
    "SelectObject",
    "Signature",
    "SinkDeclaration",
    "SortDeclaration",
    "SourceDeclaration",
    "Specification",
    "StreamDeclaration",
    "Synchronize",
    "Term",
    "ValueSort",
    "check_kpl",
    "format_kpl",
    "format_policy",
    "format_term",
    "instantiate",
    "parse_kpl",
    "parse_label",
    "parse_policy",
]
