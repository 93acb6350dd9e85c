"""Formulas of metric temporal logic over features ([DyKnow10 §2, §5.4], SPEC §8)."""

from .ast import FormulaTemplate, Monitor, Report
from .check import check_formula_template, check_mtl
from .checked import CheckedMonitor, CheckedTemplate
from .parser import (
    is_formula_template,
    is_monitor,
    parse_formula,
    parse_formula_template,
    parse_monitor,
)
from .printer import format_formula, format_formula_template, format_monitor

__all__ = [
    "CheckedMonitor",
    "CheckedTemplate",
    "FormulaTemplate",
    "Monitor",
    "Report",
    "check_formula_template",
    "check_mtl",
    "format_formula",
    "format_formula_template",
    "format_monitor",
    "is_formula_template",
    "is_monitor",
    "parse_formula",
    "parse_formula_template",
    "parse_monitor",
]
