"""Streams: declare, list, read, end."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Path, Request, Response

from ...engine.durability.commands import (
    DeclareStream,
    EndStream,
    RemoveStream,
    SetQuality,
)
from ...engine.model.errors import UnknownStream
from ...streams.history import Retention
from ...streams.sample import LONGEST_NAME
from ..config.media_types import JSON
from ..http.json_lists import listed
from ..http.negotiation import content_type
from ..http.problems import responses
from ..models import EvaluationModel, QualityIn, StreamIn, StreamModel
from ..runtime.context import Context, Service
from .json_body import JsonRoute

router = APIRouter(tags=["streams"], route_class=JsonRoute)

NewName = Annotated[
    str,
    Path(
        pattern="^[A-Za-z][A-Za-z0-9_]*$",
        max_length=LONGEST_NAME,
        description="letters, digits and _; the first is a letter",
    ),
]


async def json_only(request: Request) -> None:
    """Refuse a body that says it is something else than JSON (415)."""
    content_type(request, (JSON,))


@router.get("/streams", response_model=list[StreamModel])
async def list_streams(service: Context) -> Response:
    """All streams with rate, counters, lag, annotation, producer and subscribers."""
    engine = service.engine
    names = [generator.name for generator in engine.generators()]
    return await listed(names, lambda name: StreamModel.of(engine.stream(name)))


@router.get("/streams/{name}", responses=responses(404))
async def read_stream(name: str, service: Context) -> StreamModel:
    """One stream.

    `NAME_late` is the stream of the samples that came too late for stream NAME, `NAME_late_INPUT`
    that of the samples of INPUT that came too late for the unit or query that makes NAME. It comes
    into being when it is first asked for, here or wherever a stream is named, and takes what is
    late from then on.
    """
    return StreamModel.of(service.engine.stream(name))


@router.get("/streams/{name}/evaluation", responses=responses(404))
async def read_evaluation(name: str, service: Context) -> EvaluationModel:
    """How far the queries and other units are that read the stream, and which of them failed."""
    return EvaluationModel.of(service.engine.evaluation(name))


@router.put(
    "/streams/{name}",
    dependencies=[Depends(json_only)],
    responses={201: {"model": StreamModel}, **responses(403, 409, 413, 415, 422)},
)
async def declare_stream(
    name: NewName, declaration: StreamIn, response: Response, service: Context
) -> StreamModel:
    """Declare a stream. Saying the same again changes nothing; an annotation stays.

    At any time a stream may get further fields, and another `lateness`, `idle` and `retention`:
    what is not to be kept any more goes at once. Samples kept so far have no value in a new field,
    and units that run go on with the fields that they know. A field of another type or less, or
    another namespace, is taken while the stream has no samples and no subscribers, else 409.
    """
    known = _known(service, name)
    settings = service.settings
    kept = Retention(settings.retention_samples, None, settings.retention_bytes)
    view = await service.do(DeclareStream(declaration.declaration(name, kept)))
    if not known:
        response.status_code = 201
        response.headers["Location"] = f"/streams/{view.name}"
    return StreamModel.of(view)


@router.delete("/streams/{name}", status_code=204, responses=responses(403, 404, 409))
async def remove_stream(name: str, service: Context) -> Response:
    """Remove a declared stream with its samples and its annotation; its clients are told.

    Also a stream of late samples, which are only counted from then on. 403 for other streams of the
    system; 409 while units or requests read it.
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
async def set_quality(name: str, known: QualityIn, service: Context) -> Response:
    """How good the stream is from now on, 0 to 1: matching by quality looks at it, and adaptive
    subscriptions that want more than it has switch."""
    await service.do(SetQuality(name, known.quality))
    return Response(status_code=204)


@router.post("/streams/{name}/end", status_code=204, responses=responses(403, 404))
async def end_stream(name: str, service: Context) -> Response:
    """A recording has come to its end: what is held back is released, open windows close.

    A sample that comes later takes the stream up again.
    """
    await service.do(EndStream(name))
    return Response(status_code=204)


def _known(service: Service, name: str) -> bool:
    try:
        service.engine.stream(name)
    except UnknownStream:
        return False
    return True
