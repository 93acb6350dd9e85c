"""Formulas and patterns alike: as queries, and as bodies of templates (SPEC §8)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

from pyoxigraph import Variable

from ..languages.mtl import FormulaTemplate, Monitor, check_formula_template
from ..languages.patterns import Pattern, PatternTemplate
from ..matching.want import Want
from ..ontology.vocabulary import Vocabulary
from ..rdf.dictionary import Term
from .event_patterns import (
    BoundPattern,
    bound_pattern,
    bound_pattern_template,
    pattern_slots,
    pattern_template_wants,
)
from .formulas import (
    BoundFormula,
    bound_formula_template,
    bound_monitor,
    formula_template_wants,
)
from .slots import Slot

Reasoned: TypeAlias = Monitor | Pattern
"""A text that is no query over windows."""
ReasonedTemplate: TypeAlias = FormulaTemplate | PatternTemplate
Bound: TypeAlias = BoundFormula | BoundPattern


def bound_text(
    reasoned: Reasoned,
    source: str,
    vocabulary: Vocabulary,
    is_static: Callable[[str], bool] | None = None,
) -> Bound:
    """Return a monitor or pattern with what it needs. ``is_static`` tells whether static graphs may
    contain a predicate that is no feature. Raises `LanguageError` and `NeedsError`."""
    if isinstance(reasoned, Monitor):
        return bound_monitor(reasoned, source, vocabulary)
    return bound_pattern(reasoned, source, vocabulary, is_static)


def bound_template(
    template: ReasonedTemplate,
    arguments: Sequence[Term | Variable],
    vocabulary: Vocabulary,
    is_static: Callable[[str], bool] | None = None,
) -> Bound:
    """Return the formula or pattern of a template with ``arguments``, one for each parameter. A
    variable leaves the objects of a parameter free. Raises `ArgumentError`, and the errors of
    `bound_text` where the ontology has changed since the template was registered."""
    if isinstance(template, FormulaTemplate):
        return bound_formula_template(template, arguments, vocabulary)
    return bound_pattern_template(template, arguments, vocabulary, is_static)


def slots_of(template: ReasonedTemplate, vocabulary: Vocabulary) -> tuple[Slot, ...]:
    """Return what each parameter of a template stands for. Raises `LanguageError`."""
    if isinstance(template, FormulaTemplate):
        return check_formula_template(template, vocabulary).slots
    return pattern_slots(template, vocabulary)


def template_wants(template: ReasonedTemplate, vocabulary: Vocabulary) -> tuple[Want, ...]:
    """Return what a template needs for all objects, whatever the values. Raises `LanguageError` and
    `NeedsError`."""
    if isinstance(template, FormulaTemplate):
        return formula_template_wants(template, vocabulary)
    return pattern_template_wants(template, vocabulary)
