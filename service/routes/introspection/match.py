"""Semantic matching without executing ([Introspection15 §4.3])."""

from __future__ import annotations

from fastapi import Depends

from ...http.problems import responses
from ...http.routers import resource_router
from ...models import MatchIn, MatchModel
from ...runtime.context import Context
from ..json_body import JsonRoute
from ..streams import json_only

router = resource_router("matching", route_class=JsonRoute)


@router.post("/match", dependencies=[Depends(json_only)], responses=responses(404, 413, 415, 422))
async def match_feature(wanted: MatchIn, service: Context) -> MatchModel:
    """Find a plan for a feature, with alternatives and reasons. Nothing starts."""
    objects = [service.engine.object_name(each) for each in wanted.objects]
    view = service.engine.match(
        wanted.feature, sort=wanted.sort, objects=objects, strategy=wanted.strategy
    )
    return MatchModel.of(view)
