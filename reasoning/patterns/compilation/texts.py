"""Patterns of all languages, from checked texts to queries (SPEC §8)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from ....languages import epsparql, sase
from ....languages.chronicle import Chronicle, check_chronicle, check_chronicle_template
from ....languages.chronicle.ast import ChronicleTemplate
from ....languages.chronicle.checked import CheckedChronicle
from ....languages.chronicle.checked import CheckedTemplate as CheckedChronicleTemplate
from ....languages.chronicle.checked import with_arguments as chronicle_with_arguments
from ....languages.mtl.checked import Constant, ObjectConstant
from ....languages.patterns import Pattern, PatternTemplate
from ....ontology.vocabulary import Vocabulary
from ..plans.query import Kinds, PatternQuery, Source
from .chronicle_plans import chronicle_query
from .chronicle_sources import chronicle_sources
from .epsparql_plans import epsparql_query, epsparql_sources
from .sase_plans import sase_query
from .sase_sources import sase_sources

Checked: TypeAlias = CheckedChronicle | sase.CheckedPattern | epsparql.CheckedPattern
CheckedTemplate: TypeAlias = (
    CheckedChronicleTemplate | sase.CheckedTemplate | epsparql.CheckedPattern
)
Arguments: TypeAlias = Mapping[str, Constant | ObjectConstant]


@dataclass(frozen=True, slots=True)
class CheckedPattern:
    """A pattern with its ``source``, all of the text, and the vocabulary of its names.
    ``arguments``: those that a template of EP-SPARQL has; they stand in the others' trees."""

    checked: Checked
    source: str
    vocabulary: Vocabulary
    arguments: Arguments = field(default_factory=dict)

    def sources(self) -> tuple[Source, ...]:
        """What its events are. Raises `LanguageError`."""
        if isinstance(self.checked, CheckedChronicle):
            return chronicle_sources(self.checked, self.source, self.vocabulary)
        if isinstance(self.checked, sase.CheckedPattern):
            return sase_sources(self.checked)
        return epsparql_sources(self.checked, self.arguments)

    def query(self, kinds: Kinds) -> PatternQuery:
        """Compile it for streams whose fields are of these kinds. Raises `LanguageError`."""
        if isinstance(self.checked, CheckedChronicle):
            return chronicle_query(self.checked, self.source, self.vocabulary)
        if isinstance(self.checked, sase.CheckedPattern):
            return sase_query(self.checked, kinds)
        return epsparql_query(self.checked, self.arguments)


def check_pattern(
    pattern: Pattern,
    source: str,
    vocabulary: Vocabulary,
    is_static: Callable[[str], bool] | None = None,
) -> CheckedPattern:
    """Return the meaning of a pattern. ``is_static`` tells whether static graphs may contain a
    predicate that is no feature. Raises `LanguageError`."""
    checked: Checked
    match pattern:
        case Chronicle():
            checked = check_chronicle(pattern, source, vocabulary)
        case sase.Pattern():
            checked = sase.check_sase(pattern, source, vocabulary)
        case epsparql.EpSparqlQuery():
            checked = epsparql.check_epsparql(pattern, vocabulary, is_static)
    return CheckedPattern(checked, source, vocabulary)


def check_pattern_template(
    template: PatternTemplate,
    vocabulary: Vocabulary,
    is_static: Callable[[str], bool] | None = None,
) -> CheckedTemplate:
    """Return the meaning of a template; `check_pattern` describes ``is_static``. Raises
    `LanguageError`."""
    match template:
        case ChronicleTemplate():
            return check_chronicle_template(template, vocabulary)
        case sase.PatternTemplate():
            return sase.check_sase_template(template, vocabulary)
        case epsparql.EpSparqlQuery():
            return epsparql.check_epsparql(template, vocabulary, is_static)


def template_sources(
    template: CheckedTemplate, source: str, vocabulary: Vocabulary
) -> tuple[Source, ...]:
    """Return what the events of a template are, for all objects and whatever the values. Raises
    `LanguageError`."""
    if isinstance(template, CheckedChronicleTemplate):
        return chronicle_sources(template.chronicle, source, vocabulary)
    if isinstance(template, sase.CheckedTemplate):
        return sase_sources(template.pattern)
    return epsparql_sources(template, {})


def with_arguments(
    template: CheckedTemplate,
    values: Mapping[str, Constant | ObjectConstant],
    objects: Mapping[str, str],
    source: str,
    vocabulary: Vocabulary,
) -> CheckedPattern:
    """Return the pattern of a template for a request. Raises `LanguageError`."""
    iris = {name: ObjectConstant(iri) for name, iri in objects.items()}
    match template:
        case CheckedChronicleTemplate():
            chronicle = chronicle_with_arguments(template.chronicle, values, objects)
            return CheckedPattern(chronicle, source, vocabulary)
        case sase.CheckedTemplate():
            bound = sase.bound_sase(template, {**values, **iris})
            return CheckedPattern(bound, source, vocabulary)
        case epsparql.CheckedPattern():
            return CheckedPattern(template, source, vocabulary, {**values, **iris})
