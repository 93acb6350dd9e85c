"""Reasons why a running query has no results yet: the samples it read, and the features it lacks.

The views of requests and registered queries show them (`event_requests`, `continuous_queries`).
They are derived from counters, annotations and the ontology only.
"""

from __future__ import annotations

from typing import Final, NamedTuple
from weakref import WeakKeyDictionary

from ...languages.csparql import parse_query
from ...languages.csparql.ast import ContinuousQuery
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
from ..units.reasoning.monitor import MonitorUnit
from ..units.reasoning.pattern import PatternUnit
from ..units.sharing.shared_monitor import MonitorInstance
from ..units.sharing.shared_pattern import PatternInstance
from ..units.sharing.shared_query import QueryInstance
from ..units.windowed import WindowUnit

NO_WINDOW: Final = "no window has closed yet"


class _Wants(NamedTuple):
    """The features that a query needs, and reports on its unknown terms, by a version of the
    ontology."""

    version: int
    features: tuple[Want, ...] = ()
    unknown: tuple[str, ...] = ()


_WANTS: Final[WeakKeyDictionary[ComputationalUnit, _Wants]] = WeakKeyDictionary()
"""Those of units: a long query takes 0.1 s to parse, and lists of requests ask for all of them."""


def why_empty(
    configuration: Configuration, unit: ComputationalUnit, ontology: Ontology
) -> str | None:
    """Return a text like ``12,000 samples read, 0 triples: no stream that it reads is annotated
    with …``; None once the unit has a result. Cost: O(units behind it), and parsing its query at
    the first call after a change of the ontology."""
    evaluating = unit.template if isinstance(unit, QueryInstance) else unit
    # Numbers go on from an earlier stream of the name.
    has_given = unit.output.stream.last_available is not None
    if has_given:
        return None
    if isinstance(evaluating, MonitorUnit | MonitorInstance):
        return _without_verdicts(evaluating)
    if isinstance(evaluating, PatternUnit | PatternInstance):
        return _without_matches(evaluating)
    if not isinstance(evaluating, WindowUnit):
        return None
    vocabulary = ontology.vocabulary
    _, wants, unknown = _wants(unit, ontology)
    if any(source.name in configuration.statements for source in evaluating.reads):
        # RDF may have any predicate, also one that the ontology does not know.
        wants, unknown = (), ()
    dropped = _dropped(configuration, evaluating)
    if evaluating.late:
        dropped.append(f"{evaluating.late:,} were too late for their windows")
    if not evaluating.samples:
        streams = ", ".join(source.name for source in evaluating.reads)
        return "; ".join([f"no sample read yet from {streams}", *unknown, *dropped])
    lacking = (_lacking(want, evaluating.contents, vocabulary) for want in wants)
    causes = [*unknown, *(cause for cause in lacking if cause is not None)]
    if not causes and not evaluating.triples:
        causes = ["no sample had both an annotated object and a value"]
    elif not causes and not evaluating.windows:
        causes = [NO_WINDOW]
    elif not causes:
        causes = [f"none of {evaluating.windows:,} windows satisfied the query's conditions"]
    counts = f"{evaluating.samples:,} samples read, {evaluating.triples:,} triples"
    return f"{counts}: {'; '.join(dict.fromkeys([*causes, *dropped]))}"


def _without_verdicts(unit: MonitorUnit | MonitorInstance) -> str:
    """Return why a monitor has reported nothing."""
    if not unit.samples:
        return f"no sample read yet from {', '.join(source.name for source in unit.reads)}"
    run = unit.monitoring
    counts = f"{unit.samples:,} samples read, {run.states:,} states"
    if not run.states:
        return f"{counts}: each waits for later samples, or for `max delay` to pass"
    verdicts = {word: count for word, count in run.verdicts.items() if count}
    if not verdicts:
        return f"{counts}: no verdict is decided yet"
    told = ", ".join(f"{count:,} {word}" for word, count in verdicts.items())
    more = ", others are not decided yet" if run.has_open else ""
    return f"{counts}: the verdicts are {told}{more}, and it reports {run.monitor.report}"


def _without_matches(unit: PatternUnit | PatternInstance) -> str:
    """Return why a pattern has no match."""
    if not unit.samples:
        return f"no sample read yet from {', '.join(source.name for source in unit.reads)}"
    counts = f"{unit.samples:,} samples read"
    missing = [kind for kind, count in unit.rows_of.items() if not count]
    if missing:
        return f"{counts}, none of them of {', '.join(missing)} with its objects and a value"
    pending = unit.pending
    waits = f", and {pending:,} wait for what may still come" if pending else ""
    return f"{counts}: no events match{waits}"


def _wants(unit: ComputationalUnit, ontology: Ontology) -> _Wants:
    """Return what the query of a unit needs; empty if that cannot be determined."""
    found = _WANTS.get(unit)
    if found is None or found.version != ontology.version:
        try:
            query = parse_query(unit.parameters["query"])
        except (KeyError, LanguageError):
            return _Wants(ontology.version)
        return note_query(unit, query, ontology)
    return found


def note_query(unit: ComputationalUnit, query: ContinuousQuery, ontology: Ontology) -> _Wants:
    """Note what the ``query`` of a unit needs, for callers that have it parsed; return it."""
    vocabulary = ontology.vocabulary
    try:
        unknown = unknown_terms(query, vocabulary, is_static_in(ontology.static_store))
        found = _Wants(ontology.version, needs(query, vocabulary).wants, unknown)
    except (LanguageError, NeedsError):
        found = _Wants(ontology.version)
    _WANTS[unit] = found
    return found


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
    for part in configuration.upstream_units(unit):
        if not isinstance(part, AdaptationUnit):
            continue
        counters: PolicyCounters = part.policy_counters
        count = sum(counters.dropped.values())
        if count:
            reasons.append(f"{count:,} dropped by `{format_policy(part.policy)}`")
    return reasons
