"""Explanations: the stages of a query, template, request or match, as text or as a tree."""

from __future__ import annotations

import textwrap
from typing import Any

from fastapi import Depends, Query, Request
from fastapi.responses import PlainTextResponse, Response
from pydantic import Field, model_validator

from ....engine.model.errors import NoPlan
from ....engine.model.views import MatchView
from ....engine.planning.stream_binding import REMEDY
from ...config.media_types import JSON, TEXT
from ...http.negotiation import accepted
from ...http.problems import Problem, responses
from ...http.routers import resource_router
from ...http.text_limits import parse_aside, parse_continuous
from ...models import ExplainModel, StageModel, StepModel, Strategy, TrialModel
from ...models.parts import Body
from ...runtime.context import Context, Service
from ..json_body import JsonRoute
from ..streams import json_only

router = resource_router("explain", route_class=JsonRoute)

LIMIT = 8192
SINCE = (
    "try a request or a query on what is kept: from the `start`, a time, or a duration before the "
    "newest sample (`10m`)"
)
LONGEST = 1 << 18
"""Characters of a text that POST explains."""
KINDS = ("event", "template", "query", "id", "feature")
ANSWER: dict[int | str, dict[str, Any]] = {
    200: {"content": {TEXT: {"schema": {"type": "string"}}}},
    **responses(404, 406, 422, 503),
}


class ExplainIn(Body):
    """What to explain: exactly one of `event`, `template`, `query`, `id` and `feature`."""

    event: str | None = Field(
        None,
        max_length=LONGEST,
        description="a request",
        examples=["dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)"],
    )
    template: str | None = Field(None, max_length=LONGEST, description="a template's name")
    query: str | None = Field(
        None, max_length=LONGEST, description="a REGISTER STREAM|QUERY or monitor text"
    )
    id: str | None = Field(None, max_length=LONGEST, description="a running request or query")
    feature: str | None = Field(None, max_length=LONGEST, description="a feature to match")
    sort: str | None = Field(None, max_length=LONGEST, description="the sort that has the feature")
    strategy: Strategy = "fast"
    since: str | None = Field(None, max_length=100, description=SINCE)

    @model_validator(mode="after")
    def _exactly_one(self) -> ExplainIn:
        given = [name for name in KINDS if getattr(self, name) is not None]
        if len(given) != 1:
            raise Problem(
                400,
                "wrong arguments",
                f"a request explains one thing, and this one names {len(given)}",
                hint=f"send exactly one of {', '.join(KINDS)}",
            )
        if self.since is not None and self.event is None and self.query is None:
            raise Problem(
                400,
                "wrong arguments",
                f"`since` tries a request or a query, and no {given[0]}",
                hint="send it with event or query",
            )
        return self


@router.get("/explain", response_model=ExplainModel, responses=ANSWER)
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
    since: str | None = Query(None, max_length=100, description=SINCE),
) -> Response:
    """Explain exactly one of `event`, `template`, `query`, `id` and `feature`.

    As JSON `plan` is a tree of what was considered. With `since` a request or a query is tried on
    the samples that are kept, for some five seconds: `tried` says how often it would have fired.
    User-written processes and running queries are left out there, with what they make.

    422: as JSON, where there is no plan; the
    problem has `missing`, and the members of the explanation.
    """
    wanted = ExplainIn(
        event=event,
        template=template,
        query=query,
        id=id,
        feature=feature,
        sort=sort,
        strategy=strategy,
        since=since,
    )
    return await _answer(request, service, wanted)


@router.post(
    "/explain",
    response_model=ExplainModel,
    dependencies=[Depends(json_only)],
    responses={**ANSWER, **responses(404, 406, 413, 415, 422, 503)},
)
async def explain_long(request: Request, service: Context, wanted: ExplainIn) -> Response:
    """Explain as `GET /explain` does, for texts that are longer than an address may be."""
    return await _answer(request, service, wanted)


async def _answer(request: Request, service: Service, wanted: ExplainIn) -> Response:
    kind = accepted(request, (TEXT, JSON))
    model = await _explained(service, wanted)
    if wanted.since is not None and model.found:
        model = await _tried(service, wanted, wanted.since, model)
    if kind == TEXT:
        # For reading: the text itself says what is missing.
        return PlainTextResponse(model.text)
    if not model.found:
        detail = "no stream and no transformation answers this"
        raise Problem(422, NoPlan.title, detail, hint=REMEDY, **dict(model))
    return Response(model.model_dump_json(), media_type=JSON)


async def _explained(service: Service, wanted: ExplainIn) -> ExplainModel:
    engine = service.engine
    if wanted.feature is not None:
        view = engine.match(wanted.feature, sort=wanted.sort, strategy=wanted.strategy)
        text = _match(view)
        return ExplainModel(
            text=text,
            found=view.found,
            missing=[] if view.found else [f"{view.target}: {each}" for each in view.reasons],
            stages=[StageModel(title="semantic matching", text=text)],
            plan=[StepModel.of(view.tree)],
        )
    if wanted.id is not None:
        model = ExplainModel.of(engine.running_explanation(wanted.id), engine.cost_of_node)
        return model.model_copy(update={"text": model.text + "\n"})
    if wanted.query is not None:
        await parse_aside(parse_continuous, wanted.query)
    return ExplainModel.of(
        engine.explanation(
            event=wanted.event,
            template=wanted.template,
            query=wanted.query,
            strategy=wanted.strategy,
        ),
        engine.cost_of_node,
    )


async def _tried(
    service: Service, wanted: ExplainIn, since: str, model: ExplainModel
) -> ExplainModel:
    """Add what a request or a query would have given on what is kept."""
    engine = service.engine
    asked = wanted.query if wanted.event is None else engine.parse_request(wanted.event)
    assert asked is not None
    found = await service.trials.run(engine, asked, since, wanted.strategy)
    trial = TrialModel.of(found)
    stage = StageModel(title="on what is kept", text=str(trial))
    text = f"{model.text.rstrip()}\n\n{stage.title}\n{textwrap.indent(stage.text, '  ')}\n"
    stages = [*model.stages, stage]
    return model.model_copy(update={"text": text, "stages": stages, "tried": trial})


def _match(view: MatchView) -> str:
    lines = [f"{view.target} by strategy {view.strategy}: {'found' if view.found else 'not found'}"]
    if view.plan is not None:
        lines += ["", view.plan.text.rstrip()]
    lines += ["", "why:", *(f"- {reason}" for reason in view.reasons)]
    if view.alternatives:
        lines += ["", "also considered:", *(f"- {other}" for other in view.alternatives)]
    return "\n".join(lines) + "\n"
