"""The application: routes, errors, limits and the clock's tick, put together."""

import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import anyio
from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic.json_schema import models_json_schema

from .. import __version__
from ..engine.engine import Engine
from ..engine.recorded import RecordedEngine
from ..journal.errors import JournalError
from ..streams.time import Clock
from . import problems
from .access import Access, Gate, client_key
from .body import BodyLimit, UnderWay
from .context import Service
from .descriptors import places
from .event_clients import EventClients
from .isolation.services import Isolation
from .keeper import Keeper
from .live import LiveBodies
from .logs import log
from .metrics import Metrics
from .models import READ_BY_ROUTES
from .observe import Observe
from .quotas import Quotas
from .routes import (
    annotations,
    docs,
    events,
    explain,
    follow,
    health,
    kpl,
    live,
    match,
    ontologies,
    publish,
    queries,
    samples,
    session,
    sparql,
    specifications,
    status,
    streams,
    subscriptions,
    templates,
    transformations,
)
from .scopes import scope_of_operation
from .sessions import Sessions
from .settings import Settings
from .slow_bodies import SlowBodies
from .sse import Feeds
from .tokens import Tokens

# Looked through in this order for each request: batches of samples are the most frequent ones.
RESOURCES = (
    publish,
    live,
    samples,
    templates,
    events,
    queries,
    streams,
    follow,
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
    session,
    docs,
)
ASKING = ("/match", "/session", "/sparql")
"""Paths to which is posted what changes nothing that is kept."""
TICK = "tick"
DESCRIPTION = """Semantic stream reasoning: say what you want to know, and the service finds or
builds the streams that answer it. Errors are `application/problem+json` (RFC 9457)."""


def create_app(
    engine: Engine | RecordedEngine,
    settings: Settings,
    clock: Clock,
    tokens: Tokens | None = None,
) -> FastAPI:
    """The service over ``engine`` as an ASGI application.

    ``clock`` tells the time in ns; the lifespan ticks the engine with it. The engine must not be
    used by anybody else but in the thread that runs the application. One that is recorded is closed
    when the application ends. ``tokens`` are those of the settings, unless they have been read
    before; raises `TokensError` where they cannot be used.
    """
    tokens = Tokens.of(settings) if tokens is None else tokens
    recorded: RecordedEngine | None = None
    if isinstance(engine, RecordedEngine):
        recorded, engine = engine, engine.engine
    troubles: dict[str, str] = {}
    keeper = Keeper(engine, recorded, troubles)
    clients = EventClients(
        places(settings.sse_clients),
        settings.sse_clients_each,
        settings.sse_ping,
        settings.sse_send_timeout,
    )
    feeds = Feeds(engine, settings.sse_cache, clients, recorded=keeper.is_recording)
    if keeper.is_recording:
        keeper.show_to(feeds)
    bodies = UnderWay()
    service = Service(
        engine,
        settings,
        clock,
        feeds,
        LiveBodies(),
        Metrics(engine, feeds, bodies, clock),
        Isolation(settings, engine.ontology),
        clock(),
        Gate.of(settings, tokens, Sessions(clock), Quotas(engine, settings)),
        keeper,
        troubles,
        client_key=client_key,
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
        keeper.close()

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
        responses=problems.responses(400, 401, 403, 421),
    )
    app.state.service = service
    problems.install(app)
    for resource in RESOURCES:
        app.include_router(resource.router)
    app.add_middleware(
        BodyLimit,
        limit=settings.body_limit,
        total=settings.bodies_limit,
        slow=SlowBodies(settings.body_timeout, settings.body_rate, service.metrics.refused),
        under_way=bodies,
    )
    app.add_middleware(Access, gate=service.gate, refused=service.metrics.refused)
    app.add_middleware(Observe, metrics=service.metrics, slow=settings.slow_request)
    app.openapi = lambda: _openapi(app)  # type: ignore[method-assign]
    return app


async def _tick(service: Service) -> None:
    """Tell the engine the time for as long as the service runs.

    A tick that fails is logged and makes the service not ready; the next one is tried, since an
    engine that is told no time would let every stamped stream stand still.
    """
    metrics, pause = service.metrics, service.settings.tick
    while True:
        begun = time.monotonic()
        try:
            service.tick()
            service.troubles.pop(TICK, None)
        except JournalError as error:
            # The keeper has told it, once. Time stands still until there is room.
            service.metrics.tick_failures.inc()
            log().debug("no tick", reason=str(error))
        except Exception as error:  # noqa: BLE001 - told by log, metric and /readyz
            service.troubles[TICK] = f"{type(error).__name__}: {error}"
            metrics.tick_failures.inc()
            log().exception("tick failed")
        try:
            await service.keeper.tend(service.settings)
        except JournalError as error:
            log().debug("not kept yet", reason=str(error))
        except Exception as error:  # noqa: BLE001 - told by log and /readyz
            service.troubles[TICK] = f"{type(error).__name__}: {error}"
            log().exception("tending failed")
        service.ticked = ended = time.monotonic()
        metrics.tick_seconds.observe(ended - begun)
        await anyio.sleep(pause)
        metrics.loop_lag.observe(max(0.0, time.monotonic() - ended - pause))


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
        components["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
        for path, operations in schema["paths"].items():
            for method, operation in operations.items():
                scope = scope_of_operation(method, path)
                operation["security"] = [] if scope is None else [{"token": [str(scope)]}]
                if "requestBody" in operation:
                    operation["responses"] |= {"408": problems.responses(408)[408]}
                if method != "get" and path not in ASKING:
                    operation["responses"] |= problems.written_responses()
                if "422" in operation["responses"]:
                    operation["responses"]["422"] = problems.responses(422)[422]
        app.openapi_schema = schema
    return app.openapi_schema
