"""Texts of templates, whose bodies are queries or formulas ([Events14 §IV.B], SPEC §8)."""

from __future__ import annotations

from typing import TypeAlias

from .csparql import parse_template
from .csparql.ast import Template
from .mtl import FormulaTemplate, is_formula_template, parse_formula_template

AnyTemplate: TypeAlias = Template | FormulaTemplate


def parse_any_template(text: str) -> AnyTemplate:
    """Parse a template; what follows ``AS`` tells the language of its body. Raises
    `LanguageError`."""
    return parse_formula_template(text) if is_formula_template(text) else parse_template(text)
