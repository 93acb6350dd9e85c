"""Reasons why a running query has no results yet: the samples it read, and the features it lacks.

The views of requests and registered queries show them (`event_requests`, `continuous_queries`).
They are derived from counters, annotations and the ontology only.
"""

from __future__ import annotations

from ...languages.csparql import parse_query
from ...languages.errors import LanguageError
from ...languages.kpl import format_policy
from ...languages.ssl.annotation import Content
from ...matching.want import Want
from ...ontology.vocabulary import Vocabulary
from ...rdf.namespaces import shorten
from ...streams.policies.policy import PolicyCounters
from ...templates.needs import NeedsError, needs
from ..configuration.configuration import Configuration
from ..units.base import ComputationalUnit
from ..units.policy import AdaptationUnit
from ..units.shared_query import InstanceUnit
from ..units.windowed import WindowUnit


def why_empty(
    configuration: Configuration, unit: ComputationalUnit, vocabulary: Vocabulary
) -> str | None:
    """Return a text like ``12,000 samples read, 0 triples: no stream that it reads is annotated
    with …``; None once the unit has a result. Cost: O(units behind it), and parsing its query."""
    evaluating = unit.template if isinstance(unit, InstanceUnit) else unit
    if unit.output.stream.last_number or not isinstance(evaluating, WindowUnit):
        return None
    dropped = _dropped(configuration, evaluating)
    if evaluating.late:
        dropped.append(f"{evaluating.late:,} were too late for their windows")
    if not evaluating.samples:
        streams = ", ".join(source.name for source in evaluating.reads)
        return "; ".join([f"no sample read yet from {streams}", *dropped])
    causes = [
        cause
        for want in _wants(unit, vocabulary)
        if (cause := _lacking(want, evaluating.contents, vocabulary)) is not None
    ]
    if not causes and not evaluating.triples:
        causes = ["no sample had both an annotated object and a value"]
    elif not causes and not evaluating.windows:
        causes = ["no window has closed yet"]
    elif not causes:
        causes = [f"none of {evaluating.windows:,} windows satisfied the query's conditions"]
    counts = f"{evaluating.samples:,} samples read, {evaluating.triples:,} triples"
    return f"{counts}: {'; '.join(dict.fromkeys([*causes, *dropped]))}"


def _wants(unit: ComputationalUnit, vocabulary: Vocabulary) -> tuple[Want, ...]:
    """Return the features that the query needs; empty if they cannot be determined."""
    try:
        return needs(parse_query(unit.parameters["query"]), vocabulary).wants
    except (KeyError, LanguageError, NeedsError):
        return ()


def _lacking(want: Want, contents: tuple[Content, ...], vocabulary: Vocabulary) -> str | None:
    """Return why no stream that the query reads can provide ``want``, by the annotations; None if
    one can."""
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
    """Return the numbers of samples that policies before the query dropped."""
    reasons = []
    for part in configuration.units_behind(unit):
        if not isinstance(part, AdaptationUnit):
            continue
        counters: PolicyCounters = part.policy_counters
        count = sum(counters.dropped.values())
        if count:
            reasons.append(f"{count:,} dropped by `{format_policy(part.policy)}`")
    return reasons
