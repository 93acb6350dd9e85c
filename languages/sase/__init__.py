"""SASE+: sequences of events with negation, repetition and conditions (SPEC §8)."""

from .ast import Pattern, PatternTemplate, Strategy
from .parser import is_sase, parse_sase, parse_sase_template
from .printer import format_sase, format_sase_template

__all__ = [
    "Pattern",
    "PatternTemplate",
    "Strategy",
    "format_sase",
    "format_sase_template",
    "is_sase",
    "parse_sase",
    "parse_sase_template",
]
