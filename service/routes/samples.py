"""Queries over the history of a stream ([DyKnow10 Def. 5.5-5.8])."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request, Response

from ...converters.objects import object_iri
from ...engine.model.errors import UnknownStream
from ...rdf.namespaces import DYKNOW
from ...streams import past_queries
from ...streams.history import FluentStream
from ...streams.sample import SampleBatch
from ...streams.time import TIME_MAX
from ..config.media_types import ARROW, CSV, JSON, NDJSON, NQUADS, NTRIPLES, TRIG
from ..http.history_encoding import RdfWriter, history_answer
from ..http.negotiation import accepted
from ..http.problems import Problem, responses
from ..http.time_parameters import Time, time_of
from ..runtime.context import Context, Service

router = APIRouter(tags=["samples"])

FORMATS = (NDJSON, JSON, CSV, ARROW, NTRIPLES, NQUADS, TRIG)
CONTENT: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "the samples, oldest first",
        "content": {kind: {"schema": {}} for kind in FORMATS},
    }
}


@dataclass(frozen=True, slots=True)
class HistoryParameters:
    """The parameters of a query over a history: one kind of query, with its bounds."""

    start: Annotated[Time, Query(alias="from")] = None
    end: Annotated[Time, Query(alias="to")] = None
    valid_from: Time = None
    valid_to: Time = None
    limit: Annotated[
        int | None,
        Query(
            ge=1,
            description="the newest samples; with `from` or `valid_from` the oldest; with `from` "
            "also the rest of their last instant",
        ),
    ] = None
    at: Annotated[Time, Query(description="most_recent_at: the latest sample valid by then")] = None
    before: Annotated[Time, Query(description="before: all samples valid by then")] = None
    prev: Annotated[Time, Query(description="prev: the last sample available before then")] = None
    last_avail: Annotated[
        Time, Query(description="last_avail: the last sample available by then")
    ] = None
    known: Annotated[
        Time, Query(description="with `at` or `before`: only samples available by then")
    ] = None


@router.get(
    "/streams/{name}/samples",
    response_class=Response,
    responses=CONTENT | responses(404, 406, 410, 422),
)
async def read_samples(
    name: str,
    request: Request,
    service: Context,
    parameters: Annotated[HistoryParameters, Depends()],
) -> Response:
    """Return the samples of the history with available time from `from` to `to` and valid time from
    `valid_from` to `valid_to`, inclusive.

    A long response comes in pieces; the service encodes each after the client has read the previous
    one.

    Other queries (Def. 5.5-5.7): `at` returns the sample with the latest valid time up to then;
    `before` returns all samples with earlier valid times; `prev` and `last_avail` return the last
    sample before or at an available time. 410 with `oldest`, the oldest available time in the
    history: the result depends on evicted samples.
    """
    kind = accepted(request, FORMATS)
    stream = service.engine.generator(name).stream
    query = _history_query(parameters, parameters.limit or service.settings.history_limit)
    # No limit on long responses applies yet (service/http/response_limit), so few histories are
    # looked up at a time: many simultaneous requests then need no more memory than that limit.
    async with service.histories:
        batch = query(stream)
        is_rdf = service.engine.time_property(name) is not None
        rdf = RdfWriter(object_iri(name, DYKNOW), partial(_triples, service, name), is_rdf)
        return await history_answer(kind, batch, rdf)


def _triples(service: Service, name: str, batch: SampleBatch) -> list[str]:
    try:
        return service.engine.rdf_of(name, batch)
    except UnknownStream:  # removed while the response was sent, and its annotation with it
        return []


def _history_query(
    parameters: HistoryParameters, limit: int
) -> Callable[[FluentStream], SampleBatch]:
    """Return the query over the stream. Raises a 400 `Problem` for parameters that exclude each
    other."""
    ranges = {"from": parameters.start, "to": parameters.end}
    ranges |= {"valid_from": parameters.valid_from, "valid_to": parameters.valid_to}
    single = {"at": parameters.at, "before": parameters.before}
    single |= {"prev": parameters.prev, "last_avail": parameters.last_avail}
    bounds = {key: time_of(text, key) for key, text in ranges.items()}
    times = {key: time for key, text in single.items() if (time := time_of(text, key)) is not None}
    known = time_of(parameters.known, "known")
    if len(times) > 1 or (times and any(text is not None for text in ranges.values())):
        raise Problem(
            400,
            "wrong arguments",
            f"`{next(iter(times))}` excludes all other queries",
            hint="send one of at, before, prev, last_avail; or a range",
        )
    if known is not None and not times.keys() & {"at", "before"}:
        raise Problem(400, "wrong arguments", "`known` requires `at` or `before`")
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
