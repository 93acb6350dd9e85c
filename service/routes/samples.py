"""Queries over the history of a stream ([DyKnow10 Def. 5.5-5.8])."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import anyio.to_thread
from fastapi import Depends, Query, Request, Response

from ...converters.objects import object_iri
from ...engine.model.errors import UnknownStream
from ...rdf.namespaces import DYKNOW
from ...streams import past_queries
from ...streams.downsampling import downsampled, name_clash
from ...streams.history import FluentStream
from ...streams.instants import PlacesOf
from ...streams.sample import Mask, SampleBatch
from ...streams.time import DAY, NANOSECOND, TIME_MAX
from ..config.media_types import ARROW, CSV, JSON, JSON_LD, NDJSON, NQUADS, NTRIPLES, TRIG
from ..http.encodings.history_encoding import RdfWriter, history_answer
from ..http.field_lists import chosen_fields
from ..http.negotiation import accepted
from ..http.problems import Problem, responses
from ..http.routers import resource_router
from ..http.time_parameters import Time, duration_of, time_of
from ..runtime.context import Context, Service

router = resource_router("samples")

TABLES = (NDJSON, JSON, CSV, ARROW)
FORMATS = (*TABLES, NTRIPLES, NQUADS, TRIG, JSON_LD)
LONGEST_INTERVAL = 366 * DAY
MOST_DOWNSAMPLED = 10_000_000
"""Samples in the range of an answer by intervals: some seconds of another thread."""
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
    object: Annotated[
        str | None, Query(description="of a range: only the samples about this object")
    ] = None
    fields: Annotated[
        list[str] | None, Query(description="only these fields, not as RDF: `fields=id,spd`")
    ] = None
    every: Annotated[
        str | None,
        Query(
            description="of a range, not as RDF: one row for each object and interval of valid "
            "time, such as `10s`: the last sample, and `_min` and `_max` of each field of numbers"
        ),
    ] = None

    @property
    def wants_newest(self) -> bool:
        """Whether `limit` leaves the newest samples of a range, not the oldest."""
        return self.start is None and self.valid_from is None


@router.get(
    "/streams/{name}/samples",
    response_class=Response,
    responses=CONTENT | responses(404, 406, 409, 410, 422),
)
async def read_samples(
    name: str,
    request: Request,
    service: Context,
    parameters: Annotated[HistoryParameters, Depends()],
) -> Response:
    """Return the samples of the history with available time from `from` to `to` and valid time from
    `valid_from` to `valid_to`, inclusive. With `every` minimum, maximum and last value of each
    interval, for plots; `limit` then counts rows, and the oldest ones come with the rest of their
    last interval. With `object` only the samples about it; 409 if the objects are not known.

    A long response comes in pieces; the service encodes each after the client has read the previous
    one.

    Other queries (Def. 5.5-5.7): `at` returns the sample with the latest valid time up to then;
    `before` returns all samples with earlier valid times; `prev` and `last_avail` return the last
    sample before or at an available time. 410 with `oldest`, the oldest available time in the
    history: the result depends on evicted samples.
    """
    generator = service.engine.generator(name)
    stream, is_rdf = generator.stream, service.engine.time_property(generator) is not None
    intervals = _intervals(name, service, parameters)
    fields = chosen_fields(parameters.fields, stream.schema.names, repr(name))
    kind = accepted(request, FORMATS if intervals is None and fields is None else TABLES)
    limit = parameters.limit or service.settings.history_limit
    about = (
        None if parameters.object is None else service.engine.rows_about(name, parameters.object)
    )
    query = _history_query(parameters, limit if intervals is None and about is None else None)
    # No limit on long responses applies yet (service/http/response_limit), so few histories are
    # looked up at a time: many simultaneous requests then need no more memory than that limit.
    async with service.histories:
        batch = query(stream)
        if about is not None:
            # Safe in another thread: batches are immutable.
            batch = await anyio.to_thread.run_sync(_chosen, batch, about)
            if intervals is None:
                batch = past_queries.at_most(
                    batch,
                    limit,
                    newest=parameters.wants_newest,
                    whole_instant=parameters.valid_from is None and parameters.valid_to is None,
                )
        if intervals is not None:
            batch = await intervals.downsampled(batch, fields, limit)
        elif fields is not None:
            batch = batch.select(fields)
        rdf = RdfWriter(object_iri(name, DYKNOW), partial(_triples, service, name), is_rdf)
        return await history_answer(kind, batch, rdf)


@dataclass(frozen=True, slots=True)
class _Intervals:
    """The intervals of ``every`` ns of an answer about stream ``name``, whose fields ``keys`` name
    its objects. ``newest``: the newest rows are wanted."""

    name: str
    keys: tuple[str, ...]
    every: int
    newest: bool

    async def downsampled(
        self, batch: SampleBatch, fields: Sequence[str] | None, limit: int
    ) -> SampleBatch:
        """Return the rows of the samples in range. Raises a 400 `Problem` for a stream that has a
        field of the name of an extreme, and 422 for too many samples."""
        keys = [key for key in self.keys if key in batch.columns]
        if fields is not None:
            batch = batch.select(list(dict.fromkeys([*keys, *fields])))
        clash = name_clash(batch, keys)
        if clash is not None:
            raise Problem(
                400,
                "wrong arguments",
                f"every: {self.name!r} has a field {clash!r}, the name of an extreme of another",
                hint="choose the fields without one of the two, such as fields=spd",
            )
        if len(batch) > MOST_DOWNSAMPLED:
            raise Problem(
                422,
                "range too long",
                f"every: {len(batch):,} samples are in the range, at most {MOST_DOWNSAMPLED:,}",
                hint="narrow it with valid_from and valid_to, or from and to",
            )
        # Safe in another thread: batches are immutable.
        reduce = partial(downsampled, most=limit, newest=self.newest)
        return await anyio.to_thread.run_sync(reduce, batch, keys, self.every)


def _intervals(name: str, service: Service, parameters: HistoryParameters) -> _Intervals | None:
    every = duration_of(parameters.every, "every", NANOSECOND, LONGEST_INTERVAL)
    if every is None:
        return None
    keys = service.engine.object_fields(name)
    return _Intervals(name, keys, every, parameters.wants_newest)


def _chosen(batch: SampleBatch, rows: Callable[[SampleBatch], Mask]) -> SampleBatch:
    return batch.take(rows(batch))


def _triples(service: Service, name: str, batch: SampleBatch, places: PlacesOf) -> list[str]:
    try:
        return service.engine.rdf_of(name, batch, places)
    except UnknownStream:  # removed while the response was sent, and its annotation with it
        return []


def _history_query(
    parameters: HistoryParameters, limit: int | None
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
    is_range = parameters.every is not None or any(text is not None for text in ranges.values())
    if len(times) > 1 or (times and is_range):
        raise Problem(
            400,
            "wrong arguments",
            f"`{next(iter(times))}` excludes all other queries",
            hint="send one of at, before, prev, last_avail; or a range",
        )
    if times and parameters.object is not None:
        raise Problem(
            400,
            "wrong arguments",
            f"`object` is for a range, not for `{next(iter(times))}`",
            hint="send a range, such as valid_to, with limit=1 for the newest sample",
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
