"""Streams as server-sent events: one stream, or several on one connection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from fastapi import Depends, Query, Request, Response

from ...engine.requests.adaptive_subscription import Rematch
from ...streams.time import HOUR, MILLISECOND
from ..config.media_types import EVENT_STREAM
from ..http.field_lists import chosen_fields
from ..http.problems import Problem, responses
from ..http.routers import resource_router
from ..http.time_parameters import duration_of
from ..runtime.context import Context, Service
from ..sse.delivery import Delivery, Projection
from ..sse.feeds import event_stream
from ..sse.multi_stream import MOST_STREAMS, follow_many
from .fast_route import direct

EVENTS: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "server-sent events: sample, gap, end",
        "content": {EVENT_STREAM: {"schema": {"type": "string"}}},
    }
}

LEAST_EVERY, MOST_EVERY = MILLISECOND, HOUR
SINCE = (
    "`start` of the history, a time, a duration before the newest sample (`30s`), or the id of a "
    "sample"
)


@dataclass(frozen=True, slots=True)
class EventParameters:
    """Where the messages of samples begin, what they hold, and how often they come."""

    since: Annotated[str | None, Query(description=SINCE)] = None
    last: Annotated[
        int | None,
        Query(ge=1, description="begin with so many of the newest samples; excludes `since`"),
    ] = None
    rdf: Annotated[Literal["yes", "no"], Query(description="`no`: messages without `rdf`")] = "yes"
    fields: Annotated[
        list[str] | None, Query(description="only these fields in `values`: `fields=id,spd`")
    ] = None
    every: Annotated[
        str | None,
        Query(
            description="at most one message of each object in this time, such as `250ms`: its "
            "newest sample, with the `count` of those that it stands for"
        ),
    ] = None

    def delivery(self, service: Service, names: Sequence[str]) -> Delivery:
        """Return what the client asks of the streams ``names``. Raises a 400 `Problem`, and
        `UnknownStream` if it asks for fields."""
        if self.last is not None and self.since is not None:
            raise Problem(
                400,
                "wrong arguments",
                "`last` and `since` both say where the messages begin",
                hint="send one of them",
            )
        fields = None
        if self.fields is not None:
            schemas = [service.engine.generator(name).schema for name in names]
            known = dict.fromkeys(name for schema in schemas for name in schema.names)
            fields = chosen_fields(self.fields, known, " and ".join(map(repr, names)))
        every = duration_of(self.every, "every", LEAST_EVERY, MOST_EVERY)
        return Delivery(self.since, self.last, Projection(fields, self.rdf == "yes"), every)


Parameters = Annotated[EventParameters, Depends()]


async def _follow_directly(request: Request) -> Response | None:
    name = request.path_params.get("name")
    if name is None or request.query_params.keys() - {"since"}:
        return None
    delivery = Delivery(request.query_params.get("since"))
    return await follow(request.app.state.service, request, name, delivery)


router = resource_router("streams", route_class=direct(_follow_directly))


@router.get("/streams/{name}/events", responses={**EVENTS, **responses(404, 406, 410, 429, 503)})
async def follow_stream(
    name: str, request: Request, service: Context, parameters: Parameters
) -> Response:
    """Send the stream's samples as server-sent events, from now on.

    A client that resumes sends ``Last-Event-ID``; ``since`` and ``last`` begin elsewhere. Messages:
    `sample`, `gap` (samples that the stream no longer has), `end` (the stream has ended or was
    removed; the response ends with it).
    """
    return await follow(service, request, name, parameters.delivery(service, [name]))


async def follow(
    service: Service,
    request: Request,
    name: str,
    delivery: Delivery,
    switches: Sequence[Rematch] | None = None,
) -> Response:
    """Return the event stream of ``name``; ``switches`` as in `event_stream`."""
    key = service.client_key(request)
    response = event_stream(service.feeds, request, key, name, delivery, switches)
    # The response names its start, which must be durable: a client may resume from it after a
    # restart.
    await service.commands.try_commit()
    return response


@router.get("/follow", responses={**EVENTS, **responses(404, 406, 410, 422, 429, 503)})
async def follow_streams(
    request: Request,
    service: Context,
    stream: Annotated[
        list[str],
        Query(min_length=1, max_length=MOST_STREAMS, description="a stream's name; repeat it"),
    ],
    parameters: Parameters,
) -> Response:
    """Send the samples of several streams as server-sent events, on one connection.

    Messages are those of `/streams/{name}/events`; `data.stream` names the stream. An `id` is
    opaque: sent as `Last-Event-ID`, it resumes the streams that it is of; others begin now. `end`
    concerns one stream; the response ends with the last of them. ``last`` is of each stream;
    `fields` are those of any.
    """
    key = service.client_key(request)
    delivery = parameters.delivery(service, stream)
    response = follow_many(service.feeds, request, key, stream, delivery)
    await service.commands.try_commit()
    return response
