"""Patterns of all languages, from checked texts to queries (SPEC §8)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

from ...languages import sase
from ...languages.chronicle import Chronicle, check_chronicle, check_chronicle_template
from ...languages.chronicle.ast import ChronicleTemplate
from ...languages.chronicle.checked import CheckedChronicle
from ...languages.chronicle.checked import CheckedTemplate as CheckedChronicleTemplate
from ...languages.chronicle.checked import with_arguments as chronicle_with_arguments
from ...languages.mtl.checked import Constant, ObjectConstant
from ...languages.patterns import Pattern, PatternTemplate
from ...ontology.vocabulary import Vocabulary
from .chronicle_plans import chronicle_query
from .chronicle_sources import chronicle_sources
from .query import Kinds, PatternQuery, Source
from .sase_plans import sase_query
from .sase_sources import sase_sources

Checked: TypeAlias = CheckedChronicle | sase.CheckedPattern
CheckedTemplate: TypeAlias = CheckedChronicleTemplate | sase.CheckedTemplate


@dataclass(frozen=True, slots=True)
class CheckedPattern:
    """A pattern with its ``source``, all of the text, and the vocabulary of its names."""

    checked: Checked
    source: str
    vocabulary: Vocabulary

    def sources(self) -> tuple[Source, ...]:
        """What its events are. Raises `LanguageError`."""
        if isinstance(self.checked, CheckedChronicle):
            return chronicle_sources(self.checked, self.source, self.vocabulary)
        return sase_sources(self.checked)

    def query(self, kinds: Kinds) -> PatternQuery:
        """Compile it for streams whose fields are of these kinds. Raises `LanguageError`."""
        if isinstance(self.checked, CheckedChronicle):
            return chronicle_query(self.checked, self.source, self.vocabulary)
        return sase_query(self.checked, kinds)


def check_pattern(pattern: Pattern, source: str, vocabulary: Vocabulary) -> CheckedPattern:
    """Return the meaning of a pattern. Raises `LanguageError`."""
    checked: Checked
    if isinstance(pattern, Chronicle):
        checked = check_chronicle(pattern, source, vocabulary)
    else:
        checked = sase.check_sase(pattern, source, vocabulary)
    return CheckedPattern(checked, source, vocabulary)


def check_pattern_template(template: PatternTemplate, vocabulary: Vocabulary) -> CheckedTemplate:
    """Return the meaning of a template. Raises `LanguageError`."""
    if isinstance(template, ChronicleTemplate):
        return check_chronicle_template(template, vocabulary)
    return sase.check_sase_template(template, vocabulary)


def template_sources(
    template: CheckedTemplate, source: str, vocabulary: Vocabulary
) -> tuple[Source, ...]:
    """Return what the events of a template are, for all objects and whatever the values. Raises
    `LanguageError`."""
    if isinstance(template, CheckedChronicleTemplate):
        return chronicle_sources(template.chronicle, source, vocabulary)
    return sase_sources(template.pattern)


def with_arguments(
    template: CheckedTemplate,
    values: Mapping[str, Constant | ObjectConstant],
    objects: Mapping[str, str],
    source: str,
    vocabulary: Vocabulary,
) -> CheckedPattern:
    """Return the pattern of a template for a request. Raises `LanguageError`."""
    checked: Checked
    if isinstance(template, CheckedChronicleTemplate):
        checked = chronicle_with_arguments(template.chronicle, values, objects)
    else:
        iris = {name: ObjectConstant(iri) for name, iri in objects.items()}
        checked = sase.bound_sase(template, {**values, **iris})
    return CheckedPattern(checked, source, vocabulary)
