"""The application: routes, errors, limits and the clock's tick, put together."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import anyio
from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic.json_schema import models_json_schema

from .. import __version__
from ..engine.engine import Engine
from ..streams.time import Clock
from . import problems
from .body import BodyLimit
from .context import Service
from .isolation.services import Isolation
from .live import LiveBodies
from .logs import log
from .metrics import Metrics
from .models import READ_BY_ROUTES
from .observe import Observe
from .routes import (
    annotations,
    docs,
    events,
    explain,
    health,
    kpl,
    live,
    match,
    ontologies,
    publish,
    queries,
    samples,
    sparql,
    specifications,
    status,
    streams,
    subscriptions,
    templates,
    transformations,
)
from .settings import Settings
from .sse import Feeds

# Looked through in this order for each request: batches of samples are the most frequent ones.
RESOURCES = (
    publish,
    live,
    samples,
    templates,
    events,
    queries,
    streams,
    subscriptions,
    annotations,
    transformations,
    ontologies,
    kpl,
    specifications,
    match,
    sparql,
    explain,
    status,
    health,
    docs,
)
DESCRIPTION = """Semantic stream reasoning: say what you want to know, and the service finds or
builds the streams that answer it. Errors are `application/problem+json` (RFC 9457)."""


def create_app(engine: Engine, settings: Settings, clock: Clock) -> FastAPI:
    """The service over ``engine`` as an ASGI application.

    ``clock`` tells the time in ns; the lifespan ticks the engine with it. The engine must not be
    used by anybody else but in the thread that runs the application.
    """
    feeds = Feeds(engine, settings.sse_cache)
    service = Service(
        engine,
        settings,
        clock,
        feeds,
        LiveBodies(),
        Metrics(engine, feeds),
        Isolation(settings, engine.ontology),
        clock(),
    )

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(_tick, service)
            service.isolation.open()
            yield
            service.leave()
            service.isolation.close()
            tasks.cancel_scope.cancel()

    app = FastAPI(
        title="DyKnow",
        version=__version__,
        description=DESCRIPTION,
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
        strict_content_type=False,
        # The engine's errors have a model of their own, so FastAPI's default 422 is not told.
        responses=problems.responses(400),
    )
    app.state.service = service
    problems.install(app)
    for resource in RESOURCES:
        app.include_router(resource.router)
    app.add_middleware(BodyLimit, limit=settings.body_limit, total=settings.bodies_limit)
    app.add_middleware(Observe, metrics=service.metrics)
    app.openapi = lambda: _openapi(app)  # type: ignore[method-assign]
    return app


async def _tick(service: Service) -> None:
    """Tell the engine the time for as long as the service runs.

    A tick that fails is logged and makes the service not ready; the next one is tried, since an
    engine that is told no time would let every stamped stream stand still.
    """
    while True:
        try:
            service.tick()
            service.failure = None
        except Exception as error:  # noqa: BLE001 - told by log, metric and /readyz
            service.failure = f"{type(error).__name__}: {error}"
            service.metrics.tick_failures.inc()
            log().exception("tick failed")
        await anyio.sleep(service.settings.tick)


def _openapi(app: FastAPI) -> dict[str, object]:
    """The schema, with the model of problems, and without FastAPI's own form of errors."""
    if app.openapi_schema is None:
        schema = get_openapi(
            title=app.title,
            version=app.version,
            description=app.description,
            routes=app.routes,
        )
        components = schema.setdefault("components", {}).setdefault("schemas", {})
        for name in ("HTTPValidationError", "ValidationError"):
            components.pop(name, None)
        _, bodies = models_json_schema(
            [(model, "validation") for model in READ_BY_ROUTES],
            ref_template="#/components/schemas/{model}",
        )
        for name, body in bodies["$defs"].items():
            components.setdefault(name, body)
        components["ProblemModel"] = problems.ProblemModel.model_json_schema()
        for path in schema["paths"].values():
            for operation in path.values():
                if "422" in operation["responses"]:
                    operation["responses"]["422"] = problems.responses(422)[422]
        app.openapi_schema = schema
    return app.openapi_schema
