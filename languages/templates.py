"""Texts of templates of queries, formulas and patterns ([Events14 §IV.B], SPEC §8)."""

from __future__ import annotations

from typing import TypeAlias

from .csparql import parse_template
from .csparql.ast import Template
from .mtl import FormulaTemplate, is_formula_template, parse_formula_template
from .patterns import PatternTemplate, is_pattern, parse_pattern_template

AnyTemplate: TypeAlias = Template | FormulaTemplate | PatternTemplate


def parse_any_template(text: str) -> AnyTemplate:
    """Parse a template; what follows ``AS`` tells the language of its body. Raises
    `LanguageError`."""
    if is_pattern(text):
        return parse_pattern_template(text)
    return parse_formula_template(text) if is_formula_template(text) else parse_template(text)
