"""Answers about verdicts and matches: why they are, and what may still come. Registered queries and
requested events have the same."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any, TypeAlias

import anyio.to_thread
from fastapi import Query, Request, Response
from fastapi.responses import JSONResponse, PlainTextResponse

from ...reasoning.mtl.explanation import Explanation
from ...reasoning.patterns.recognition.explanation import ExplainedMatch, PartialMatches
from ..config.media_types import JSON, TEXT
from ..http.encodings.match_tables import matches_table, partial_table
from ..http.encodings.verdict_tables import why_table
from ..http.negotiation import accepted
from ..http.time_parameters import time_of
from ..models import MatchesWhyModel, PartialMatchesModel, WhyModel
from ..runtime.context import Service

Start = Annotated[str, Query(description="the valid time of the verdict or match, ISO-8601 or ns")]
Objects = Annotated[list[str] | None, Query(description="the object of each parameter, in order")]
ObjectsOfMatch = Annotated[
    list[str] | None, Query(description="an object of the match; may be repeated")
]
Limit = Annotated[int, Query(ge=1, le=1000, description="at most so many")]
TABLE: dict[int | str, dict[str, Any]] = {200: {"content": {TEXT: {"schema": {"type": "string"}}}}}
"""The answer as a table."""
Why: TypeAlias = Callable[
    [str, Sequence[str], int], Callable[[], Explanation | tuple[ExplainedMatch, ...]]
]


async def why_answer(
    request: Request,
    service: Service,
    why: Why,
    name: str,
    stream: str,
    objects: Sequence[str],
    start: str,
) -> Response:
    """Explain what a query or request called ``name`` gave in ``stream``. ``why`` returns the work
    of it."""
    kind = accepted(request, (JSON, TEXT))
    moment = time_of(start, "start")
    assert moment is not None
    found = await anyio.to_thread.run_sync(why(name, objects, moment))
    if isinstance(found, tuple):
        model: WhyModel | MatchesWhyModel = MatchesWhyModel.of(name, found)
        table = matches_table
    else:
        # The fields of a verdict begin with the objects.
        names = service.engine.generator(stream).schema.names
        model = WhyModel.of(name, dict(zip(names, objects, strict=False)), found)
        table = why_table
    if kind == TEXT:
        return PlainTextResponse(table(model.model_dump()))
    return JSONResponse(model.model_dump(mode="json"))


def partial_answer(request: Request, name: str, found: PartialMatches) -> Response:
    """List the partial matches of a query or request called ``name``."""
    kind = accepted(request, (JSON, TEXT))
    model = PartialMatchesModel.of(name, found)
    if kind == TEXT:
        return PlainTextResponse(partial_table(model.model_dump()))
    return JSONResponse(model.model_dump(mode="json"))
