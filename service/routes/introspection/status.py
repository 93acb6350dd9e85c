"""An overview of the service, and the status stream ([Introspection15 §3.3])."""

from __future__ import annotations

import logging
import time
from typing import Literal

from fastapi import Query, Request, Response

from ....engine.durability.accepted_commands import QUERY, REQUEST, SUBSCRIPTION
from ....streams.time import format_time
from ...admission.memory_limit import CAN, resident
from ...config.recent_log import KEPT
from ...config.version import __version__
from ...http.problems import responses
from ...http.routers import resource_router
from ...models import (
    FindingModel,
    LoadModel,
    LogLineModel,
    SettingModel,
    StatusModel,
    WaitingModel,
)
from ...runtime.context import Context, Service
from ...runtime.findings import findings
from ..follow import EVENTS, Parameters, follow

router = resource_router("status")

LISTED = (REQUEST, SUBSCRIPTION, QUERY)
"""The kinds of deferred commands that other routes list with the running ones."""


@router.get("/status")
async def read_status(service: Context) -> StatusModel:
    """Return an overview of the service."""
    engine = service.engine
    streams = engine.streams()
    return StatusModel(
        version=__version__,
        epoch=engine.epoch,
        started=format_time(service.started),
        now=format_time(service.clock()),
        streams=len(streams),
        templates=len(engine.templates()),
        requests=len(engine.event_ids()),
        queries=len(engine.queries),
        clients=service.feeds.clients,
        accepted=sum(stream.counters.accepted for stream in streams),
        load=_load(service),
        starting=service.starting(),
        waiting=[
            WaitingModel(kind=each.key.kind, name=each.key.name, reason=each.reason)
            for each in service.commands.deferred()
            if each.key.kind not in LISTED
        ],
    )


def _load(service: Service) -> LoadModel:
    commands, limit = service.commands, service.memory.limit
    return LoadModel(
        memory=service.memory.used if limit else resident() if CAN else 0,
        memory_limit=limit or None,
        processor=time.process_time(),
        loop_lag=service.loop_lag,
        units_behind=len(service.engine.backlog.units),
        log_waiting=commands.uncommitted[0] if commands.is_recording else None,
    )


@router.get("/problems")
async def list_problems(service: Context) -> list[FindingModel]:
    """List what is wrong, or soon will be: those with missing results first.

    Failed and slow units, silent streams that others read, late and duplicate samples, queries
    without results, requests that wait, short memory. Each has the place and the remedy.
    """
    return findings(service)


@router.get("/log")
async def read_log(
    service: Context,
    level: Literal["debug", "info", "warning", "error"] = "warning",
    limit: int = Query(200, ge=1, le=KEPT, description="lines at most"),
) -> list[LogLineModel]:
    """Return the newest lines of the service's log of at least `level`, newest first.

    The service keeps a thousand lines, of the levels that it logs (the setting `log_level`).
    """
    number = logging.getLevelNamesMapping()[level.upper()]
    return [
        LogLineModel(
            time=line.time.isoformat(), level=line.level, event=line.event, values=line.values
        )
        for line in service.recent_log.lines(number, limit)
    ]


@router.get("/settings")
async def list_settings(service: Context) -> list[SettingModel]:
    """List the settings of the service, those that differ from their defaults first."""
    found = []
    for name, about in type(service.settings).model_fields.items():
        value = getattr(service.settings, name)
        default = about.get_default(call_default_factory=True)
        found.append(SettingModel(name=name, value=str(value), is_default=value == default))
    return sorted(found, key=lambda each: each.is_default)


@router.get("/status/events", responses={**EVENTS, **responses(406, 410, 429, 503)})
async def follow_status(
    request: Request,
    service: Context,
    parameters: Parameters,
) -> Response:
    """Send every change of the stream space as server-sent events: the stream `status`."""
    return await follow(service, request, "status", parameters.delivery(service, ["status"]))
