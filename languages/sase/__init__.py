"""SASE+: sequences of events with negation, repetition and conditions (SPEC §8)."""

from .ast import Pattern, PatternTemplate, Strategy
from .binding import bound_sase
from .check import check_sase, check_sase_template
from .checked import CheckedPattern, CheckedTemplate
from .parser import is_sase, parse_sase, parse_sase_template
from .printer import format_sase, format_sase_template

__all__ = [
    "CheckedPattern",
    "CheckedTemplate",
    "Pattern",
    "PatternTemplate",
    "Strategy",
    "bound_sase",
    "check_sase",
    "check_sase_template",
    "format_sase",
    "format_sase_template",
    "is_sase",
    "parse_sase",
    "parse_sase_template",
]
