"""Is the service alive, is it ready, what does it count."""

from __future__ import annotations

from fastapi import APIRouter, Response

from ..context import Context
from ..metrics import CONTENT_TYPE
from ..models import HealthModel

router = APIRouter(tags=["health"])


@router.get("/healthz")
async def healthz() -> HealthModel:
    """The process answers."""
    return HealthModel(status="ok")


@router.get("/readyz", responses={503: {"model": HealthModel}})
async def readyz(service: Context, response: Response) -> HealthModel:
    """The engine works: 503 with the reason while its tick fails."""
    if service.failure is None:
        return HealthModel(status="ok")
    response.status_code = 503
    return HealthModel(status="failing", reason=service.failure)


@router.get(
    "/metrics",
    response_class=Response,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
)
async def metrics(service: Context) -> Response:
    """Metrics in the text format of Prometheus."""
    return Response(await service.metrics.text(), media_type=CONTENT_TYPE)
