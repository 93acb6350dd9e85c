"""Explanations: each stage of a request as text for people.

The plan tree shows what runs; `request` shows how it came about, stage by stage.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import assert_never

from pyoxigraph import NamedNode, Store

from ...continuous.estimation.input_rates import Flow
from ...continuous.evaluation.evaluator import ContinuousEvaluator
from ...continuous.operators.background import Background
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
from ...matching.match import Match
from ...matching.plan import Node, streams_of
from ...matching.plan_value import cost_of, quality_of
from ...matching.render import render
from ...matching.space import StreamSpace
from ...matching.tree import Alternative, Outcome
from ...matching.want import Want
from ...ontology.ontology import Ontology
from ...ontology.units import Conversion, UnitError, conversion
from ...rdf.dictionary import TermDictionary
from ...rdf.namespaces import shorten
from ...streams.time import TIME_MIN, format_duration, format_time
from ...templates.needs import Needs
from ..configuration.configuration import Configuration
from ..model.views import MatchView, PlanView, UnitView
from ..units.base import ComputationalUnit


def closed_ontology(ontology: Ontology, named: Sequence[str] = ()) -> Background:
    """The static side of queries: the ontologies with all that they entail, as they are now.

    ``named`` are the ontologies that a query names with FROM NAMED: graphs of their own, too.
    """
    if not named:
        return _background(ontology, ontology.closed_store)
    made: list[tuple[int, Store]] = []

    def store() -> Store:
        if not made or made[0][0] != ontology.version:
            both = Store()
            both.extend(ontology.closed_store())
            for iri in named:
                both.extend(
                    ontology.static_store.quads_for_pattern(None, None, None, NamedNode(iri))
                )
            made[:] = [(ontology.version, both)]
        return made[0][1]

    return _background(ontology, store)


def _background(ontology: Ontology, store: Callable[[], Store]) -> Background:
    def change(source: str, target: str) -> Conversion | None:
        known = [ontology.vocabulary.feature(iri) for iri in (source, target)]
        units = [None if feature is None else feature.unit for feature in known]
        if units[0] is None or units[1] is None or units[0] == units[1]:
            return None
        try:
            return conversion(units[0], units[1])
        except UnitError:
            return None

    return Background(
        store, lambda: ontology.version, rules=lambda: ontology.rules, conversion=change
    )


def unit_view(unit: ComputationalUnit) -> UnitView:
    """A unit as the service shows it."""
    return UnitView(
        name=unit.name,
        transformation=unit.transformation,
        inputs=tuple(source.name for source in unit.inputs),
        output=unit.output.name,
        parameters=dict(unit.parameters),
        users=unit.users,
    )


def plan_text(configuration: Configuration, unit: ComputationalUnit) -> str:
    """The units and streams behind ``unit``, as a tree from its output down to the sources."""
    lines = [_stream_line(configuration, unit.output.name)]
    _inputs(configuration, unit, "", lines)
    return "\n".join(lines)


def match_view(
    want: Want,
    found: Match,
    strategy: str,
    space: StreamSpace,
    is_running: Callable[[Node], bool],
) -> MatchView:
    """A match as the service shows it; nothing was started."""
    plan = cost = quality = None
    if found.supply is not None:
        plan = PlanView(render(found), streams_of(found.supply), (), "")
        cost = cost_of(found.supply, space, is_running)
        quality = quality_of(found.supply, space)
    reasons = found.missing or tuple(
        f"{alternative.text}: {alternative.reason}"
        for alternative in found.tree
        if alternative.outcome is Outcome.FAILED and alternative.reason
    )
    return MatchView(
        feature=shorten(want.feature),
        target=str(want),
        strategy=strategy,
        found=found.supply is not None,
        plan=plan,
        alternatives=tuple(
            _alternative(alternative, reasons)
            for alternative in found.tree
            if alternative.outcome is not Outcome.CHOSEN
        ),
        reasons=reasons,
        cost=cost,
        quality=quality,
        proven=found.proven,
    )


def template(known: Template) -> str:
    """A template: its parameters, its windows, its text."""
    window = known.query.window
    lines = [
        f"template {shorten(known.name)}",
        "parameters: " + ", ".join(f"?{parameter.value}" for parameter in known.parameters),
    ]
    if window is not None:
        lines.append(f"window: {_window(window)}")
    return "\n".join([*lines, "", known.source.strip()])


def query(
    parsed: ContinuousQuery,
    ontology: Ontology,
    dictionary: TermDictionary,
    flows: Mapping[str, Flow],
) -> str:
    """A continuous query that names its streams: its text as understood, then its plans.

    ``flows`` is what is known of its streams, by the IRIs that it has for them.
    """
    names = list(dict.fromkeys(clause.iri for clause in parsed.streams))
    background = closed_ontology(ontology, parsed.static_named)
    evaluator = ContinuousEvaluator(parsed, dictionary, background, names)
    return f"{format_query(parsed)}\n\n{evaluator.explain(flows)}"


def inferred(
    parsed: ContinuousQuery,
    wanted: Needs,
    matches: Sequence[Match],
    ontology: Ontology,
    dictionary: TermDictionary,
) -> str:
    """A continuous query whose streams are found: its text, how, and its plans."""
    stages = _found(parsed, wanted, matches, ontology, dictionary)
    return "\n\n".join([f"registered\n{_indent(parsed.source.strip())}", *stages])


def running_query(
    source: str,
    read: Sequence[StreamAnnotation],
    matches: Sequence[Match],
    plan: str,
    evaluation: str,
    alone: str,
) -> str:
    """A continuous query at work: its text, the streams that it names with what they contain or
    how its streams were found, what runs, and how windows are evaluated: ``alone``, because …, or
    ("") together with other queries, as ``evaluation`` says."""
    parts = [f"registered\n{_indent(source)}"]
    if read:
        parts.append("streams\n" + "\n".join(_indent(each.source or each.stream) for each in read))
    if matches:
        parts.append("semantic matching\n" + "\n".join(_indent(render(m)) for m in matches))
    if alone:
        evaluation = f"by itself: {alone}\n\n{evaluation}"
    return "\n\n".join([*parts, f"units\n{_indent(plan)}", f"evaluation\n{_indent(evaluation)}"])


def request(
    known: Template,
    asked: EventRequest,
    bound: ContinuousQuery,
    wanted: Needs,
    matches: Sequence[Match],
    ontology: Ontology,
    dictionary: TermDictionary,
) -> str:
    """Request, template, needed features, matching, query, and the plans of its evaluation."""
    parts = [
        f"request\n  {asked.source.strip()}",
        f"template\n{_indent(known.source.strip())}",
    ]
    return "\n\n".join([*parts, *_found(bound, wanted, matches, ontology, dictionary)])


def _found(
    bound: ContinuousQuery,
    wanted: Needs,
    matches: Sequence[Match],
    ontology: Ontology,
    dictionary: TermDictionary,
) -> list[str]:
    """What a query needs, how that is found, and the plans of its evaluation if it is."""
    parts = [
        "features needed\n" + "\n".join(f"  {want}" for want in wanted.wants),
        "semantic matching\n" + "\n".join(_indent(render(match)) for match in matches),
    ]
    streams = [name for m in matches if m.supply is not None for name in streams_of(m.supply)]
    if all(match.supply is not None for match in matches):
        names = list(dict.fromkeys(streams))
        filled = with_streams(bound, names)
        evaluator = ContinuousEvaluator(filled, dictionary, closed_ontology(ontology), names)
        parts.append(f"query\n{_indent(format_query(filled))}")
        parts.append(f"evaluation\n{_indent(evaluator.explain())}")
    return parts


def plan_view(configuration: Configuration, unit: ComputationalUnit) -> PlanView:
    """How a query that runs is answered, by ``unit``: the tree, the streams and units behind it."""
    units = configuration.upstream_units(unit)
    made = {part.output.name for part in units}
    sources = [source.name for part in units for source in part.inputs]
    return PlanView(
        text=plan_text(configuration, unit),
        streams=tuple(dict.fromkeys(name for name in sources if name not in made)),
        units=tuple(unit_view(part) for part in units),
        query=unit.parameters["query"],
    )


def waits_for(configuration: Configuration, unit: ComputationalUnit) -> tuple[str, ...]:
    """Streams behind ``unit`` that are no unit's, have not begun and are not idle."""
    waiting = (s for part in configuration.upstream_units(unit) for s in part.waits_for)
    names = dict.fromkeys(source.name for source in waiting)
    return tuple(name for name in names if name not in configuration.units)


def held_back_by(configuration: Configuration, unit: ComputationalUnit) -> tuple[str, ...]:
    """Streams behind ``unit`` that are no unit's and are least far, of those that it waits for: its
    next window closes when they go on, end or fall idle."""
    sources = dict.fromkeys(s for part in configuration.upstream_units(unit) for s in part.inputs)
    going_on = [s for s in sources if not s.is_ended and not s.is_idle]
    waiting = [s for s in going_on if s.name not in configuration.units]
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


def _window(window: Window) -> str:
    match window:
        case TimeWindow():
            held, step = f"the last {format_duration(window.range)}", format_duration(window.step)
        case CountWindow():
            held = "the last triple" if window.size == 1 else f"the last {window.size} triples"
            step = "triple" if window.step == 1 else str(window.step)
        case LandmarkWindow():
            since = "it began" if window.start is None else format_time(window.start)
            held, step = f"all since {since}", format_duration(window.step)
        case _:
            assert_never(window)
    return f"{held}, every {step}"


def _indent(text: str) -> str:
    return "\n".join(f"  {line}" for line in text.splitlines())
