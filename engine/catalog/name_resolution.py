"""Resolves the names in requests to features, sorts and objects of the ontology, and strategies."""

from __future__ import annotations

import re
from collections.abc import Sequence

from pyoxigraph import NamedNode

from ...languages.csparql import parse_argument
from ...matching.strategy import Strategy, UnknownStrategy
from ...matching.subject import Subject
from ...matching.want import Want
from ...ontology.vocabulary import SELF, Vocabulary
from ...rdf.namespaces import DYKNOW, shorten
from ..model.errors import BadArguments, UnknownFeature


def checked_want(
    vocabulary: Vocabulary, feature: str, sort: str | None, objects: Sequence[str]
) -> Want:
    """Return the want that these names describe. Raises `UnknownFeature` for an unknown feature or
    sort.

    The second and later objects are further arguments of an n-ary feature.
    """
    iri = iri_of(feature)
    if not (vocabulary.is_feature(iri) or vocabulary.is_event(iri)):
        raise UnknownFeature(
            f"the ontology knows no feature {shorten(iri)}",
            did_you_mean(vocabulary.suggest(feature, "feature")),
        )
    sort_iri = None if sort is None else checked_sort(vocabulary, sort)
    if not objects:
        return Want(iri, sort_iri)
    first, *others = [SELF if text == "self" else iri_of(text) for text in objects]
    return Want(iri, sort_iri, first, tuple(Subject(None, other) for other in others))


def checked_sort(vocabulary: Vocabulary, sort: str) -> str:
    """Return the IRI of a sort. Raises `UnknownFeature`."""
    iri = iri_of(sort)
    if not vocabulary.is_sort(iri):
        raise UnknownFeature(
            f"the ontology knows no sort {shorten(iri)}",
            did_you_mean(vocabulary.suggest(sort, "sort")),
        )
    return iri


def checked_strategy(text: str) -> Strategy:
    """Return the strategy that a text names. Raises `BadArguments`."""
    try:
        return Strategy.parse(text)
    except UnknownStrategy as error:
        raise BadArguments(str(error)) from error


def iri_of(text: str) -> str:
    """Return the IRI that a user's name means: an IRI, ``<iri>``, a prefixed name, or a local name.
    Raises `UnknownFeature`."""
    if re.fullmatch(r"[A-Za-z_][\w\-]*", text):
        return DYKNOW + text
    if re.match(r"(https?|urn|tag):", text):
        text = f"<{text}>"
    argument = parse_argument(text)
    if not isinstance(argument, NamedNode):
        raise UnknownFeature(f"{text!r} does not name a term", "write dyknow:speed or an IRI")
    return argument.value


def did_you_mean(names: Sequence[str]) -> str:
    """Return a hint with similarly spelt names."""
    return f"did you mean {', '.join(_short(name) for name in names)}?" if names else ""


def _short(name: str) -> str:
    """Shorten ``name`` if it is an IRI without angle brackets."""
    return shorten(name) if "://" in name and not name.startswith("<") else name
