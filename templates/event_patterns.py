"""Patterns of events as continuous queries: what they need from streams (SPEC §8)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from pyoxigraph import Variable

from ..languages.patterns import Pattern, PatternTemplate
from ..matching.subject import Subject
from ..matching.want import Want
from ..ontology.vocabulary import Vocabulary
from ..rdf.dictionary import Term
from ..rdf.namespaces import shorten
from ..reasoning.patterns.compilation.texts import (
    CheckedPattern,
    check_pattern,
    check_pattern_template,
    template_sources,
    with_arguments,
)
from ..reasoning.patterns.plans.query import END, START, Kinds, Part, PatternQuery, Source
from ..streams.sample import TIME_FIELDS
from .needs import Needs, NeedsError
from .slots import Slot, given_arguments


@dataclass(frozen=True, slots=True)
class BoundPattern:
    """A pattern whose sources are wanted features."""

    pattern: CheckedPattern
    sources: dict[Want, Source]

    @property
    def source(self) -> str:
        """All of the text."""
        return self.pattern.source

    @property
    def needs(self) -> Needs:
        return Needs(tuple(self.sources), None)

    def query(self, kinds: Kinds) -> PatternQuery:
        """Compile it for streams whose fields are of these kinds. Raises `LanguageError`, and
        `NeedsError` for a result that has the name of another field."""
        query = self.pattern.query(kinds)
        for result in query.results:
            if result.name in (START, END, *TIME_FIELDS):
                raise NeedsError(
                    f"`{result.name}` cannot be a result: the matches have a field of that name",
                    "give the variable another name",
                )
        return query


def bound_pattern(
    pattern: Pattern,
    source: str,
    vocabulary: Vocabulary,
    is_static: Callable[[str], bool] | None = None,
) -> BoundPattern:
    """Return a pattern as a query; `check_pattern` describes ``is_static``. Raises `LanguageError`;
    `NeedsError` for a feature without an object."""
    return _bound(check_pattern(pattern, source, vocabulary, is_static))


def bound_pattern_template(
    template: PatternTemplate,
    arguments: Sequence[Term | Variable],
    vocabulary: Vocabulary,
    is_static: Callable[[str], bool] | None = None,
) -> BoundPattern:
    """Return the pattern of a template with ``arguments``, one for each parameter; a variable
    leaves an object free. Raises `ArgumentError`, and the errors of `bound_pattern` where the
    ontology has changed since the template was registered."""
    checked = check_pattern_template(template, vocabulary, is_static)
    values, objects = given_arguments(template, checked.slots, arguments)
    return _bound(with_arguments(checked, values, objects, template.source, vocabulary))


def pattern_slots(template: PatternTemplate, vocabulary: Vocabulary) -> tuple[Slot, ...]:
    """Return what each parameter stands for. Raises `LanguageError`."""
    return check_pattern_template(template, vocabulary).slots


def pattern_template_wants(template: PatternTemplate, vocabulary: Vocabulary) -> tuple[Want, ...]:
    """Return what a template needs for all objects. Raises `LanguageError` and `NeedsError`."""
    checked = check_pattern_template(template, vocabulary)
    return tuple(_wants(template_sources(checked, template.source, vocabulary)))


def _bound(checked: CheckedPattern) -> BoundPattern:
    bound = BoundPattern(checked, _wants(checked.sources()))
    columns = (column for source in bound.sources.values() for column in source.columns)
    if all(column.part is not Part.FIELD for column in columns):
        # Errors of the text come before those of streams that are missing.
        bound.query({})
    return bound


def _wants(sources: Iterable[Source]) -> dict[Want, Source]:
    """Return the sources by what matching has to find. Raises `NeedsError` for one without an
    object."""
    found = {}
    for source in sources:
        if not source.arguments:
            name = shorten(source.concept).removeprefix("dyknow:")
            raise NeedsError(
                f"`{name}` names no object, and matching finds features of objects",
                f"write `{name}[?x]`, or `{name}[self]` for the one that speaks",
            )
        first, *others = (Subject(each.sort, each.object) for each in source.arguments)
        streams = (source.stream,) if source.stream else ()
        found[Want(source.concept, first.sort, first.object, tuple(others), streams)] = source
    return found
