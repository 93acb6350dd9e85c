"""Liveness, readiness and metrics of the service."""

from __future__ import annotations

from fastapi import Response

from ...http.routers import resource_router
from ...models import HealthModel
from ...runtime.context import Context
from ...runtime.metrics import CONTENT_TYPE

router = resource_router("health")


@router.get("/healthz")
async def healthz() -> HealthModel:
    """Return 200 while the process answers."""
    return HealthModel(status="ok")


@router.get("/readyz", responses={503: {"model": HealthModel}})
async def readyz(service: Context, response: Response) -> HealthModel:
    """Return 200 while the service takes requests, and 503 with reasons while it does not.

    503 with `starting`: that passes by itself. 503 with `failing`: it stops, the engine's tick
    fails or is late, the data directory, the workers or the memory limit prevent its work. 200 with
    `degraded`: some units failed, and show `failed` in `/events`, `/queries` and `/subscriptions`;
    all else works. A restart would not help.
    """
    # In the order of `Service.reasons`, which misses no task.
    starting, failing = service.starting(), service.failing()
    reasons = starting + failing
    if not reasons:
        failed = service.failed()
        if not failed:
            return HealthModel(status="ok")
        return HealthModel(status="degraded", reason="; ".join(failed), reasons=failed)
    response.status_code = 503
    status = "failing" if failing else "starting"
    return HealthModel(status=status, reason="; ".join(reasons), reasons=reasons)


@router.get(
    "/metrics",
    response_class=Response,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
)
async def metrics(service: Context) -> Response:
    """Return the metrics in the text format of Prometheus."""
    return Response(await service.metrics.text(), media_type=CONTENT_TYPE)
