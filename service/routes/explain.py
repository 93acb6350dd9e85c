"""Explanations: the stages of a query, template, request or match, as text."""

from __future__ import annotations

from fastapi import APIRouter, Query, Request
from fastapi.responses import JSONResponse, PlainTextResponse, Response

from ...engine.model.views import MatchView
from ..config.media_types import JSON, TEXT
from ..http.negotiation import accepted
from ..http.problems import Problem, responses
from ..http.text_limits import parse_aside, parse_continuous
from ..models import ExplainModel, Strategy
from ..runtime.context import Context

router = APIRouter(tags=["explain"])

LIMIT = 8192


@router.get(
    "/explain",
    response_model=ExplainModel,
    responses={
        200: {"content": {TEXT: {"schema": {"type": "string"}}}},
        **responses(404, 406, 422),
    },
)
async def explain(
    request: Request,
    service: Context,
    event: str | None = Query(
        None, max_length=LIMIT, description="a request: dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)"
    ),
    template: str | None = Query(None, max_length=LIMIT, description="a template's name"),
    query: str | None = Query(
        None, max_length=LIMIT, description="a REGISTER STREAM|QUERY or monitor text"
    ),
    id: str | None = Query(None, max_length=LIMIT, description="a running request or query"),
    feature: str | None = Query(None, max_length=LIMIT, description="a feature to match"),
    sort: str | None = Query(None, max_length=LIMIT, description="the sort that has the feature"),
    strategy: Strategy = "fast",
) -> Response:
    """Explain exactly one of `event`, `template`, `query`, `id` and `feature`."""
    kind = accepted(request, (TEXT, JSON))
    given = [name for name in (event, template, query, id, feature) if name is not None]
    if len(given) != 1:
        raise Problem(
            400,
            "wrong arguments",
            f"a request explains one thing, and this one names {len(given)}",
            hint="send exactly one of event, template, query, id, feature",
        )
    if id is not None:
        text = service.engine.explain_running(id) + "\n"
    elif feature is not None:
        text = _match(service.engine.match(feature, sort=sort, strategy=strategy))
    else:
        if query is not None:
            await parse_aside(parse_continuous, query)
        text = service.engine.explain(event=event, template=template, query=query)
    return JSONResponse({"text": text}) if kind == JSON else PlainTextResponse(text)


def _match(view: MatchView) -> str:
    lines = [f"{view.target} by strategy {view.strategy}: {'found' if view.found else 'not found'}"]
    if view.plan is not None:
        lines += ["", view.plan.text.rstrip()]
    lines += ["", "why:", *(f"- {reason}" for reason in view.reasons)]
    if view.alternatives:
        lines += ["", "also considered:", *(f"- {other}" for other in view.alternatives)]
    return "\n".join(lines) + "\n"
