"""The history of a stream: the samples that are kept ([DyKnow10 Def. 5.5-5.8])."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request, Response

from ...engine.model.errors import UnknownStream
from ...streams import past_queries
from ...streams.history import FluentStream
from ...streams.sample import SampleBatch
from ...streams.time import TIME_MAX
from ..config.media_types import ARROW, CSV, JSON, NDJSON, NTRIPLES
from ..http.history_encoding import history_answer
from ..http.negotiation import accepted
from ..http.problems import Problem, responses
from ..http.time_parameters import Time, time_of
from ..runtime.context import Context, Service

router = APIRouter(tags=["samples"])

FORMATS = (NDJSON, JSON, CSV, ARROW, NTRIPLES)
CONTENT: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "the samples, oldest first",
        "content": {kind: {"schema": {}} for kind in FORMATS},
    }
}


@dataclass(frozen=True, slots=True)
class Asked:
    """What is asked of a history: one kind of question, with its bounds."""

    start: Annotated[Time, Query(alias="from")] = None
    end: Annotated[Time, Query(alias="to")] = None
    valid_from: Time = None
    valid_to: Time = None
    limit: Annotated[
        int | None,
        Query(
            ge=1,
            description="the newest so many; with `from` or `valid_from` the oldest; with `from` "
            "also the rest of their last instant",
        ),
    ] = None
    at: Annotated[Time, Query(description="most_recent_at: the latest valid by then")] = None
    before: Annotated[Time, Query(description="before: all that are valid by then")] = None
    prev: Annotated[Time, Query(description="prev: the last one available before then")] = None
    last_avail: Annotated[Time, Query(description="last_avail: the last available by then")] = None
    known: Annotated[
        Time, Query(description="with `at` or `before`: of what was available by then")
    ] = None


@router.get(
    "/streams/{name}/samples",
    response_class=Response,
    responses=CONTENT | responses(404, 406, 410, 422),
)
async def read_samples(
    name: str, request: Request, service: Context, asked: Annotated[Asked, Depends()]
) -> Response:
    """The kept samples with available time from `from` to `to` and valid time from `valid_from` to
    `valid_to`, all included.

    A long answer comes in pieces, each encoded when the one before it is taken.

    Or, with `at`, the one sample that says most about that valid time; with `before` all samples
    about earlier valid times; with `prev` and `last_avail` the one before or at an available time
    (Def. 5.5-5.7). 410 with `oldest`, the oldest available time kept, where the answer depends on
    samples that the stream has forgotten.
    """
    kind = accepted(request, FORMATS)
    stream = service.engine.generator(name).stream
    question = _question(asked, asked.limit or service.settings.history_limit)
    # Nobody has a place for it yet (service/http/response_limit): few at a time, so that many who
    # ask at once take no more than there are places for.
    async with service.histories:
        batch = question(stream)
        return await history_answer(kind, batch, partial(_triples, service, name))


def _triples(service: Service, name: str, batch: SampleBatch) -> list[str]:
    try:
        return service.engine.rdf_of(name, batch)
    except UnknownStream:  # removed while its samples were sent: what they meant is gone with it
        return []


def _question(asked: Asked, limit: int) -> Callable[[FluentStream], SampleBatch]:
    """What to ask of the stream; raises a 400 `Problem` for questions that exclude each other."""
    ranges = {"from": asked.start, "to": asked.end}
    ranges |= {"valid_from": asked.valid_from, "valid_to": asked.valid_to}
    single = {"at": asked.at, "before": asked.before}
    single |= {"prev": asked.prev, "last_avail": asked.last_avail}
    bounds = {key: time_of(text, key) for key, text in ranges.items()}
    times = {key: time for key, text in single.items() if (time := time_of(text, key)) is not None}
    known = time_of(asked.known, "known")
    if len(times) > 1 or (times and any(text is not None for text in ranges.values())):
        raise Problem(
            400,
            "wrong arguments",
            f"`{next(iter(times))}` stands alone, without another question",
            hint="ask one of at, before, prev, last_avail; or for a range",
        )
    if known is not None and not times.keys() & {"at", "before"}:
        raise Problem(400, "wrong arguments", "`known` goes with `at` or `before`")
    by = TIME_MAX if known is None else known
    if times:
        kinds: dict[str, Callable[[FluentStream, int], SampleBatch]] = {
            "at": partial(past_queries.most_recent_at, known=by),
            "before": partial(past_queries.before, known=by, most=limit),
            "prev": past_queries.prev,
            "last_avail": past_queries.last_avail,
        }
        key, time = next(iter(times.items()))
        return lambda stream: kinds[key](stream, time)
    start, end, valid_from, valid_to = bounds.values()
    return lambda stream: past_queries.between(stream, start, end, valid_from, valid_to, most=limit)
