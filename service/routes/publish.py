"""Publishes batches of samples into a stream ([DyKnow10 Def. 4.4])."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Header, Request, Response
from msgspec.structs import replace

from ...converters.errors import AheadOfClock
from ...engine.durability.commands import Publish
from ..config.media_types import ARROW, JSON, NDJSON
from ..http.negotiation import content_type
from ..http.problems import Problem, responses
from ..models import AcceptedModel
from ..runtime.context import Context
from .fast_route import direct

KEY_LENGTH = 200
"""The longest Idempotency-Key."""
LINE = '{"valid": "2021-10-07T19:12:53Z", "id": "uav1", "speed": 31.5}\n'
BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            NDJSON: {
                "schema": {
                    "type": "string",
                    "description": "one sample per line: valid, available (optional), all fields",
                },
                "example": LINE,
            },
            ARROW: {"schema": {"type": "string", "format": "binary"}},
        },
    }
}


async def _publish_directly(request: Request) -> Response | None:
    key = request.headers.get("idempotency-key")
    if key is not None and len(key) > KEY_LENGTH:
        return None
    name, service = request.path_params["name"], request.app.state.service
    accepted = await publish_samples(name, request, service, key)
    if accepted.rounded is not None:
        return Response(accepted.model_dump_json(), 202, media_type=JSON)
    return Response(b'{"accepted":%d}' % accepted.accepted, 202, media_type=JSON)


router = APIRouter(tags=["samples"], route_class=direct(_publish_directly))


@router.post(
    "/streams/{name}/samples",
    status_code=202,
    response_model_exclude_none=True,
    openapi_extra=BODY,
    responses=responses(403, 404, 409, 413, 415, 429),
)
async def publish_samples(
    name: str,
    request: Request,
    service: Context,
    idempotency_key: Annotated[
        str | None, Header(max_length=KEY_LENGTH, description="a repetition has no second effect")
    ] = None,
) -> AcceptedModel:
    """Publish a batch, as a whole or not at all: an error names the line and the cause.

    Samples without `available` are stamped on arrival. 400 with `latest`: a sample is further ahead
    of the clock than the stream's `ahead`. `rounded` counts numbers that a float field cannot
    represent exactly, if there are any.

    429: queries that read the stream are behind, and the samples have an `available` of their own.
    409: the `Idempotency-Key` was used for another body.
    """
    service.engine.accepting(name)  # refuse an unknown stream before the body arrives
    if service.commands.is_overloaded(name):
        raise Problem(
            429,
            "queries are behind",
            f"queries that read stream {name!r} are behind; it takes no more samples now",
            hint="send the batch again after the seconds in Retry-After",
            headers={"Retry-After": "1"},
        )
    kind = content_type(request, (NDJSON, ARROW))
    body = await request.body()
    # `decode` checks the stream again: it may have been declared anew while the body arrived.
    batch = Publish(
        name, "ndjson" if kind == NDJSON else "arrow", body, service.clock(), idempotency_key
    )
    # First: decoding adds texts to the stream's dictionary, in vain if the log has no room.
    service.commands.check_room(len(body))
    incoming = await service.decoder.decode(batch)
    # Decoding may have waited for other batches, and times of commands must not decrease.
    batch = replace(batch, now=service.clock())
    try:
        batch.check_ahead(service.engine, incoming)
    except AheadOfClock:
        service.engine.intake.count_ahead(name)
        raise
    return AcceptedModel.of(await service.do(batch, incoming), incoming.rounded)
