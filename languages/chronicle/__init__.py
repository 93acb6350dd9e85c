"""Chronicles: events, and the times between them ([DyKnow10 §2, §7], SPEC §8)."""

from .ast import Chronicle, ChronicleTemplate
from .check import check_chronicle, check_chronicle_template
from .checked import CheckedChronicle, CheckedTemplate, with_arguments
from .parser import is_chronicle, parse_chronicle, parse_chronicle_template
from .printer import format_chronicle, format_chronicle_template

__all__ = [
    "CheckedChronicle",
    "CheckedTemplate",
    "Chronicle",
    "ChronicleTemplate",
    "check_chronicle",
    "check_chronicle_template",
    "format_chronicle",
    "format_chronicle_template",
    "is_chronicle",
    "parse_chronicle",
    "parse_chronicle_template",
    "with_arguments",
]
