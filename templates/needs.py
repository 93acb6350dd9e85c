"""Infers what a continuous query needs from streams, and what it produces ([Events14 §IV.A, §V.B]).

[Events14 §IV.A]: predicates of a query that the ontology knows as features come from streams, all
others from static graphs. `?uav a dyknow:UAV` states which objects are meant. The paper leaves this
second inference out of scope ("an even better approach"); this module implements it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from pyoxigraph import NamedNode, Store, Variable

from ..languages.csparql import body_tree
from ..languages.csparql.ast import ContinuousQuery
from ..matching.want import THING, Want
from ..ontology.vocabulary import Vocabulary
from ..rdf.namespaces import DYKNOW, RDF_TYPE, shorten
from .instantiate import suggestion
from .patterns import Pattern, head_subjects, patterns


class NeedsError(ValueError):
    """The streams that a query needs cannot be inferred."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


@dataclass(frozen=True, slots=True)
class Product:
    """The event of a query with its sorts or objects, ``HighSpeedEvent[UAV]`` (SPEC §5).

    ``sorts`` are those of the objects in the event, ``objects`` the named ones. All are IRIs.
    """

    event: str
    sorts: tuple[str, ...]
    objects: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Needs:
    """The wants of a query, and its product (None if the query's name is no IRI)."""

    wants: tuple[Want, ...]
    product: Product | None


def needs(
    query: ContinuousQuery,
    vocabulary: Vocabulary,
    is_static: Callable[[str], bool] | None = None,
) -> Needs:
    """Return the features of the sorts and objects that ``query`` needs from streams.

    There is a want for each feature (or event) and subject, in reading order. Its sort is the
    narrowest that applies to the subject wherever the pattern must match, else dyknow:Thing. Its
    object is the subject if that is an IRI, written or bound. ``is_static`` tells whether static
    graphs may contain a ``dyknow:`` predicate that is no feature (default: never).

    Raises `NeedsError` for a variable predicate and for an unknown ``dyknow:`` predicate or class,
    unless the query names its streams itself.
    """
    root = body_tree(query)
    reader = _Reader(query, vocabulary, is_static)
    found = [pattern for pattern in patterns(root) if reader.is_streamed(pattern)]
    wants = tuple(dict.fromkeys(reader.want(pattern) for pattern in found))
    return Needs(wants, _product(query, reader, wants, head_subjects(root), patterns(root)))


def unknown_terms(
    query: ContinuousQuery, vocabulary: Vocabulary, is_static: Callable[[str], bool]
) -> tuple[str, ...]:
    """What `needs` would say of ``dyknow:`` predicates and classes that nothing knows, each once,
    also where the query names its streams; with what is spelt alike."""
    reader = _Reader(replace(query, streams=()), vocabulary, is_static)
    found: dict[str, None] = {}
    for pattern in patterns(body_tree(query)):
        if reader.iri(pattern.predicate) is None:
            continue
        try:
            reader.is_streamed(pattern)
        except NeedsError as error:
            found["; ".join(filter(None, (error.message, error.hint)))] = None
    return tuple(found)


def open_predicates(query: ContinuousQuery) -> tuple[str, ...]:
    """Return the names of the variables in predicate positions that no binding fills."""
    bound = {variable.value for variable in query.bindings}
    names = dict.fromkeys(
        pattern.predicate.value
        for pattern in patterns(body_tree(query))
        if isinstance(pattern.predicate, Variable) and pattern.predicate.value not in bound
    )
    return tuple(names)


def is_static_in(store: Store) -> Callable[[str], bool]:
    """Return an `is_static` for `needs`: true if the store declares or uses the property in any
    graph."""

    def is_static(predicate: str) -> bool:
        node = NamedNode(predicate)
        return any(
            next(store.quads_for_pattern(subject, used, None, None), None) is not None
            for subject, used in ((node, None), (None, node))
        )

    return is_static


class _Reader:
    """Resolves a query's terms by its bindings."""

    def __init__(
        self,
        query: ContinuousQuery,
        vocabulary: Vocabulary,
        is_static: Callable[[str], bool] | None,
    ) -> None:
        self._vocabulary = vocabulary
        self._is_static = is_static
        self._named_streams = bool(query.streams)
        self._bound: Mapping[str, str] = {
            variable.value: term.value
            for variable, term in query.bindings.items()
            if isinstance(term, NamedNode)
        }

    def iri(self, term: Any) -> str | None:
        """Return the IRI of a term, or of its binding."""
        if isinstance(term, Variable):
            return self._bound.get(term.value)
        return term.value if isinstance(term, NamedNode) else None

    def is_streamed(self, pattern: Pattern) -> bool:
        """Return whether streams must provide the pattern: its predicate is a feature or event."""
        predicate = self.iri(pattern.predicate)
        if predicate is None:
            if self._named_streams:
                return False
            raise NeedsError(
                f"the predicate {pattern.predicate} may be any feature, "
                "so the streams cannot be inferred",
                "name them with FROM STREAM, or write the feature",
            )
        if predicate == RDF_TYPE.value:
            self._check_class(pattern.object)
            return False
        vocabulary = self._vocabulary
        if vocabulary.is_feature(predicate) or vocabulary.is_event(predicate):
            return True
        if predicate.startswith(DYKNOW) and not (
            self._named_streams or (self._is_static is not None and self._is_static(predicate))
        ):
            raise NeedsError(
                f"{shorten(predicate)} is neither a feature nor another known term",
                suggestion(vocabulary.suggest(predicate)),
            )
        return False

    def _check_class(self, term: Any) -> None:
        iri = self.iri(term)
        vocabulary = self._vocabulary
        if iri is None or self._named_streams or not iri.startswith(DYKNOW):
            return
        if not (vocabulary.is_sort(iri) or vocabulary.is_event(iri) or vocabulary.is_feature(iri)):
            raise NeedsError(
                f"{shorten(iri)} is not a known sort",
                suggestion(vocabulary.suggest(iri, "sort")),
            )

    def want(self, pattern: Pattern) -> Want:
        feature = self.iri(pattern.predicate)
        assert feature is not None
        return Want(feature, self.sort(pattern.classes), self.iri(pattern.subject))

    def sort(self, classes: Iterable[Any]) -> str:
        """Return the narrowest sort among the classes; the first by name if there are several."""
        vocabulary = self._vocabulary
        iris = {iri for term in classes if (iri := self.iri(term)) is not None}
        sorts = sorted(iri for iri in iris if vocabulary.is_sort(iri))
        # A narrower sort has more super-sorts.
        return min(sorts, key=lambda sort: -len(vocabulary.supersorts(sort)), default=THING)


def _product(
    query: ContinuousQuery,
    reader: _Reader,
    wants: tuple[Want, ...],
    heads: tuple[Any, ...],
    body: tuple[Pattern, ...],
) -> Product | None:
    if ":" not in query.name:
        return None
    objects = dict.fromkeys(iri for head in heads if (iri := reader.iri(head)) is not None)
    sorts: dict[str, None] = {}
    for head in heads:
        classes = {c for pattern in body if pattern.subject == head for c in pattern.classes}
        sorts[reader.sort(classes)] = None
    if not heads:
        objects = dict.fromkeys(want.object for want in wants if want.object is not None)
        sorts = dict.fromkeys(want.wanted_sort for want in wants)
    return Product(query.name, tuple(sorts), tuple(objects))
