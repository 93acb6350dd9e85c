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

Pattern: TypeAlias = Chronicle | sase.Pattern
PatternTemplate: TypeAlias = ChronicleTemplate | sase.PatternTemplate


def is_pattern(text: str) -> bool:
    """Whether a text is a pattern, registers one, or is a template of one."""
    return is_chronicle(text) or sase.is_sase(text)


def parse_pattern(text: str) -> Pattern:
    """Parse a pattern, with or without ``REGISTER STREAM name AS``. Raises `LanguageError`."""
    return parse_chronicle(text) if is_chronicle(text) else sase.parse_sase(text)


def parse_pattern_template(text: str) -> PatternTemplate:
    """Parse ``REGISTER TEMPLATE name(…) AS`` with a pattern. Raises `LanguageError`."""
    if is_chronicle(text):
        return parse_chronicle_template(text)
    return sase.parse_sase_template(text)


def language_of(pattern: Pattern) -> str:
    """Return the name of a pattern's language."""
    return "chronicle" if isinstance(pattern, Chronicle) else "SASE+"


def registered_name(pattern: Pattern) -> str:
    """Return the name under which a text registers its results; "" if it gives none."""
    if isinstance(pattern, Chronicle):
        return pattern.stream or pattern.name
    return pattern.name
