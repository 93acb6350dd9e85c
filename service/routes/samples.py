"""Samples of a stream: publish a batch, read the history ([DyKnow10 Def. 5.5-5.8])."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Annotated, Any

import anyio.to_thread
from fastapi import APIRouter, Header, Query, Request, Response

from ...converters.arrow import ArrowMissing, decode_arrow, encode_arrow
from ...converters.csv_table import encode_csv
from ...converters.ndjson import decode_ndjson, encode_ndjson
from ...converters.wire import Incoming
from ...streams.fluent import FluentStream
from ...streams.generator import StreamGenerator
from ...streams.sample import SampleBatch
from ...streams.time import TIME_MAX
from ..context import Context
from ..models import AcceptedModel
from ..negotiation import ARROW, CSV, JSON, NDJSON, NTRIPLES, accepted, content_type
from ..problems import Problem, responses
from ..times import Time, time_of

router = APIRouter(tags=["samples"])

LINE = '{"valid": "2021-10-07T19:12:53Z", "id": "uav1", "speed": 31.5}\n'
BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            NDJSON: {
                "schema": {
                    "type": "string",
                    "description": "a line a sample: valid, available (optional), every field",
                },
                "example": LINE,
            },
            ARROW: {"schema": {"type": "string", "format": "binary"}},
        },
    }
}
FORMATS = (NDJSON, JSON, CSV, ARROW, NTRIPLES)
CONTENT: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "the samples, oldest first",
        "content": {kind: {"schema": {}} for kind in FORMATS},
    }
}


@router.post(
    "/streams/{name}/samples",
    status_code=202,
    openapi_extra=BODY,
    responses=responses(403, 404, 409, 413, 415, 429),
)
async def publish_samples(
    name: str,
    request: Request,
    service: Context,
    idempotency_key: Annotated[
        str | None, Header(max_length=200, description="repeating it has no second effect")
    ] = None,
) -> AcceptedModel:
    """Publish a batch: taken whole, or refused whole with the line and the cause.

    Samples without `available` are stamped on arrival. 409: the `Idempotency-Key` was used for
    another body.
    """
    service.engine.accepting(name)  # an unknown stream is told before the body is read
    kind = content_type(request, (NDJSON, ARROW))
    body = await request.body()
    # Asked again: the stream may have been declared anew while the body came.
    incoming = _decode(kind, body, service.engine.accepting(name))
    # Only what comes under a key is ever compared.
    digest = b"" if idempotency_key is None else hashlib.blake2b(body, digest_size=16).digest()
    count = service.engine.publish(
        name, incoming, service.clock(), idempotency_key=idempotency_key, digest=digest
    )
    return AcceptedModel(accepted=count)


@router.get(
    "/streams/{name}/samples",
    response_class=Response,
    responses=CONTENT | responses(404, 406, 422),
)
async def read_samples(
    name: str,
    request: Request,
    service: Context,
    start: Annotated[Time, Query(alias="from")] = None,
    end: Annotated[Time, Query(alias="to")] = None,
    limit: Annotated[
        int | None, Query(ge=1, description="the newest so many; with `from` the oldest")
    ] = None,
    at: Annotated[Time, Query(description="most_recent_at: the latest valid by then")] = None,
    known: Annotated[Time, Query(description="with `at`: of what was available by then")] = None,
) -> Response:
    """The kept samples with available time from `from` to `to`, both included.

    Or, with `at`, the one sample that says most about that valid time (Def. 5.6).
    """
    kind = accepted(request, FORMATS)
    stream = service.engine.generator(name).stream
    given = {"from": start, "to": end, "at": at, "known": known}
    times = {key: time_of(text, key) for key, text in given.items()}
    batch = _select(stream, times, limit or service.settings.history_limit)
    if kind == NTRIPLES:
        lines = [text for text in service.engine.rdf_of(name, batch) if text]
        return Response("".join(f"{text}\n" for text in lines), media_type=NTRIPLES)
    # Batches do not change, so that a long answer is written beside the event loop.
    body = await anyio.to_thread.run_sync(_encode, kind, batch)
    return Response(body, media_type=kind)


def _decode(kind: str, body: bytes, generator: StreamGenerator) -> Incoming:
    pools = generator.stream.pools
    if kind == NDJSON:
        return decode_ndjson(body, generator.schema, pools)
    try:
        return decode_arrow(body, generator.schema, pools)
    except ArrowMissing as error:
        raise _no_arrow() from error


def _encode(kind: str, batch: SampleBatch) -> bytes:
    if kind == NDJSON:
        return encode_ndjson(batch)
    if kind == CSV:
        return encode_csv(batch)
    if kind == ARROW:
        try:
            return encode_arrow(batch)
        except ArrowMissing as error:
            raise _no_arrow() from error
    # A JSON array is the lines with commas between.
    return b"[" + b",".join(encode_ndjson(batch).splitlines()) + b"]"


def _no_arrow() -> Problem:
    return Problem(
        501,
        "not available",
        "this service was installed without Arrow",
        hint="install dyknow[arrow], or use application/x-ndjson",
    )


def _select(stream: FluentStream, times: Mapping[str, int | None], limit: int) -> SampleBatch:
    start, at, known = times["from"], times["at"], times["known"]
    if at is not None:
        if start is not None or times["to"] is not None:
            raise Problem(400, "wrong arguments", "`at` stands alone, without `from` and `to`")
        return stream.most_recent_at(at, TIME_MAX if known is None else known)
    if known is not None:
        raise Problem(400, "wrong arguments", "`known` goes with `at`")
    if start is None and times["to"] is None:
        return stream.newest(limit)
    batch = stream.between(start, times["to"])
    if start is None:
        return batch.take(slice(max(0, len(batch) - limit), None))
    return batch.take(slice(0, limit))
