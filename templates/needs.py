"""What a continuous query needs from streams, and what it produces ([Events14 §IV.A, §V.B]).

[Events14 §IV.A]: the predicates of a query that the ontology knows as features must come from
streams, all others from static graphs; and `?uav a dyknow:UAV` says which objects are meant. The
paper leaves the second out of its scope ("an even better approach"); it is done here.
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
    """The streams that a query needs cannot be inferred from it."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


@dataclass(frozen=True, slots=True)
class Product:
    """What a query produces: its event over sorts or objects, ``HighSpeedEvent[UAV]`` (SPEC §5).

    ``sorts`` are those of the objects it is about, ``objects`` those that were named. All are
    IRIs.
    """

    event: str
    sorts: tuple[str, ...]
    objects: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Needs:
    """The wants of a query, and its product (None where the query's name is no IRI)."""

    wants: tuple[Want, ...]
    product: Product | None


def needs(
    query: ContinuousQuery,
    vocabulary: Vocabulary,
    is_static: Callable[[str], bool] | None = None,
) -> Needs:
    """Which features of which sorts and objects ``query`` needs from streams.

    A want per feature (or event) and subject, in reading order. Its sort is the narrowest that
    holds of the subject wherever the pattern must match, dyknow:Thing where none does; its object
    is a subject that is an IRI, written or bound. ``is_static`` says of a predicate in the
    ``dyknow:`` namespace that is no feature whether static graphs may hold it (default: never).

    Raises `NeedsError` for a variable predicate and for an unknown ``dyknow:`` predicate or
    class, unless the query names its streams itself.
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
    """Names of the variables in predicate positions that no binding fills."""
    bound = {variable.value for variable in query.bindings}
    names = dict.fromkeys(
        pattern.predicate.value
        for pattern in patterns(body_tree(query))
        if isinstance(pattern.predicate, Variable) and pattern.predicate.value not in bound
    )
    return tuple(names)


def in_ontology(store: Store) -> Callable[[str], bool]:
    """For `needs`: a property is static if the store declares it or uses it in any graph."""

    def is_static(predicate: str) -> bool:
        node = NamedNode(predicate)
        return any(
            next(store.quads_for_pattern(subject, used, None, None), None) is not None
            for subject, used in ((node, None), (None, node))
        )

    return is_static


class _Reader:
    """A query's terms with its bindings put in."""

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
        """The IRI that a term is or is bound to."""
        if isinstance(term, Variable):
            return self._bound.get(term.value)
        return term.value if isinstance(term, NamedNode) else None

    def is_streamed(self, pattern: Pattern) -> bool:
        """The pattern is about a feature or event, so streams must bring it."""
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
        known = self._vocabulary
        if known.is_feature(predicate) or known.is_event(predicate):
            return True
        if predicate.startswith(DYKNOW) and not (
            self._named_streams or (self._is_static is not None and self._is_static(predicate))
        ):
            raise NeedsError(
                f"{shorten(predicate)} is neither a feature nor anything else that is known",
                suggestion(predicate, known.suggest(predicate)),
            )
        return False

    def _check_class(self, term: Any) -> None:
        iri = self.iri(term)
        known = self._vocabulary
        if iri is None or self._named_streams or not iri.startswith(DYKNOW):
            return
        if not (known.is_sort(iri) or known.is_event(iri) or known.is_feature(iri)):
            raise NeedsError(
                f"{shorten(iri)} is no known sort", suggestion(iri, known.suggest(iri, "sort"))
            )

    def want(self, pattern: Pattern) -> Want:
        feature = self.iri(pattern.predicate)
        assert feature is not None
        return Want(feature, self.sort(pattern.classes), self.iri(pattern.subject))

    def sort(self, classes: Iterable[Any]) -> str:
        """The narrowest sort among the classes, the first by name where none is within others."""
        known = self._vocabulary
        iris = {iri for term in classes if (iri := self.iri(term)) is not None}
        sorts = sorted(iri for iri in iris if known.is_sort(iri))
        # The narrower a sort, the more sorts contain it.
        return min(sorts, key=lambda sort: -len(known.supersorts(sort)), default=THING)


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
