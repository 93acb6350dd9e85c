"""Starts formulas and patterns alike, over the streams that matching found (SPEC §8)."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from ...languages.mtl import CheckedMonitor
from ...languages.ssl.annotation import StreamAnnotation
from ...matching.plan import Node, Supply
from ...ontology.ontology import Ontology
from ...rdf.dictionary import TermDictionary
from ...reasoning.patterns.plans.by_object import PatternByObject
from ...streams.generator import StreamGenerator
from ...templates.event_patterns import BoundPattern
from ...templates.formulas import BoundFormula
from ...templates.needs import NeedsError, is_static_in
from ...templates.reasoning import Bound, Reasoned, bound_text
from ..configuration.configuration import Configuration
from ..model.beginning import Beginning
from ..model.errors import BadArguments
from ..units.reasoning.monitor import MonitorUnit
from ..units.reasoning.pattern import PatternUnit
from ..units.sharing.shared_monitor import MonitorInstance, SharedMonitorUnit
from ..units.sharing.shared_pattern import PatternInstance, SharedPatternUnit
from .monitor_start import MonitorStarter, explain_monitor, verdict_annotation
from .pattern_start import PatternStarter, explain_pattern, match_annotation

ReasoningUnit: TypeAlias = MonitorUnit | MonitorInstance | PatternUnit | PatternInstance
EvaluationByObject: TypeAlias = CheckedMonitor | PatternByObject
"""What is evaluated of each object by itself. A monitor has parameters instead of values."""
SharedUnit: TypeAlias = SharedMonitorUnit | SharedPatternUnit


@dataclass(frozen=True, slots=True)
class ShareableEvaluation:
    """The ``evaluation`` that requests with an equal ``key`` can share, for an ``object`` (an IRI).
    ``own`` is the formula or pattern of this object, ``free`` that of all, over the streams of
    ``supplies``.
    """

    key: Hashable
    evaluation: EvaluationByObject
    object: str
    own: Bound
    free: Bound
    supplies: tuple[Supply, ...]

    @property
    def keys(self) -> tuple[Hashable, ...]:
        """The keys for which a request counts while it is evaluated alone."""
        return (self.key,)


class ReasoningStarter:
    """Starts the units of formulas and patterns. ``obtain`` returns the stream of a plan node."""

    def __init__(
        self,
        ontology: Ontology,
        dictionary: TermDictionary,
        configuration: Configuration,
        obtain: Callable[[Node, Beginning], StreamGenerator],
    ) -> None:
        self._monitors = MonitorStarter(ontology, dictionary, configuration, obtain)
        self._patterns = PatternStarter(ontology, dictionary, configuration, obtain)

    def start(
        self,
        bound: Bound,
        supplies: Sequence[Supply],
        since: Beginning,
        *,
        name: str | None = None,
        request: str | None = None,
    ) -> ReasoningUnit:
        """Start the units of the ``supplies``, one for each want, and the unit over them. Its
        stream gets ``name``, or the next reserved one. ``request``: the text of the request that
        has the arguments of a template. Raises `BadArguments` and `LanguageError`."""
        if isinstance(bound, BoundFormula):
            return self._monitors.start(bound, supplies, since, name=name, request=request)
        return self._patterns.start(bound, supplies, since, name=name, request=request)

    def start_shared(self, shareable: ShareableEvaluation) -> SharedUnit:
        """Start the evaluation that requests share."""
        evaluation, free, supplies = shareable.evaluation, shareable.free, shareable.supplies
        if isinstance(evaluation, CheckedMonitor):
            assert isinstance(free, BoundFormula)
            return self._monitors.start_shared(evaluation, free, supplies)
        assert isinstance(free, BoundPattern)
        return self._patterns.start_shared(evaluation, free, supplies)

    def start_instance(
        self, shared: SharedUnit, shareable: ShareableEvaluation, request: str
    ) -> MonitorInstance | PatternInstance:
        """Start the unit of a request that shares an evaluation, with the arguments of ``request``
        (its text)."""
        own, free, object = shareable.own, shareable.free, shareable.object
        if isinstance(shared, SharedMonitorUnit):
            assert isinstance(own, BoundFormula)
            assert isinstance(free, BoundFormula)
            return self._monitors.start_instance(shared, own, free, object, request)
        assert isinstance(own, BoundPattern)
        return self._patterns.start_instance(shared, own, object, request)


def bound_of(reasoned: Reasoned, source: str, ontology: Ontology) -> Bound:
    """Return a monitor or pattern with what it needs. Raises `LanguageError`, and `BadArguments`
    for what no streams can give."""
    try:
        is_static = is_static_in(ontology.static_store)
        return bound_text(reasoned, source, ontology.vocabulary, is_static)
    except NeedsError as error:
        raise BadArguments(error.message, error.hint) from error


def explain_bound(bound: Bound) -> str:
    """Describe the evaluation before it starts. Raises `BadArguments`."""
    if isinstance(bound, BoundFormula):
        return explain_monitor(bound.monitor)
    return explain_pattern(bound)


def result_annotation(event: str, unit: ReasoningUnit) -> StreamAnnotation | None:
    """Return the annotation of a unit's results as the ``event`` (an IRI); None without objects."""
    stream = unit.output.name
    if isinstance(unit, MonitorUnit | MonitorInstance):
        return verdict_annotation(stream, event, unit.monitor)
    return match_annotation(stream, event, unit.query)
