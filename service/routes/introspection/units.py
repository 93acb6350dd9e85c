"""Computational units: what runs, what it reads and makes, and its counters."""

from __future__ import annotations

from fastapi import Response

from ...http.encodings.json_lists import listed
from ...http.problems import Problem, responses
from ...http.routers import resource_router
from ...models import RunningUnitModel
from ...runtime.context import Context

router = resource_router("units")


@router.get("/units", response_model=list[RunningUnitModel])
async def list_units(service: Context) -> Response:
    """List all running units with inputs, output, parameters, users, work, lag and errors."""
    return await listed(service.engine.units(), RunningUnitModel.running)


@router.get("/units/{name}", responses=responses(404))
async def read_unit(name: str, service: Context) -> RunningUnitModel:
    """Return one running unit."""
    for unit in service.engine.units():
        if unit.name == name:
            return RunningUnitModel.running(unit)
    raise Problem(
        404, "unknown unit", f"no unit is called {name!r}", hint="GET /units lists the running ones"
    )
