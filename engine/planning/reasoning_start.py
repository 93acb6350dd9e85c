"""Starts formulas and patterns alike, over the streams that matching found (SPEC §8)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

from ...languages.ssl.annotation import StreamAnnotation
from ...matching.plan import Node, Supply
from ...ontology.ontology import Ontology
from ...rdf.dictionary import TermDictionary
from ...streams.generator import StreamGenerator
from ...templates.formulas import BoundFormula
from ...templates.needs import NeedsError, is_static_in
from ...templates.reasoning import Bound, Reasoned, bound_text
from ..configuration.configuration import Configuration
from ..model.beginning import Beginning
from ..model.errors import BadArguments
from ..units.reasoning.monitor import MonitorUnit
from ..units.reasoning.pattern import PatternUnit
from ..units.sharing.shared_pattern import PatternInstance
from .monitor_start import MonitorStarter, explain_monitor, verdict_annotation
from .pattern_start import PatternStarter, explain_pattern, match_annotation

ReasoningUnit: TypeAlias = MonitorUnit | PatternUnit | PatternInstance


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
        self.patterns = PatternStarter(ontology, dictionary, configuration, obtain)
        """Starts patterns, shared ones, too."""

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
        return self.patterns.start(bound, supplies, since, name=name, request=request)


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
    if isinstance(unit, MonitorUnit):
        return verdict_annotation(stream, event, unit.monitoring.monitor)
    return match_annotation(stream, event, unit.query)
