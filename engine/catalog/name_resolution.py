"""What people say, in the terms of the ontology: features, sorts, objects, strategies."""

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
    """A want from names; raises `UnknownFeature` for a feature or sort that is not known.

    Of several objects the second and later are further arguments of an n-ary feature.
    """
    iri = iri_of(feature)
    if not (vocabulary.is_feature(iri) or vocabulary.is_event(iri)):
        raise UnknownFeature(
            f"the ontology knows no feature {shorten(iri)}",
            did_you_mean(vocabulary.suggest(feature, "feature")),
        )
    sort_iri = None if sort is None else iri_of(sort)
    if sort_iri is not None and not vocabulary.is_sort(sort_iri):
        raise UnknownFeature(
            f"the ontology knows no sort {shorten(sort_iri)}",
            did_you_mean(vocabulary.suggest(sort or "", "sort")),
        )
    if not objects:
        return Want(iri, sort_iri)
    first, *others = [SELF if text == "self" else iri_of(text) for text in objects]
    return Want(iri, sort_iri, first, tuple(Subject(None, other) for other in others))


def checked_strategy(text: str) -> Strategy:
    """The strategy that a text names; raises `BadArguments`."""
    try:
        return Strategy.parse(text)
    except UnknownStrategy as error:
        raise BadArguments(str(error)) from error


def iri_of(text: str) -> str:
    """A name as people write it: an IRI, ``<iri>``, a prefixed name, or a local name."""
    if re.fullmatch(r"[A-Za-z_][\w\-]*", text):
        return DYKNOW + text
    if re.match(r"(https?|urn|tag):", text):
        text = f"<{text}>"
    argument = parse_argument(text)
    if not isinstance(argument, NamedNode):
        raise UnknownFeature(f"{text!r} is no name of a term", "write dyknow:speed or an IRI")
    return argument.value


def did_you_mean(names: Sequence[str]) -> str:
    """A hint that names what is spelt alike."""
    return f"did you mean {', '.join(_short(name) for name in names)}?" if names else ""


def _short(name: str) -> str:
    """A name as people write it, whether it is an IRI or short already."""
    return shorten(name) if "://" in name else name
