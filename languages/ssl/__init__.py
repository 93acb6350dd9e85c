"""SSL, the Stream Semantics Language: what fields of a stream mean ([Events14 §IV.A], SPEC §3)."""

from .annotation import (
    CheckedAnnotation,
    Content,
    PortAnnotation,
    Role,
    SourceAnnotation,
    StreamAnnotation,
    TransformationAnnotation,
)
from .ast import Declaration
from .check import check_ssl
from .parser import parse_ssl
from .printer import format_declaration

__all__ = [
    "CheckedAnnotation",
    "Content",
    "Declaration",
    "PortAnnotation",
    "Role",
    "SourceAnnotation",
    "StreamAnnotation",
    "TransformationAnnotation",
    "check_ssl",
    "format_declaration",
    "parse_ssl",
]
