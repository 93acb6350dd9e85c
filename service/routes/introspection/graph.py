"""The graph of what runs, in one answer."""

from __future__ import annotations

from typing import Annotated

import anyio.to_thread
from fastapi import Header, Query, Response

from ....engine.model.graph import Graph
from ...config.media_types import JSON
from ...http.entity_tags import entity_tag, names
from ...http.problems import Problem, responses
from ...http.routers import resource_router
from ...models import GraphModel
from ...runtime.context import Context

router = resource_router("graph")


@router.get("/graph", response_model=GraphModel, responses=responses(404, 422))
async def read_graph(
    service: Context,
    around: Annotated[
        str | None, Query(description="the name or id of a stream, unit or request")
    ] = None,
    depth: Annotated[
        int | None, Query(ge=1, description="edges from there, at most; without it any number")
    ] = None,
    if_none_match: Annotated[str | None, Header()] = None,
) -> Response:
    """Return what runs as one graph: streams, units, event requests, queries and subscriptions.

    Edges lead from a stream to what reads it, and from a unit to the stream that it makes. With
    `around` only what feeds the nodes of that name, and what they feed. The graph has no counters,
    so its ETag changes only when something starts, stops or changes its state; then 304. 404:
    nothing that runs has the name.
    """
    if around is None and depth is not None:
        raise Problem(400, "wrong arguments", "`depth` requires `around`")
    # A thread may cut and encode it: a graph never changes.
    body = await anyio.to_thread.run_sync(_encoded, service.engine.graph(), around, depth)
    # A browser may keep it, and asks each time whether it is current.
    headers = {"ETag": entity_tag(body), "Cache-Control": "no-cache"}
    if names(if_none_match, headers["ETag"]):
        return Response(status_code=304, headers=headers)
    return Response(body, media_type=JSON, headers=headers)


def _encoded(graph: Graph, around: str | None, depth: int | None) -> bytes:
    if around is not None:
        graph = graph.around(around, depth)
    return GraphModel.of(graph).model_dump_json(by_alias=True).encode()
