"""Answers about single verdicts and matches: why they are, and what may still come."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ...languages.mtl.checked import Kind
from ...reasoning.mtl.evaluator import TooManyStates
from ...reasoning.mtl.explanation import Explanation, NoStart
from ...reasoning.patterns.plans.plan import PlanError
from ...reasoning.patterns.recognition.explanation import ExplainedMatch, PartialMatches
from ...reasoning.states.state_maker import TooManyDue
from ...streams.time import format_time
from ..model.errors import BadArguments, NoResult, Refused
from ..units.base import ComputationalUnit
from ..units.reasoning.monitor import MonitorUnit, RecalledSamples
from ..units.reasoning.pattern import PatternUnit, RecalledEvents
from ..units.reasoning.sample_reasoner import SampleReasoner
from ..units.sharing.shared_monitor import MonitorInstance
from ..units.sharing.shared_pattern import PatternInstance
from ..units.sharing.shared_reasoner import ReasoningInstance


def why(
    name: str, unit: ComputationalUnit, objects: Sequence[str], start: int
) -> Callable[[], Explanation | tuple[ExplainedMatch, ...]]:
    """Return the work that explains one verdict of a monitor, or the matches of a pattern, for
    another thread: see `RecalledSamples.explain`, `RecalledEvents.explain`. ``name`` is that of the
    query, or the id of the request. Raises `BadArguments`; the work raises `NoResult`, `Refused`
    and `Forgotten`."""
    _check_is_evaluated(name, unit)
    stream = unit.output.name
    if isinstance(unit, PatternUnit | PatternInstance):
        names = [each.name for each in unit.query.results if each.kind is Kind.OBJECT]
        if len(objects) > len(names):
            raise BadArguments(
                f"{len(objects)} objects are given, and the matches of {name!r} have {len(names)}",
                f"give `object` for {', '.join(names)}" if names else "give none",
            )
        recalled_events, past = unit.recall(), _past_of(unit)
        return lambda: _matches(name, stream, recalled_events, objects, start, past)
    if not isinstance(unit, MonitorUnit | MonitorInstance):
        raise BadArguments(
            f"{name!r} is a query, and only verdicts of monitors and matches of patterns are "
            "explained",
            f"GET /explain?id={name} shows its stages",
        )
    names = [f"?{parameter}" for parameter, _ in unit.monitor.parameters]
    if len(names) != len(objects):
        raise BadArguments(
            f"{len(objects)} objects are given for a monitor of {len(names)} parameters",
            f"give `object` once for each of {', '.join(names)}" if names else "give none",
        )
    recalled, past = unit.recall(), _past_of(unit)
    return lambda: _verdict(name, stream, recalled, objects, start, past)


def partial(
    name: str, unit: ComputationalUnit, objects: Sequence[str], limit: int
) -> PartialMatches:
    """Return the partial matches of a pattern that have all these ``objects``, at most ``limit``.
    Raises `BadArguments`."""
    if not isinstance(unit, PatternUnit | PatternInstance):
        raise BadArguments(
            f"{name!r} is no pattern, and only patterns have partial matches",
            f"GET /explain?id={name} shows what it is",
        )
    _check_is_evaluated(name, unit)
    try:
        return unit.partial(objects, limit)
    except PlanError as error:
        raise BadArguments(error.message, error.hint) from error


def _check_is_evaluated(name: str, unit: ComputationalUnit) -> None:
    """Raise `BadArguments` for a request that shared an evaluation, and has left it."""
    if isinstance(unit, ReasoningInstance) and unit.number is None:
        if unit.failure is None:
            raise BadArguments(
                f"{name!r} is evaluated no more: its single start is decided",
                f"GET /streams/{unit.output.name}/samples has its verdict",
            )
        raise BadArguments(
            f"{name!r} is evaluated no more: {unit.failure}", "remove it, and request it again"
        )


def _past_of(unit: SampleReasoner | ReasoningInstance) -> str:
    """What to add where nothing is found, since it may have been before an end."""
    if not unit.went_on:
        return ""
    return "; its streams went on after their end, and only what came since is explained"


def _matches(
    name: str,
    stream: str,
    recalled: RecalledEvents,
    objects: Sequence[str],
    start: int,
    past: str,
) -> tuple[ExplainedMatch, ...]:
    found = recalled.explain(objects, start)
    if not found:
        raise NoResult(
            f"{name!r} has no match of these objects that starts at {format_time(start)}, or is "
            f"valid then{past}",
            f"GET /streams/{stream}/samples lists the matches",
        )
    return found


def _verdict(
    name: str,
    stream: str,
    recalled: RecalledSamples,
    objects: Sequence[str],
    start: int,
    past: str,
) -> Explanation:
    try:
        return recalled.explain(objects, start)
    except NoStart as error:
        around = " and ".join(map(format_time, error.near))
        raise NoResult(
            f"{name!r} has no verdict that starts at {format_time(start)}: {error}{past}",
            f"there are states at {around}"
            if around
            else f"GET /streams/{stream}/samples lists the verdicts that it reported",
        ) from error
    except (TooManyStates, TooManyDue) as error:
        raise Refused(
            f"the retained samples of the streams of {name!r} make more states than an "
            "explanation may evaluate",
            "keep fewer samples of these streams (`retention`)",
        ) from error
