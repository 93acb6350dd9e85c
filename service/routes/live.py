"""Live samples: one request whose samples are published while its body arrives."""

from __future__ import annotations

from typing import Annotated

from fastapi import Header, Request, Response
from starlette.requests import ClientDisconnect

from ...converters.errors import AheadOfClock
from ..config.logs import log
from ..config.media_types import ARROW, NDJSON
from ..http.negotiation import content_type
from ..http.problems import Problem, problem_of, responses
from ..http.routers import resource_router
from ..models import AcceptedModel
from ..runtime.context import Context, Service
from ..runtime.live_ingest import LiveLines, LiveSamples, LiveTables
from .publish import SAMPLES_BODY

router = resource_router("samples")


@router.post(
    "/streams/{name}/samples/live",
    status_code=202,
    response_model=AcceptedModel,
    response_model_exclude_none=True,
    openapi_extra=SAMPLES_BODY,
    responses=responses(403, 404, 408, 409, 413, 415, 429, 503),
)
async def publish_live(
    name: str,
    request: Request,
    service: Context,
    idempotency_key: Annotated[
        str | None, Header(description="refused: a live body takes effect in parts")
    ] = None,
) -> AcceptedModel | Response:
    """Publish samples while they arrive, in one body of any length (`Transfer-Encoding: chunked`).

    The service publishes each line (each record batch of Arrow) as soon as it has arrived, and
    responds at the end. An error ends the body: the samples before `line` stay published, the
    others are not; `accepted` counts the former. 408: nothing arrived for too long; 503: the
    service stops.
    """
    service.engine.accepting(name)
    if idempotency_key is not None:
        raise Problem(
            400,
            "no key here",
            "a live body takes effect in parts, so a key cannot make its repetition safe",
            hint="leave Idempotency-Key out, or POST batches to /streams/{name}/samples",
        )
    live = _samples(name, content_type(request, (NDJSON, ARROW)), service)
    try:
        await service.bodies.publish(request, live, service.settings.live_timeout)
    except ClientDisconnect:
        log().info("live samples broken off", stream=name, accepted=live.accepted)
        return Response(status_code=400)  # the client has gone
    except Exception as error:
        if isinstance(error, AheadOfClock):
            service.engine.intake.count_ahead(name)
        # The response counts accepted samples, which must be durable then.
        await service.commands.try_commit()
        raise _refusal(error, live) from error
    await service.commands.wait_durable()
    return AcceptedModel.of(live.accepted, live.rounded)


def _samples(name: str, kind: str, service: Service) -> LiveSamples:
    live_class = LiveLines if kind == NDJSON else LiveTables
    limits = service.settings.live_batch_limits
    return live_class(service.engine, service.commands, name, service.clock, limits)


def _refusal(error: Exception, live: LiveSamples) -> Exception:
    """Return ``error`` as a problem with the number of accepted samples."""
    problem = problem_of(error)
    if problem.status_code == 500:
        return error
    problem.members["accepted"] = live.accepted
    # The rest of the body is not the next request.
    problem.headers = {**(problem.headers or {}), "Connection": "close"}
    return problem
