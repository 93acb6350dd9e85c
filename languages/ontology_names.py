"""Resolves names of the ontology in the texts of a language: sorts, features, objects.

A plain name is looked up in the namespace of new objects, then among the domain terms
(`dyknow:`). A prefixed name or an IRI denotes itself.
"""

from __future__ import annotations

from dataclasses import dataclass

from pyoxigraph import NamedNode

from ..ontology.vocabulary import Vocabulary
from ..rdf.namespaces import DYKNOW, PREFIXES
from .errors import LanguageError, Span
from .hints import meant


@dataclass(frozen=True, slots=True)
class OntologyNames:
    """Names in ``source``, by ``vocabulary``. ``namespace`` is that of new objects.

    All methods raise `LanguageError` at ``span`` for a name that is no IRI, has an unknown prefix,
    or denotes something else.
    """

    source: str
    vocabulary: Vocabulary
    namespace: str = DYKNOW

    def iris(self, name: str, span: Span) -> tuple[str, ...]:
        """Return the possible IRIs of a name, best first: ``speed``, ``dyknow:speed``,
        ``<IRI>``."""
        return possible_iris(name, span, self.source, self.namespace)

    def find_sort(self, name: str, span: Span) -> str | None:
        """Return the IRI of a sort; None if the name is no sort's."""
        return next((iri for iri in self.iris(name, span) if self.vocabulary.is_sort(iri)), None)

    def sort(self, name: str, span: Span) -> str:
        """Return the IRI of a sort."""
        found = self.find_sort(name, span)
        if found is None:
            hint = meant(self.vocabulary.suggest(name, "sort")) or "declare it in the ontology"
            raise self._error(f"the ontology knows no sort `{name}`", span, hint)
        return found

    def object(self, name: str, span: Span) -> str:
        """Return the IRI of an object: one of the ontology, else a new one."""
        if name == "self":
            return self.vocabulary.self_object
        candidates = self.iris(name, span)
        for iri in candidates:
            if self.vocabulary.is_feature(iri) or self.vocabulary.is_event(iri):
                kind = "a feature" if self.vocabulary.is_feature(iri) else "an event"
                raise self._error(
                    f"`{name}` is {kind}, not a sort or object",
                    span,
                    "the arguments of a feature are objects, `speed(uav1)`, or sorts, `speed(UAV)`",
                )
        known = (iri for iri in candidates if self.vocabulary.is_object(iri))
        return next(known, candidates[0])

    def feature(self, name: str, span: Span) -> str:
        """Return the IRI of a feature, or of an event, whose stream carries the event's value."""
        for iri in self.iris(name, span):
            if self.vocabulary.is_feature(iri) or self.vocabulary.is_event(iri):
                return iri
        if self.find_sort(name, span) is not None:
            raise self._error(
                f"`{name}` is a sort, not a feature",
                span,
                "name a feature or an event of its objects, such as `speed`",
            )
        hint = (
            meant(self.vocabulary.suggest(name, "feature"))
            or "add it to the ontology first: dyknow ontology add-feature"
        )
        raise self._error(f"the ontology knows no feature `{name}`", span, hint)

    def check_arity(self, feature: str, name: str, number: int, span: Span) -> None:
        """Raise an error where ``feature`` does not have ``number`` arguments."""
        info = self.vocabulary.feature(feature)
        if info is not None and info.arity is not None and info.arity != number:
            one = info.arity == 1
            arguments = "UAV" if one else ", ".join(f"uav{i + 1}" for i in range(info.arity))
            raise self._error(
                f"`{name}` is a feature of {'one object' if one else f'{info.arity} objects'}, "
                f"and {number or 'none'} {'is' if number < 2 else 'are'} named",
                span,
                f"write `{name}({arguments})` with "
                + ("one sort or object" if one else f"{info.arity} sorts or objects"),
            )

    def _error(self, message: str, span: Span, hint: str = "") -> LanguageError:
        return LanguageError(message, self.source, span, hint)


def possible_iris(name: str, span: Span, source: str, namespace: str = DYKNOW) -> tuple[str, ...]:
    """Return the possible IRIs of a name, best first. Raises `LanguageError`."""
    if name.startswith("<"):
        try:
            return (NamedNode(name[1:-1]).value,)
        except ValueError as error:
            raise LanguageError(f"`{name}` is not an IRI: {error}", source, span) from None
    prefix, colon, local = name.partition(":")
    if not colon:
        spaces = (namespace,) if namespace == DYKNOW else (namespace, DYKNOW)
        return tuple(space + name for space in spaces)
    if prefix not in PREFIXES:
        raise LanguageError(
            f"the prefix `{prefix}:` is not known",
            source,
            span,
            f"write the IRI as <…>, or one of {', '.join(f'{p}:' for p in PREFIXES)}",
        )
    return (PREFIXES[prefix] + local,)
