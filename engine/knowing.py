"""Semantic matching as a question: what would give a feature ([Introspection15 §4.3])."""

from __future__ import annotations

import re
from collections.abc import Sequence

from pyoxigraph import NamedNode

from ..languages.csparql import parse_argument
from ..matching.match import Match, UnknownStrategy, match
from ..matching.space import StreamSpace
from ..matching.want import Want
from ..ontology.vocabulary import Vocabulary
from ..rdf.namespaces import DYKNOW, PREFIXES, shorten
from . import explain as explanations
from .errors import BadArguments, Refused, UnknownFeature
from .views import MatchView


def matched(
    vocabulary: Vocabulary,
    space: StreamSpace,
    feature: str,
    sort: str | None,
    objects: Sequence[str],
    strategy: str,
) -> MatchView:
    """What would give ``feature``, and why; see `Engine.match`."""
    iri = iri_of(feature)
    if not vocabulary.is_feature(iri):
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
    if len(objects) > 1:
        raise Refused("features of one object are matched so far", "name one object, or a sort")
    want = Want(iri, sort_iri, iri_of(objects[0]) if objects else None)
    try:
        found: Match = match(want, space, vocabulary, strategy)
    except UnknownStrategy as error:
        raise BadArguments(str(error)) from error
    return explanations.match_view(want, found, strategy)


def iri_of(text: str) -> str:
    """A name as people write it: an IRI, ``<iri>``, a prefixed name, or a local name."""
    if re.fullmatch(r"[A-Za-z_][\w\-]*", text):
        return DYKNOW + text
    if re.match(r"(https?|urn|tag):", text):
        text = f"<{text}>"
    argument = parse_argument(text, PREFIXES)
    if not isinstance(argument, NamedNode):
        raise UnknownFeature(f"{text!r} is no name of a term", "write dyknow:speed or an IRI")
    return argument.value


def did_you_mean(names: Sequence[str]) -> str:
    """A hint that names what is spelt alike."""
    return f"did you mean {', '.join(_short(name) for name in names)}?" if names else ""


def _short(name: str) -> str:
    """A name as people write it, whether it is an IRI or short already."""
    return shorten(name) if "://" in name else name
