"""The application: routes, errors, limits and the clock's tick, put together."""

import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import anyio
from fastapi import FastAPI

from ..engine.durability.durable_engine import RecordedEngine
from ..engine.engine import Engine
from ..journal.errors import JournalError
from ..streams.time import Clock
from .admission.gate import Access, Gate, client_key
from .admission.memory_limit import Memory
from .admission.quotas import Quotas
from .admission.sessions import Sessions
from .admission.token_file import TokenFile
from .admission.tokens import Tokens
from .config.file_limits import places
from .config.logs import log
from .config.settings import Settings
from .config.version import __version__
from .durability.command_queue import CommandQueue
from .http import problems
from .http.access_log import AccessLog
from .http.body_limit import BodyLimit, UnderWay
from .http.response_limit import PART, LongAnswers, ResponseLimit
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
from .runtime.context import Service
from .runtime.live_ingest import LiveBodies
from .runtime.metrics import Metrics
from .runtime.openapi import openapi_schema
from .sse.clients import EventClients
from .sse.feeds import Feeds
from .turns.batch_decoding import BatchDecoder
from .workers.services import Isolation, Windows

# Looked through in this order for each request: the most frequent ones first.
RESOURCES = (
    publish,
    follow,
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
    session,
    docs,
)
TICK = "tick"
DESCRIPTION = """Semantic stream reasoning: say what you want to know, and the service finds or
builds the streams that answer it. Errors are `application/problem+json` (RFC 9457)."""


def create_app(
    engine: Engine | RecordedEngine,
    settings: Settings,
    clock: Clock,
    tokens: Tokens | None = None,
    windows: Windows | None = None,
) -> FastAPI:
    """The service over ``engine`` as an ASGI application.

    ``clock`` tells the time in ns; the lifespan ticks the engine with it. The engine must not be
    used by anybody else but in the thread that runs the application. One that is recorded is closed
    when the application ends. ``tokens`` are those of the settings, unless they have been read
    before; raises `TokensError` where they cannot be used. ``windows`` are the workers of the
    engine's budget, if it has some, to be told of.
    """
    tokens = Tokens.of(settings) if tokens is None else tokens
    recorded: RecordedEngine | None = None
    if isinstance(engine, RecordedEngine):
        recorded, engine = engine, engine.engine
        recorded.refused_outside = (problems.Problem,)
    troubles: dict[str, str] = {}
    memory = Memory.of(settings)
    commands = CommandQueue(engine, recorded, troubles, memory)
    clients = EventClients(
        places(settings.sse_clients),
        settings.sse_clients_each,
        settings.sse_ping,
        settings.sse_send_timeout,
        tokens,
    )
    if commands.is_recording:
        feeds = Feeds(engine, settings.sse_cache, clients, lambda: commands.is_durable)
        commands.gate(feeds)
    else:
        feeds = Feeds(engine, settings.sse_cache, clients)
    bodies = UnderWay()
    answers = LongAnswers(settings.answers, memory.within(settings.answers_limit, PART))
    isolation = Isolation(settings, engine.ontology, windows)
    service = Service(
        engine,
        settings,
        clock,
        feeds,
        LiveBodies(tokens),
        BatchDecoder(engine, settings.batch_limits),
        Metrics(
            engine,
            feeds,
            bodies,
            answers,
            clock,
            commands,
            isolation,
            memory,
            settings.metrics_streams,
        ),
        isolation,
        clock(),
        Gate.of(settings, tokens, Sessions(clock), Quotas(engine, settings), memory),
        commands,
        memory,
        troubles,
        client_key=client_key,
    )
    service.metrics.tell_readiness(service.reasons)
    service.token_file = TokenFile(settings, tokens, service.metrics.tokens_read, service.revoke)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(_tick, service)
            service.isolation.open()
            tasks.start_soon(service.isolation.tend)
            if service.token_file is not None:
                tasks.start_soon(service.token_file.watch)
            yield
            service.leave()
            service.isolation.close()
            service.decoder.close()
            tasks.cancel_scope.cancel()
        commands.close()

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
        responses=problems.responses(400, 401, 403, 421, 429, 503),
    )
    app.state.service = service
    problems.install(app)
    for resource in RESOURCES:
        app.include_router(resource.router)
    app.add_middleware(ResponseLimit, long=answers, key=lambda request: service.client_key(request))
    app.add_middleware(
        BodyLimit,
        limit=settings.body_limit,
        total=settings.bodies_limit,
        timeout=settings.body_timeout,
        rate=settings.body_rate,
        refused=service.metrics.refused,
        under_way=bodies,
    )
    app.add_middleware(Access, gate=service.gate, refused=service.metrics.refused)
    app.add_middleware(AccessLog, metrics=service.metrics, slow=settings.slow_request)
    app.openapi = lambda: openapi_schema(app)  # type: ignore[method-assign]
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
            # The commands has told it, once. Time stands still until there is room.
            service.metrics.tick_failures.inc()
            log().debug("no tick", reason=str(error))
        except Exception as error:  # noqa: BLE001 - told by log, metric and /readyz
            service.troubles[TICK] = f"{type(error).__name__}: {error}"
            metrics.tick_failures.inc()
            log().exception("tick failed")
        try:
            await service.commands.maintain(service.settings)
        except JournalError as error:
            log().debug("not kept yet", reason=str(error))
        except Exception as error:  # noqa: BLE001 - told by log and /readyz
            service.troubles[TICK] = f"{type(error).__name__}: {error}"
            log().exception("tending failed")
        service.ticked = ended = time.monotonic()
        metrics.tick_seconds.observe(ended - begun)
        await anyio.sleep(pause)
        metrics.loop_lag.observe(max(0.0, time.monotonic() - ended - pause))
