"""Why a query that runs has given nothing yet: what it read, and what that lacks.

Called by the views of requests and registered queries (`event_requests`, `continuous_queries`). All
of it is what was counted and what annotations and the ontology say; nothing is guessed.
"""

from __future__ import annotations

from typing import Final

from ...languages.csparql import parse_query
from ...languages.errors import LanguageError
from ...languages.kpl import format_policy
from ...languages.ssl.annotation import Content
from ...matching.want import Want
from ...ontology.ontology import Ontology
from ...ontology.vocabulary import Vocabulary
from ...rdf.namespaces import shorten
from ...streams.policies.policy import PolicyCounters
from ...templates.needs import NeedsError, is_static_in, needs, unknown_terms
from ..configuration.configuration import Configuration
from ..units.base import ComputationalUnit
from ..units.policy import AdaptationUnit
from ..units.shared_query import InstanceUnit
from ..units.windowed import WindowUnit

NO_WINDOW: Final = "no window has closed yet"


def why_empty(
    configuration: Configuration, unit: ComputationalUnit, ontology: Ontology
) -> str | None:
    """``12,000 samples read, 0 triples: no stream that it reads is annotated with …``; None once
    the unit has given a sample. Cost: O(units behind it), and the reading of its query."""
    evaluating = unit.template if isinstance(unit, InstanceUnit) else unit
    # Numbers go on from an earlier stream of the name.
    has_given = unit.output.stream.last_available is not None
    if has_given or not isinstance(evaluating, WindowUnit):
        return None
    vocabulary = ontology.vocabulary
    wants, unknown = _asked(unit, ontology)
    lost = _dropped(configuration, evaluating)
    if evaluating.late:
        lost.append(f"{evaluating.late:,} came too late for their windows")
    if not evaluating.samples:
        streams = ", ".join(source.name for source in evaluating.reads)
        return "; ".join([f"no sample read yet from {streams}", *unknown, *lost])
    lacking = (_lacking(want, evaluating.contents, vocabulary) for want in wants)
    causes = [*unknown, *(cause for cause in lacking if cause is not None)]
    if not causes and not evaluating.triples:
        causes = ["no sample had an object that the annotation speaks of, and a value"]
    elif not causes and not evaluating.windows:
        causes = [NO_WINDOW]
    elif not causes:
        causes = [f"none of {evaluating.windows:,} windows fulfilled the query's conditions"]
    said = f"{evaluating.samples:,} samples read, {evaluating.triples:,} triples"
    return f"{said}: {'; '.join(dict.fromkeys([*causes, *lost]))}"


def _asked(unit: ComputationalUnit, ontology: Ontology) -> tuple[tuple[Want, ...], tuple[str, ...]]:
    """What the query needs of streams, and its terms that nothing knows; nothing where that cannot
    be told."""
    try:
        query = parse_query(unit.parameters["query"])
        unknown = unknown_terms(query, ontology.vocabulary, is_static_in(ontology.static_store))
        return needs(query, ontology.vocabulary).wants, unknown
    except (KeyError, LanguageError, NeedsError):
        return (), ()


def _lacking(want: Want, contents: tuple[Content, ...], vocabulary: Vocabulary) -> str | None:
    """What of a want no stream that is read can give, by its annotation."""
    names = {want.feature, *vocabulary.subfeatures(want.feature)}
    carried = [content for content in contents if content.feature in names]
    if not carried:
        return f"no stream that it reads is annotated with {shorten(want.feature)}"
    if want.sort is None:
        return None
    wanted = {want.sort, *vocabulary.subsorts(want.sort)}
    for content in carried:
        for role in content.roles:
            is_known = role.object is not None and vocabulary.sorts_of(role.object) & wanted
            if role.sort in wanted or is_known:
                return None
    if not want.sort or vocabulary.has_members(want.sort):
        return None
    return f"no member of {shorten(want.sort)} seen"


def _dropped(configuration: Configuration, unit: WindowUnit) -> list[str]:
    """What the policies between the streams and the query did not let through."""
    told = []
    for part in configuration.upstream_units(unit):
        if not isinstance(part, AdaptationUnit):
            continue
        counters: PolicyCounters = part.policy_counters
        count = sum(counters.dropped.values())
        if count:
            told.append(f"{count:,} dropped by `{format_policy(part.policy)}`")
    return told
