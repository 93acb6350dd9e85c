"""What is wrong with the running system, or soon will be: the list behind `/problems`.

Each rule yields findings with the place and the remedy. The rules read counters only.
Cost: O(streams + units + requests), about 10 µs a stream.
"""

from __future__ import annotations

from collections.abc import Iterator

from ...engine.model.stream_statistics import rate_of
from ...engine.units.reasoning.pattern import PatternUnit
from ...engine.units.sharing.shared_pattern import SharedPatternUnit
from ...streams.generator import StreamGenerator
from ...streams.time import SECOND, format_duration
from ..models import FindingModel
from .context import Service

SILENT = 15 * SECOND
"""A stream is silent at least so long (ns) before a finding reports it."""
INTERVALS = 20
"""A stream is silent for as many of its usual intervals before a finding reports it."""
SHARE = 0.01
"""The share of late or duplicate samples from which a finding reports them."""
ENOUGH = 100
"""Samples that a stream has before a share of them means something."""
MEMORY = 0.9
"""The part of the memory limit from which memory is short."""


def findings(service: Service) -> list[FindingModel]:
    """Return all findings: those with missing results first."""
    found = [
        *_service(service),
        *_units(service),
        *_streams(service),
        *_requests(service),
        *_transformations(service),
    ]
    return sorted(found, key=lambda each: each.level)


def _service(service: Service) -> Iterator[FindingModel]:
    for reason in service.failing():  # a start is no problem: /status says it
        yield _of_service("bad", "The service is not ready", reason, "See its log.")
    memory = service.memory
    if memory.limit and MEMORY * memory.limit < memory.used < memory.limit:
        part = f"{100 * memory.used // memory.limit} % of the limit are used."
        hint = "Remove streams or requests, or give streams a smaller retention."
        yield _of_service("warn", "Memory is short", part, hint)
    for each in service.commands.deferred():
        what = f"{each.key.kind} {each.key.name} waits"
        hint = "Provide what is missing, or remove it."
        yield _of_service("warn", what, each.reason, hint)


def _of_service(level: str, what: str, detail: str, hint: str) -> FindingModel:
    return FindingModel.model_validate(
        {
            "level": level,
            "what": what,
            "detail": detail,
            "hint": hint,
            "kind": "service",
            "name": "",
            "stream": None,
        }
    )


def _units(service: Service) -> Iterator[FindingModel]:
    for failure in service.engine.failed():
        users = f". It answers {', '.join(failure.asked)}." if failure.asked else ""
        yield FindingModel(
            level="bad",
            what=f"Unit {failure.unit} has stopped",
            detail=failure.failure + users,
            hint="Remove what uses it, correct the cause, and start it again.",
            kind="unit",
            name=failure.unit,
            stream=failure.stream,
        )
    for unit in service.engine.units():
        losses = {}
        if isinstance(unit, PatternUnit | SharedPatternUnit):
            losses = unit.recognition.losses()
        if losses:
            lost = "; ".join(f"{count:,} {what}" for what, count in losses.items())
            yield FindingModel(
                level="warn",
                what=f"Pattern {unit.output.name} leaves matches out",
                detail=f"Left out: {lost}.",
                hint="Narrow its times or conditions, so that less has to be kept.",
                kind="unit",
                name=unit.name,
                stream=unit.output.name,
            )
    behind = {each.name for each in service.engine.backlog.units}
    for unit in service.engine.units() if behind else ():
        if unit.name not in behind:
            continue
        yield FindingModel(
            level="warn",
            what=f"Unit {unit.name} is behind",
            detail="Windows wait to be evaluated.",
            hint="Use a larger STEP, or ask for less.",
            kind="unit",
            name=unit.name,
            stream=unit.output.name,
        )


def _streams(service: Service) -> Iterator[FindingModel]:
    now = service.clock()
    for generator in service.engine.published():
        counters, name = generator.counters, generator.name
        quiet = _silence(generator, now)
        if quiet is not None:
            readers = generator.subscribers
            yield _of_stream(
                name,
                f"{name} is silent",
                f"No sample has arrived for {format_duration(quiet // SECOND * SECOND)}; "
                f"its readers ({readers}) wait.",
                "Check its publisher; end the stream if it is over.",
            )
        if counters.accepted < ENOUGH:
            continue
        if counters.late > SHARE * counters.accepted:
            yield _of_stream(
                name,
                f"{_percent(counters.late, counters.accepted)} of {name} arrive late",
                f"{counters.late:,} samples arrived after the stream's lateness of "
                f"{format_duration(generator.lateness)}.",
                "Declare a larger lateness.",
            )
        if counters.duplicate > SHARE * counters.accepted:
            yield _of_stream(
                name,
                f"{_percent(counters.duplicate, counters.accepted)} of {name} are duplicates",
                f"Its publisher sent {counters.duplicate:,} samples twice.",
                "Correct the publisher; an Idempotency-Key makes repeated batches harmless.",
            )


def _silence(generator: StreamGenerator, now: int) -> int | None:
    """How long (ns) a stream that others read has been silent; None while that is usual."""
    last = generator.stream.last_available
    if generator.is_ended or not generator.subscribers or last is None:
        return None
    usual = INTERVALS / rate if (rate := rate_of(generator)) else 0.0
    quiet = now - last
    return quiet if quiet > max(SILENT, usual * SECOND) else None


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.0f} %"


def _of_stream(name: str, what: str, detail: str, hint: str) -> FindingModel:
    return FindingModel(
        level="warn", what=what, detail=detail, hint=hint, kind="stream", name=name, stream=name
    )


def _requests(service: Service) -> Iterator[FindingModel]:
    engine = service.engine
    for query in engine.queries.views():
        if query.errors:
            yield FindingModel(
                level="warn",
                what=f"{query.name} has lost {query.errors} windows",
                detail=query.last_error or "",
                hint="Use a smaller window, or raise the limits of rows, time or memory.",
                kind="request",
                name=query.name,
                stream=query.stream,
            )
    for subscription in engine.subscriptions():
        adaptive = subscription.adaptive
        if adaptive is not None and adaptive.state != "running":
            yield FindingModel(
                level="warn",
                what=f"{adaptive.want}: {adaptive.state}",
                detail="; ".join(adaptive.missing) or adaptive.failure or "Its source is silent.",
                hint="Annotate a stream that has the feature, or add a transformation to it.",
                kind="request",
                name=subscription.id,
                stream=subscription.stream,
            )


def _transformations(service: Service) -> Iterator[FindingModel]:
    for view in service.engine.transformations.views():
        if view.lacks:
            yield FindingModel(
                level="warn",
                what=f"{view.name} cannot run",
                detail=view.lacks,
                hint="Provide its implementation, or remove the transformation.",
                kind="transformation",
                name=view.name,
                stream=None,
            )
