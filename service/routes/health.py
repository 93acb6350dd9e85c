"""Is the service alive, is it ready, what does it count."""

from __future__ import annotations

from fastapi import APIRouter, Response

from ..models import HealthModel
from ..runtime.context import Context
from ..runtime.metrics import CONTENT_TYPE

router = APIRouter(tags=["health"])


@router.get("/healthz")
async def healthz() -> HealthModel:
    """The process answers."""
    return HealthModel(status="ok")


@router.get("/readyz", responses={503: {"model": HealthModel}})
async def readyz(service: Context, response: Response) -> HealthModel:
    """The service takes requests: 503 with the reasons while it starts or stops, while the engine's
    tick fails or is late, and while something else keeps it from its work.

    200 with `degraded` while all works but units that were cut off: what they answer is `failed` in
    `/events`, `/queries` and `/subscriptions`. Others are served, and a restart would mend nothing.
    """
    reasons = service.reasons()
    if not reasons:
        failed = service.failed()
        if not failed:
            return HealthModel(status="ok")
        return HealthModel(status="degraded", reason="; ".join(failed), reasons=failed)
    response.status_code = 503
    return HealthModel(status="failing", reason="; ".join(reasons), reasons=reasons)


@router.get(
    "/metrics",
    response_class=Response,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
)
async def metrics(service: Context) -> Response:
    """Metrics in the text format of Prometheus."""
    return Response(await service.metrics.text(), media_type=CONTENT_TYPE)
