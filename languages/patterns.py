"""Texts of patterns of events, in whichever language (SPEC §8)."""

from __future__ import annotations

from typing import TypeAlias

from . import sase
from .chronicle import (
    Chronicle,
    ChronicleTemplate,
    is_chronicle,
    parse_chronicle,
    parse_chronicle_template,
)
from .epsparql import EpSparqlQuery, is_epsparql, parse_epsparql

Pattern: TypeAlias = Chronicle | sase.Pattern | EpSparqlQuery
PatternTemplate: TypeAlias = ChronicleTemplate | sase.PatternTemplate | EpSparqlQuery


def is_pattern(text: str) -> bool:
    """Whether a text is a pattern, registers one, or is a template of one."""
    return is_chronicle(text) or sase.is_sase(text) or is_epsparql(text)


def parse_pattern(text: str) -> Pattern:
    """Parse a pattern, with or without ``REGISTER STREAM name AS``. Raises `LanguageError`."""
    if is_chronicle(text):
        return parse_chronicle(text)
    return sase.parse_sase(text) if sase.is_sase(text) else parse_epsparql(text)


def parse_pattern_template(text: str) -> PatternTemplate:
    """Parse ``REGISTER TEMPLATE name(…) AS`` with a pattern. Raises `LanguageError`."""
    if is_chronicle(text):
        return parse_chronicle_template(text)
    return sase.parse_sase_template(text) if sase.is_sase(text) else parse_epsparql(text)


def language_of(pattern: Pattern) -> str:
    """Return the name of a pattern's language."""
    match pattern:
        case Chronicle():
            return "chronicle"
        case EpSparqlQuery():
            return "EP-SPARQL"
        case sase.Pattern():
            return "SASE+"


def registered_name(pattern: Pattern) -> str:
    """Return the name under which a text registers its results; "" if it gives none."""
    if isinstance(pattern, Chronicle):
        return pattern.stream or pattern.name
    return pattern.name
