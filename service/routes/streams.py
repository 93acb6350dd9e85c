"""Streams: declare, list, read, end."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Path, Query, Request, Response

from ...engine.durability.commands import (
    DeclareStream,
    EndStream,
    RemoveStream,
    SetQuality,
)
from ...engine.model.errors import UnknownStream
from ...streams.history import Retention
from ...streams.sample import LONGEST_NAME
from ..config.media_types import JSON, POSITION
from ..http.encodings.json_lists import listed
from ..http.field_lists import chosen_fields
from ..http.negotiation import content_type
from ..http.problems import responses
from ..http.routers import resource_router
from ..models import EvaluationModel, QualityIn, StreamIn, StreamModel
from ..runtime.context import Context, Service
from .json_body import JsonRoute

router = resource_router("streams", route_class=JsonRoute)

NewName = Annotated[
    str,
    Path(
        pattern="^[A-Za-z][A-Za-z0-9_]*$",
        max_length=LONGEST_NAME,
        description="letters, digits and _; the first is a letter",
    ),
]


async def json_only(request: Request) -> None:
    """Refuse a body of another declared type than JSON (415)."""
    content_type(request, (JSON,))


@router.get("/streams", response_model=list[StreamModel])
async def list_streams(
    service: Context,
    fields: Annotated[
        list[str] | None, Query(description="only these members: `fields=name,rate`")
    ] = None,
    changed: Annotated[
        str | None,
        Query(
            max_length=200,
            description="only streams that have changed since the answer with this "
            "`Dyknow-Position`; `start`: all, with a position",
        ),
    ] = None,
) -> Response:
    """List all streams with rate, counters, lag, annotation, producer and subscribers.

    A page that polls begins with `changed=start`, and sends the header `Dyknow-Position` of each
    answer with the next request. `watermark` and `silent_for` alone are no change. A removed stream
    is in no answer; `/status/events` reports it.
    """
    engine, now = service.engine, service.clock()
    names = [generator.name for generator in engine.generators()]
    members = chosen_fields(fields, StreamModel.model_fields, "a stream")

    def told(name: str) -> StreamModel:
        return StreamModel.of(engine.stream(name), now)

    if changed is None:
        return await listed(names, told, members=members)
    versions = service.stream_versions
    async with versions.lock:
        versions.keep(names)
        after = versions.after(changed)

        def told_if_changed(name: str) -> StreamModel | None:
            model = told(name)
            return model if versions.note(model) > after else None

        answer = await listed(names, told_if_changed, members=members)
        answer.headers[POSITION] = versions.position
        return answer


@router.get("/streams/{name}", responses=responses(404))
async def read_stream(name: str, service: Context) -> StreamModel:
    """Return one stream.

    `NAME_late` has the samples that came too late for stream NAME. `NAME_late_INPUT` has those of
    INPUT that came too late for the unit or query that makes NAME. Such a stream begins when a
    request first names it, here or elsewhere.
    """
    return StreamModel.of(service.engine.stream(name), service.clock())


@router.get("/streams/{name}/evaluation", responses=responses(404))
async def read_evaluation(name: str, service: Context) -> EvaluationModel:
    """Return how far the readers of the stream have evaluated it, and which of them failed."""
    return EvaluationModel.of(service.engine.evaluation(name))


@router.put(
    "/streams/{name}",
    dependencies=[Depends(json_only)],
    responses={201: {"model": StreamModel}, **responses(403, 409, 413, 415, 422)},
)
async def declare_stream(
    name: NewName, declaration: StreamIn, response: Response, service: Context
) -> StreamModel:
    """Declare a stream. An equal declaration changes nothing; the annotation stays.

    A stream may get more fields, and another `lateness`, `idle` and `retention` at any time; a
    smaller history is evicted at once. Earlier samples have no value in a new field, and running
    units read the fields that they know. Other changes of fields or namespace are possible while
    the stream has no samples and no subscribers, else 409.
    """
    is_new = not _exists(service, name)
    made = declaration.declaration(name, default_retention(service))
    view = await service.do(DeclareStream(made))
    if is_new:
        response.status_code = 201
        response.headers["Location"] = f"/streams/{view.name}"
    return StreamModel.of(view, service.clock())


@router.delete("/streams/{name}", status_code=204, responses=responses(403, 404, 409))
async def remove_stream(name: str, service: Context) -> Response:
    """Remove a declared stream with its samples and annotation; its clients get `end`.

    It may also be a stream of late samples; the service only counts these afterwards. 403: another
    stream of the system; 409: units or requests read it.
    """
    await service.do(RemoveStream(name))
    service.feeds.review()
    return Response(status_code=204)


@router.put(
    "/streams/{name}/quality",
    status_code=204,
    dependencies=[Depends(json_only)],
    responses=responses(404, 413, 415, 422),
)
async def set_quality(name: str, quality: QualityIn, service: Context) -> Response:
    """Set the quality of the stream, 0 to 1. Matching by quality uses it at once; adaptive
    subscriptions that need more switch."""
    await service.do(SetQuality(name, quality.quality))
    return Response(status_code=204)


@router.post("/streams/{name}/end", status_code=204, responses=responses(403, 404))
async def end_stream(name: str, service: Context) -> Response:
    """End the stream, such as a recording: buffered samples are released, and open windows close.

    A later sample continues the stream.
    """
    await service.do(EndStream(name))
    return Response(status_code=204)


def default_retention(service: Service) -> Retention:
    """The retention of a stream whose declaration says nothing of it."""
    return Retention(service.settings.retention_samples, None, service.settings.retention_bytes)


def _exists(service: Service, name: str) -> bool:
    try:
        service.engine.stream(name)
    except UnknownStream:
        return False
    return True
