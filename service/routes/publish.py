"""Publishes batches of samples into a stream ([DyKnow10 Def. 4.4])."""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal

from fastapi import Header, Query, Request, Response
from msgspec.structs import replace

from ...converters.errors import AheadOfClock
from ...engine.durability.commands import BatchKind, DeclareStream, Publish
from ..admission.gate import client_key
from ..config.media_types import ARROW, JSON, JSON_LD, NDJSON, NQUADS, NTRIPLES, TRIG, TURTLE
from ..http.negotiation import content_type
from ..http.problems import Problem, responses
from ..http.routers import resource_router
from ..models import AcceptedModel, StreamIn
from ..runtime.context import Context, Service
from ..workers.route_calls import while_connected
from .fast_route import direct
from .streams import default_retention

RDF_KINDS: Final[dict[str, BatchKind]] = {
    NTRIPLES: "ntriples",
    NQUADS: "nquads",
    TURTLE: "turtle",
    TRIG: "trig",
    JSON_LD: "nquads",
}
"""The media types of RDF. JSON-LD becomes N-Quads in a worker."""
KINDS: Final[dict[str, BatchKind]] = {NDJSON: "ndjson", ARROW: "arrow", **RDF_KINDS}
MEDIA_TYPES: Final = tuple(KINDS)
KEY_LENGTH = 200
"""The longest Idempotency-Key."""
LINE = '{"valid": "2021-10-07T19:12:53Z", "id": "uav1", "speed": 31.5}\n'
_CONTENT: Final[dict[str, Any]] = {
    NDJSON: {
        "schema": {
            "type": "string",
            "description": "one sample per line: valid, available (optional), all fields",
        },
        "example": LINE,
    },
    ARROW: {"schema": {"type": "string", "format": "binary"}},
}
_RDF_CONTENT: Final = {
    kind: {"schema": {"type": "string", "description": "RDF"}} for kind in RDF_KINDS
}
SAMPLES_BODY: Final[dict[str, Any]] = {"requestBody": {"required": True, "content": _CONTENT}}
"""Samples, and no RDF."""
BODY: Final[dict[str, Any]] = {
    "requestBody": {"required": True, "content": _CONTENT | _RDF_CONTENT}
}


async def _publish_directly(request: Request) -> Response | None:
    key = request.headers.get("idempotency-key")
    if (key is not None and len(key) > KEY_LENGTH) or request.scope["query_string"]:
        return None
    name, service = request.path_params["name"], request.app.state.service
    accepted = await publish_samples(name, request, service, key)
    if accepted.rounded is not None:
        return Response(accepted.model_dump_json(), 202, media_type=JSON)
    return Response(b'{"accepted":%d}' % accepted.accepted, 202, media_type=JSON)


router = resource_router("samples", route_class=direct(_publish_directly))


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
    create: Annotated[
        Literal["rdf"] | None, Query(description="make the stream, of this kind, if it is missing")
    ] = None,
) -> AcceptedModel:
    """Publish a batch, as a whole or not at all: an error names the line and the cause.

    Samples without `available` are stamped on arrival. 400 with `latest`: a sample is further ahead
    of the clock than the stream's `ahead`. `rounded` counts numbers that a float field cannot
    represent exactly, if there are any.

    A stream of RDF takes texts of RDF: statements of a timestamped graph (N-Quads, TriG, JSON-LD)
    have its time; others the time that the stream's time property gives, or that of their arrival.

    429: queries that read the stream are behind, and the samples have an `available` of their own.
    409: the `Idempotency-Key` was used for another body, or RDF was sent to a stream of samples.
    """
    if create is not None and not service.engine.has_stream(name):
        await _create(name, request, service)
    # Refuse an unknown stream before the body arrives.
    if service.commands.is_overloaded(service.engine.accepting(name)):
        raise Problem(
            429,
            "queries are behind",
            f"queries that read stream {name!r} are behind; it takes no more samples now",
            hint="send the batch again after the seconds in Retry-After",
            headers={"Retry-After": "1"},
        )
    media_type = content_type(request, MEDIA_TYPES)
    kind, body = KINDS[media_type], await request.body()
    if media_type == JSON_LD:
        texts, sender = service.isolation.json_ld, client_key(request)
        body = await while_connected(request, lambda: texts.nquads(body, sender))
    # `decode` checks the stream again: it may have been declared anew while the body arrived.
    batch = Publish(name, kind, body, service.clock(), idempotency_key)
    # First: decoding adds texts to the stream's dictionary, in vain if the log has no room.
    service.commands.check_room(len(body))
    incoming = await service.decoder.decode(batch)
    # Decoding may have waited for other batches, and times of commands must not decrease.
    batch = replace(batch, now=service.clock())
    try:
        batch.check(service.engine, incoming)
    except AheadOfClock:
        service.engine.intake.count_ahead(name)
        raise
    return AcceptedModel.of(await service.do(batch, incoming), incoming.rounded)


async def _create(name: str, request: Request, service: Service) -> None:
    """Declare a stream of RDF, for a caller that may."""
    service.gate.check_also(request.scope, "PUT", f"/streams/{name}")
    made = StreamIn.model_validate({"kind": "rdf"})
    await service.do(DeclareStream(made.declaration(name, default_retention(service))))
