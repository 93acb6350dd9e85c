"""Continuous queries without a template ([Events14 §III]): register, read, results, remove."""

from __future__ import annotations

from typing import Annotated, Any

import anyio.to_thread
from fastapi import Path, Query, Request, Response
from fastapi.responses import JSONResponse, PlainTextResponse

from ...continuous.algebra.options import Bounds, Report, Semantics
from ...continuous.operators.results import WindowResult
from ...converters.objects import object_iri
from ...engine.durability.accepted_commands import QUERY, query_view
from ...engine.durability.commands import RegisterQuery, RemoveQuery
from ...engine.model.errors import Conflict
from ...rdf.namespaces import DYKNOW
from ...streams.time import format_time
from ..config.media_types import JSON, SPARQL_QUERY, TEXT
from ..http.encodings.json_lists import listed
from ..http.encodings.sparql_results import GRAPHS, RESULTS, many_windows, one_window
from ..http.negotiation import accepted, text_body
from ..http.problems import responses
from ..http.routers import resource_router
from ..http.text_limits import parse_aside, parse_continuous
from ..http.time_parameters import Time, time_of
from ..models import (
    BEGINNING,
    MatchesWhyModel,
    PartialMatchesModel,
    QueryModel,
    Since,
    Strategy,
    WhyModel,
    text_schema,
)
from ..runtime.context import Context
from ..sse.window_results import result_stream
from .follow import EVENTS, SINCE
from .reasoning import TABLE, Limit, Objects, ObjectsOfMatch, Start, partial_answer, why_answer

router = resource_router("queries")

TEXTS = (TEXT, SPARQL_QUERY)
EXAMPLE = """REGISTER STREAM fast COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT { ?o dyknow:speed ?mean }
FROM STREAM <http://www.ida.liu.se/dyknow/s5.trdf> [RANGE 5s STEP 1s]
WHERE { ?o a dyknow:UAV . ?o dyknow:speed ?v . }
AGGREGATE {(?mean, AVG, {?v}) FILTER (?mean > 100)}"""
BODY = {
    "requestBody": {
        "required": True,
        "content": {
            kind: text_schema("a REGISTER STREAM|QUERY text, a monitor or a pattern", EXAMPLE)
            for kind in TEXTS
        },
    }
}
TEXT_RESPONSE: dict[int | str, dict[str, Any]] = {
    200: {"content": {TEXT: {"schema": {"type": "string"}}}}
}
CONTENT: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "bindings or a boolean for SELECT and ASK, triples for CONSTRUCT",
        "content": {kind: {"schema": {}} for kind in (*RESULTS, *GRAPHS)},
    }
}
END_HEADER = "Dyknow-Window-End"
"""The header with the end of the window that a result is of."""
Name = Annotated[str, Path(description="the query's name")]


@router.post(
    "/queries",
    status_code=201,
    response_model=QueryModel,
    openapi_extra=BODY,
    responses={200: {"model": QueryModel}, **responses(403, 404, 409, 410, 413, 415, 422)},
)
async def register_query(
    request: Request,
    service: Context,
    semantics: Annotated[
        Semantics | None, Query(description="bag or set; default: bag, or set for RSP-QL")
    ] = None,
    bounds: Annotated[
        Bounds, Query(description="of a window with end e: (e - RANGE, e] or [e - RANGE, e)")
    ] = "(]",
    origin: Annotated[
        str, Query(description="windows end at origin + k STEP; ISO-8601 or integer ns")
    ] = "0",
    report: Annotated[
        Report, Query(description="which windows give a result: non-empty, changed, or all")
    ] = "non-empty",
    strategy: Annotated[
        Strategy, Query(description="how to choose streams if the text names none")
    ] = "fast",
    since: Annotated[Since, Query(description=BEGINNING)] = "now",
) -> Response:
    """Register a continuous query in C-SPARQL or RSP-QL, or a monitor: 201, or 200 if it exists.

    Its results, or verdicts, are a stream of its name. It reads the streams of FROM STREAM, or
    those that matching finds for its features. Equal texts share one query. 404: no such stream;
    409: the name is taken; 410: the streams no longer have all samples from ``since`` on; 422: a
    stream has no annotation, a graph is not loaded, or no stream gives a feature.
    """
    text = await text_body(request, TEXTS)
    await parse_aside(parse_continuous, text)
    engine = service.engine
    origin_time = time_of(origin, "origin") or 0
    view = await service.do(
        RegisterQuery(text, semantics, bounds, origin_time, report, strategy, since)
    )
    service.feeds.review()
    body = QueryModel.of(view, engine.epoch).model_dump(mode="json")
    location = {"Location": f"/queries/{view.name}"}
    return JSONResponse(body, 201 if view.users == 1 else 200, location)


@router.get("/queries", response_model=list[QueryModel])
async def list_queries(service: Context) -> Response:
    """List the registered queries, oldest first, then those that wait from earlier runs."""
    engine = service.engine
    queries = engine.queries
    deferred = service.commands.deferred_by_name(QUERY).values()
    waiting = [QueryModel.waiting(each, engine.epoch) for each in deferred]
    return await listed(
        queries.names(), lambda name: QueryModel.of(queries.view(name), engine.epoch), waiting
    )


@router.get(
    "/queries/{name}", response_model=QueryModel, responses=TEXT_RESPONSE | responses(404, 406)
)
async def read_query(
    name: Name,
    request: Request,
    service: Context,
    explain: Annotated[bool, Query(description="add each stage of the running query")] = False,
) -> Response:
    """Return one query; for ``Accept: text/plain`` its text, or with ``explain`` its stages."""
    kind = accepted(request, (JSON, TEXT))
    engine = service.engine
    waiting = service.commands.deferred_by_name(QUERY).get(name)
    view = engine.queries.view(name) if waiting is None else query_view(waiting)
    stages = engine.queries.explain_running(name) if explain else None
    if kind == TEXT:
        return PlainTextResponse(f"{stages or view.source}\n")
    return JSONResponse(QueryModel.of(view, engine.epoch, stages).model_dump(mode="json"))


@router.delete("/queries/{name}", status_code=204, responses=responses(404, 409))
async def remove_query(name: Name, service: Context) -> Response:
    """Remove one registration of a query, which stops with the last. 409: it is the last, and
    others read the query's stream."""
    await service.do(RemoveQuery(name))
    service.feeds.review()
    return Response(status_code=204)


@router.get(
    "/queries/{name}/results",
    response_class=Response,
    responses=CONTENT | responses(404, 406, 422),
)
async def read_results(
    name: Name,
    request: Request,
    service: Context,
    start: Annotated[Time, Query(alias="from")] = None,
    end: Annotated[Time, Query(alias="to")] = None,
    limit: Annotated[
        int | None, Query(ge=1, description="the newest windows; with `from` the oldest")
    ] = None,
) -> Response:
    """Return the result of the last closed window; 404 while there is none.

    With `from`, `to` or `limit`: the results of the kept windows that end in that range, as a table
    with the first column `window_end`, or as one graph; in N-Quads and TriG each window is a
    timestamped graph. SELECT: JSON, XML, CSV, TSV. ASK: JSON,
    XML, for one window. CONSTRUCT: Turtle, N-Triples, JSON-LD. Terms are the query's own.
    """
    queries, most = service.engine.queries, service.settings.sparql_bytes
    # A thread may serialize them: results never change.
    if start is None and end is None and limit is None:
        latest = queries.latest(name)
        response = await anyio.to_thread.run_sync(one_window, request, latest, most)
        response.headers[END_HEADER] = format_time(latest.end)
        return response
    view = queries.view(name)
    variables = tuple(field.name for field in view.fields)
    results = queries.results(name, time_of(start, "from"), time_of(end, "to"), limit)
    return await anyio.to_thread.run_sync(
        many_windows, request, results, view.form, variables, most, object_iri(name, DYKNOW)
    )


@router.get(
    "/queries/{name}/results/events", responses={**EVENTS, **responses(404, 406, 409, 410, 429)}
)
async def follow_results(
    name: Name,
    request: Request,
    service: Context,
    since: Annotated[str | None, Query(description=SINCE)] = None,
) -> Response:
    """Send the results of windows as server-sent events, from now on: `result` with `window_end`
    and SPARQL JSON (`head`, `results` or `boolean`), of a CONSTRUCT with N-Triples in `graph`.

    Ids and `since` are those of the query's stream, so `Last-Event-ID` resumes. A `gap` tells of a
    window that is no longer kept, or too large. 409: a monitor or a pattern, which have no windows.
    """
    queries = service.engine.queries
    view = queries.view(name)
    if not view.form:
        raise Conflict(f"{name!r} has no windows", f"follow its stream: GET /streams/{name}/events")

    def kept(end: int) -> WindowResult | None:
        if not queries.has(name):
            return None
        found = queries.results(name, end, end, None)
        return found[-1] if found else None

    key, most = service.client_key(request), service.settings.sparql_bytes
    response = result_stream(service.feeds, request, key, view.stream or name, since, kept, most)
    await service.commands.try_commit()
    return response


@router.get(
    "/queries/{name}/why",
    response_model=WhyModel | MatchesWhyModel,
    responses=TABLE | responses(404, 406, 410),
)
async def explain_result(
    name: Name,
    request: Request,
    service: Context,
    start: Start,
    object: Objects = None,
) -> Response:
    """Explain one verdict of a monitor, or the matches of a pattern. As JSON, or a table for
    ``Accept: text/plain``.

    A verdict: the states of its window, the values of the features there, and the value of each
    part of the formula. Matches: those that start at this time, or are valid then, each with the
    samples that are its events; objects may be left out.

    Both are made again of the samples that the streams retain. 404: no state is at this time, the
    object is not there, or there is no match; 410: the streams no longer have the samples.
    """
    why = service.engine.queries.why
    return await why_answer(request, service, why, name, name, object or [], start)


@router.get(
    "/queries/{name}/partial",
    response_model=PartialMatchesModel,
    responses=TABLE | responses(404, 406),
)
async def list_partial_matches(
    name: Name,
    request: Request,
    service: Context,
    object: ObjectsOfMatch = None,
    limit: Limit = 20,
) -> Response:
    """List the partial matches of a pattern, the newest first: which of its events have come, and
    between which times each of the others may still come. As JSON, or a table for
    ``Accept: text/plain``.

    Under skip_till_any_match these are all sets of events that can still become a match.
    """
    found = service.engine.queries.partial(name, object or [], limit)
    return partial_answer(request, name, found)
