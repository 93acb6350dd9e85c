"""KPL, the knowledge processing language: processes, and the streams between them
([DyKnow10 §5.2-5.3], SPEC §1)."""

from .ast import Specification
from .check import check_kpl, parse_label, parse_policy
from .parser import parse_kpl
from .printer import format_kpl, format_policy, format_term
from .signature import (
    CheckedDeclaration,
    CompunitDeclaration,
    Compute,
    FromSource,
    GeneratorDeclaration,
    JoinOf,
    Label,
    Process,
    Signature,
    SortDeclaration,
    SourceDeclaration,
    StreamDeclaration,
    Synchronize,
    Term,
    ValueSort,
)

__all__ = [
    "CheckedDeclaration",
    "CompunitDeclaration",
    "Compute",
    "FromSource",
    "GeneratorDeclaration",
    "JoinOf",
    "Label",
    "Process",
    "Signature",
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
    "parse_kpl",
    "parse_label",
    "parse_policy",
]
