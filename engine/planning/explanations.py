"""Explanations: the stages of a request and the plans of queries as text.

`plan_text` shows the units that run; `explain_request` shows each stage that led to them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import assert_never

from ...continuous.estimation.costs import OperatorCost
from ...continuous.estimation.input_rates import Flow
from ...continuous.evaluation.evaluator import ContinuousEvaluator
from ...languages.csparql import format_query, with_streams
from ...languages.csparql.ast import (
    ContinuousQuery,
    CountWindow,
    EventRequest,
    LandmarkWindow,
    Template,
    TimeWindow,
    Window,
)
from ...languages.ssl.annotation import StreamAnnotation
from ...languages.templates import AnyTemplate
from ...matching.match import Match
from ...matching.plan import Node, streams_of
from ...matching.plan_value import cost_of, cost_of_node, quality_of
from ...matching.render import render, steps
from ...matching.space import StreamSpace
from ...matching.tree import Alternative, Outcome
from ...matching.want import Want
from ...ontology.ontology import Ontology
from ...rdf.dictionary import TermDictionary
from ...rdf.namespaces import shorten
from ...streams.time import TIME_MIN, format_duration, format_time
from ...templates.instantiate import parameter_texts
from ...templates.needs import Needs
from ...templates.reasoning import Bound
from ..configuration.configuration import Configuration
from ..model.views import MatchView, PlanView, UnitView
from ..units.base import ComputationalUnit
from ..units.query import QueryUnit
from .reasoning_start import explain_bound
from .static_side import closed_ontology


@dataclass(frozen=True, slots=True)
class Explanation:
    """An explanation: its text, the same by stages (pairs of a title and a text), the matches that
    found its streams, and the operators of its query where it is evaluated by itself."""

    text: str
    stages: tuple[tuple[str, str], ...]
    matches: tuple[Match, ...] = ()
    operators: tuple[OperatorCost, ...] = ()

    @classmethod
    def of(
        cls,
        stages: Sequence[tuple[str, str]],
        matches: Sequence[Match] = (),
        operators: Sequence[OperatorCost] = (),
    ) -> Explanation:
        """Return an explanation whose text has each title, and its stage indented below."""
        parts = (f"{title}\n{_indent(text)}" for title, text in stages)
        return cls("\n\n".join(parts), tuple(stages), tuple(matches), tuple(operators))

    @property
    def found(self) -> bool:
        """Whether everything that was looked for is there."""
        return all(match.supply is not None for match in self.matches)

    @property
    def missing(self) -> tuple[str, ...]:
        """The features that were looked for and are not there, with the reasons."""
        return tuple(reason for match in self.matches for reason in match.lacks)


def unit_view(unit: ComputationalUnit) -> UnitView:
    """Return the view of a unit."""
    return UnitView(
        name=unit.name,
        transformation=unit.transformation,
        inputs=tuple(source.name for source in unit.inputs),
        output=unit.output.name,
        parameters=dict(unit.parameters),
        users=unit.users,
    )


def plan_text(configuration: Configuration, unit: ComputationalUnit) -> str:
    """Draw ``unit`` and the units and streams that it depends on as a tree, output first."""
    lines = [_stream_line(configuration, unit.output.name)]
    _inputs(configuration, unit, "", lines)
    return "\n".join(lines)


def operators_of(unit: ComputationalUnit) -> tuple[OperatorCost, ...]:
    """The operators of a unit's query; none if it has no query of its own."""
    return unit.explanation().operators() if isinstance(unit, QueryUnit) else ()


def match_view(
    want: Want,
    match: Match,
    strategy: str,
    space: StreamSpace,
    is_running: Callable[[Node], bool],
) -> MatchView:
    """Return the view of a match, without executing its plan."""
    plan = cost = quality = None
    if match.supply is not None:
        plan = PlanView(render(match), streams_of(match.supply), (), "")
        cost = cost_of(match.supply, space, is_running)
        quality = quality_of(match.supply, space)
    reasons = match.missing or tuple(
        f"{alternative.text}: {alternative.reason}"
        for alternative in match.tree
        if alternative.outcome is Outcome.FAILED and alternative.reason
    )
    return MatchView(
        feature=shorten(want.feature),
        target=str(want),
        strategy=strategy,
        found=match.supply is not None,
        plan=plan,
        alternatives=tuple(
            _alternative(alternative, reasons)
            for alternative in match.tree
            if alternative.outcome is not Outcome.CHOSEN
        ),
        reasons=reasons,
        cost=cost,
        quality=quality,
        proven=match.proven,
        tree=steps(match, partial(cost_of_node, space=space, is_running=is_running)),
    )


def explain_template(template: AnyTemplate) -> str:
    """Explain a template: parameters, window, text."""
    window = template.query.window if isinstance(template, Template) else None
    lines = [
        f"template {shorten(template.name)}",
        "parameters: " + ", ".join(parameter_texts(template)),
    ]
    if window is not None:
        lines.append(f"window: {window_text(window)}")
    return "\n".join([*lines, "", template.source.strip()])


def explain_query(
    parsed: ContinuousQuery,
    ontology: Ontology,
    dictionary: TermDictionary,
    flows: Mapping[str, Flow],
) -> Explanation:
    """Explain a query that names its streams: the parsed text, then the plans. ``flows``: the rates
    of its streams, by their IRIs in the query."""
    names = list(dict.fromkeys(clause.iri for clause in parsed.streams))
    background = closed_ontology(ontology, parsed.static_named)
    evaluator = ContinuousEvaluator(parsed, dictionary, background, names)
    evaluation = evaluator.explanation(flows)
    stages = ("query", format_query(parsed)), ("evaluation", str(evaluation))
    text = "\n\n".join(text for _, text in stages)
    return Explanation(text, stages, operators=evaluation.operators())


def explain_matched_query(
    parsed: ContinuousQuery,
    wanted: Needs,
    matches: Sequence[Match],
    ontology: Ontology,
    dictionary: TermDictionary,
) -> Explanation:
    """Explain a query that names no streams: text, matching, plans."""
    stages, operators = _matching_stages(parsed, wanted, matches, ontology, dictionary)
    return Explanation.of([("registered", parsed.source.strip()), *stages], matches, operators)


def explain_reasoning_plan(source: str, matches: Sequence[Match], evaluation: str) -> Explanation:
    """Explain a monitor or pattern that is not started: text, matching, evaluation."""
    return explain_running_query(source.strip(), (), matches, "none yet", evaluation, "")


def explain_running_query(
    source: str,
    read: Sequence[StreamAnnotation],
    matches: Sequence[Match],
    plan: str,
    evaluation: str,
    alone: str,
    operators: Sequence[OperatorCost] = (),
) -> Explanation:
    """Explain a running query: text, annotations of its streams or the matches that found them,
    units, evaluation of windows. ``alone``: why it shares no computation with other queries; empty
    if it does."""
    stages = [("registered", source)]
    if read:
        stages.append(("streams", "\n".join(each.source or each.stream for each in read)))
    if matches:
        stages.append(_matched(matches))
    if alone:
        evaluation = f"by itself: {alone}\n\n{evaluation}"
    stages += [("units", plan), ("evaluation", evaluation)]
    return Explanation.of(stages, matches, operators)


def explain_request(
    template: AnyTemplate,
    request: EventRequest,
    bound: ContinuousQuery | Bound,
    wanted: Needs,
    matches: Sequence[Match],
    ontology: Ontology,
    dictionary: TermDictionary,
) -> Explanation:
    """Explain a request: template, needed features, matching, query, plans of the evaluation."""
    stages = [("request", request.source.strip()), ("template", template.source.strip())]
    if isinstance(bound, ContinuousQuery):
        more, operators = _matching_stages(bound, wanted, matches, ontology, dictionary)
        return Explanation.of([*stages, *more], matches, operators)
    stages += [*_found(wanted, matches), ("evaluation", explain_bound(bound))]
    return Explanation.of(stages, matches)


def _matching_stages(
    bound: ContinuousQuery,
    wanted: Needs,
    matches: Sequence[Match],
    ontology: Ontology,
    dictionary: TermDictionary,
) -> tuple[list[tuple[str, str]], tuple[OperatorCost, ...]]:
    """Explain needed features and matching; if all are found, the query and its plans too, with its
    operators."""
    stages = _found(wanted, matches)
    streams = [name for m in matches if m.supply is not None for name in streams_of(m.supply)]
    if any(match.supply is None for match in matches):
        return stages, ()
    names = list(dict.fromkeys(streams))
    filled = with_streams(bound, names)
    evaluator = ContinuousEvaluator(filled, dictionary, closed_ontology(ontology), names)
    evaluation = evaluator.explanation()
    stages += [("query", format_query(filled)), ("evaluation", str(evaluation))]
    return stages, evaluation.operators()


def _found(wanted: Needs, matches: Sequence[Match]) -> list[tuple[str, str]]:
    return [("features needed", "\n".join(map(str, wanted.wants))), _matched(matches)]


def _matched(matches: Sequence[Match]) -> tuple[str, str]:
    return "semantic matching", "\n".join(map(render, matches))


def plan_view(configuration: Configuration, unit: ComputationalUnit) -> PlanView:
    """Return the plan of the running query ``unit``: tree, streams and units."""
    units = configuration.upstream_units(unit)
    outputs = {part.output.name for part in units}
    sources = [source.name for part in units for source in part.inputs]
    return PlanView(
        text=plan_text(configuration, unit),
        streams=tuple(dict.fromkeys(name for name in sources if name not in outputs)),
        units=tuple(unit_view(part) for part in units),
        query=unit.parameters["query"],
    )


def waits_for(configuration: Configuration, unit: ComputationalUnit) -> tuple[str, ...]:
    """Return the input streams from outside that ``unit`` depends on, that have no samples yet and
    are not idle."""
    waiting = (s for part in configuration.upstream_units(unit) for s in part.waits_for)
    names = dict.fromkeys(source.name for source in waiting)
    return tuple(name for name in names if name not in configuration.units)


def held_back_by(configuration: Configuration, unit: ComputationalUnit) -> tuple[str, ...]:
    """Return the streams from outside with the least watermark that ``unit`` depends on. Its next
    window closes when they advance, end or become idle."""
    sources = dict.fromkeys(s for part in configuration.upstream_units(unit) for s in part.inputs)
    active = [s for s in sources if not s.is_ended and not s.is_idle]
    waiting = [s for s in active if s.name not in configuration.units]
    least = min((TIME_MIN if s.watermark is None else s.watermark for s in waiting), default=None)
    return tuple(s.name for s in waiting if s.watermark in (None, least))


def _inputs(
    configuration: Configuration, unit: ComputationalUnit, margin: str, lines: list[str]
) -> None:
    for i, source in enumerate(unit.inputs):
        last = i == len(unit.inputs) - 1
        lines.append(
            f"{margin}{'└─ ' if last else '├─ '}{_stream_line(configuration, source.name)}"
        )
        producer = configuration.units.get(source.name)
        if producer is not None:
            _inputs(configuration, producer, margin + ("   " if last else "│  "), lines)


def _stream_line(configuration: Configuration, name: str) -> str:
    unit = configuration.units.get(name)
    if unit is None:
        stream = configuration.streams.get(name)
        return f"{name}  (stream, idle)" if stream and stream.is_idle else f"{name}  (stream)"
    details = ", ".join(
        f"{key}={value}" for key, value in unit.parameters.items() if "\n" not in value
    )
    label = f"{unit.transformation}({details})" if details else unit.transformation
    return f"{name}  ← {label} as {unit.name}"


def _alternative(alternative: Alternative, reasons: Sequence[str]) -> str:
    """An alternative, with its reason where that is none of the ``reasons`` of the match."""
    is_said = any(reason.endswith(alternative.reason) for reason in reasons)
    reason = f": {alternative.reason}" if alternative.reason and not is_said else ""
    return f"{alternative.outcome}: {alternative.text}{reason}"


def window_text(window: Window) -> str:
    """Describe a window in words."""
    match window:
        case TimeWindow():
            held, step = f"the last {format_duration(window.range)}", format_duration(window.step)
        case CountWindow():
            held = "the last triple" if window.size == 1 else f"the last {window.size} triples"
            step = "triple" if window.step == 1 else str(window.step)
        case LandmarkWindow():
            since = "the beginning" if window.start is None else format_time(window.start)
            held, step = f"all since {since}", format_duration(window.step)
        case _:
            assert_never(window)
    return f"{held}, every {step}"


def _indent(text: str) -> str:
    return "\n".join(f"  {line}" for line in text.splitlines())
