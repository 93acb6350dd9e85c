"""Formulas of metric temporal logic over features ([DyKnow10 §2, §5.4], SPEC §8)."""

from .ast import Monitor, Report
from .check import check_mtl
from .checked import CheckedMonitor
from .parser import is_monitor, parse_formula, parse_monitor
from .printer import format_formula, format_monitor

__all__ = [
    "CheckedMonitor",
    "Monitor",
    "Report",
    "check_mtl",
    "format_formula",
    "format_monitor",
    "is_monitor",
    "parse_formula",
    "parse_monitor",
]
