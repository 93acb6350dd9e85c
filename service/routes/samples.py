"""The history of a stream: the samples that are kept ([DyKnow10 Def. 5.5-5.8])."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response

from ...engine.errors import UnknownStream
from ...streams.fluent import FluentStream
from ...streams.sample import SampleBatch
from ...streams.time import TIME_MAX
from ..context import Context, Service
from ..history import history_answer
from ..negotiation import ARROW, CSV, JSON, NDJSON, NTRIPLES, accepted
from ..problems import Problem, responses
from ..times import Time, time_of

router = APIRouter(tags=["samples"])

FORMATS = (NDJSON, JSON, CSV, ARROW, NTRIPLES)
CONTENT: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "the samples, oldest first",
        "content": {kind: {"schema": {}} for kind in FORMATS},
    }
}


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

    A long answer comes in pieces, each encoded when the one before it is taken.

    Or, with `at`, the one sample that says most about that valid time (Def. 5.6).
    """
    kind = accepted(request, FORMATS)
    stream = service.engine.generator(name).stream
    given = {"from": start, "to": end, "at": at, "known": known}
    times = {key: time_of(text, key) for key, text in given.items()}
    most = limit or service.settings.history_limit
    # Nobody has a place for it yet (service/answers): few at a time, so that many who ask at once
    # take no more than there are places for.
    async with service.histories:
        batch = _select(stream, times, most)
        return await history_answer(kind, batch, partial(_triples, service, name))


def _triples(service: Service, name: str, batch: SampleBatch) -> list[str]:
    try:
        return service.engine.rdf_of(name, batch)
    except UnknownStream:  # removed while its samples were sent: what they meant is gone with it
        return []


def _select(stream: FluentStream, times: Mapping[str, int | None], limit: int) -> SampleBatch:
    start, at, known = times["from"], times["at"], times["known"]
    if at is not None:
        if start is not None or times["to"] is not None:
            raise Problem(400, "wrong arguments", "`at` stands alone, without `from` and `to`")
        return stream.most_recent_at(at, TIME_MAX if known is None else known)
    if known is not None:
        raise Problem(400, "wrong arguments", "`known` goes with `at`")
    return stream.between(start, times["to"], most=limit, newest=start is None)
