"""The application, made from its parts: routes, errors, limits and the clock's tick."""

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
from .http.compression import Compression
from .http.response_limit import PART, LongAnswers, ResponseLimit
from .routes import (
    annotations,
    docs,
    events,
    follow,
    kpl,
    live,
    ontologies,
    publish,
    queries,
    samples,
    session,
    specifications,
    streams,
    subscriptions,
    templates,
    transformations,
)
from .routes.introspection import (
    explain,
    graph,
    health,
    journal,
    match,
    objects,
    requests,
    sparql,
    status,
    units,
)
from .runtime.context import Service
from .runtime.live_ingest import LiveBodies
from .runtime.metrics import Metrics
from .runtime.openapi import openapi_schema
from .sse.clients import EventClients
from .sse.feeds import Feeds
from .turns.batch_decoding import BatchDecoder
from .workers.services import Isolation, Windows

# The router tries them in this order for each request, so the most frequent ones come first.
RESOURCES = (
    publish,
    follow,
    live,
    samples,
    templates,
    events,
    queries,
    streams,
    units,
    graph,
    objects,
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
    requests,
    journal,
    health,
    session,
    docs,
)
TICK = "tick"
DESCRIPTION = """Semantic stream reasoning: describe the events or features that you want, and the
service finds or builds their streams. Errors are `application/problem+json` (RFC 9457)."""


def create_app(
    engine: Engine | RecordedEngine,
    settings: Settings,
    clock: Clock,
    tokens: Tokens | None = None,
    windows: Windows | None = None,
) -> FastAPI:
    """Return the service over ``engine`` as an ASGI application.

    ``clock`` returns the time in ns; the lifespan ticks the engine with it. Only the application's
    thread may use the engine. The end of the application closes a `RecordedEngine`. Without
    ``tokens`` it reads those of the settings; raises `TokensError` if they are invalid.
    ``windows`` are the workers of the engine's budget, for the metrics.
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
            service.recent_log.open()
            service.isolation.open()
            tasks.start_soon(service.isolation.restart_workers)
            if service.token_file is not None:
                tasks.start_soon(service.token_file.watch)
            yield
            service.recent_log.close()
            service.leave()
            service.isolation.close()
            service.decoder.close()
            tasks.cancel_scope.cancel()
        # The tick executes commands, so it has to end before the last checkpoint.
        commands.close()

    app = FastAPI(
        title="DyKnow",
        version=__version__,
        description=DESCRIPTION,
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
    )
    app.state.service = service
    problems.install(app)
    for resource in RESOURCES:
        app.router.routes.extend(resource.router.routes)
    # The layer added last sees a request first: the service checks access before it reads a body.
    app.add_middleware(ResponseLimit, long=answers, key=lambda request: service.client_key(request))
    app.add_middleware(Compression)
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
    app.add_middleware(
        AccessLog,
        metrics=service.metrics,
        recent=service.recent_requests,
        slow=settings.slow_request,
    )
    app.openapi = lambda: openapi_schema(app)  # type: ignore[method-assign]
    return app


async def _tick(service: Service) -> None:
    """Tick the engine as long as the service runs.

    A failed tick is logged, and the service is not ready. The loop goes on, since without ticks
    every stream that is stamped on arrival would stand still.
    """
    metrics, pause = service.metrics, service.settings.tick
    while True:
        begun = time.monotonic()
        try:
            service.tick()
            service.troubles.pop(TICK, None)
        except JournalError as error:
            # `CommandQueue` has logged it once. Time stands still until the log has room.
            service.metrics.tick_failures.inc()
            log().debug("no tick", reason=str(error))
        except Exception as error:  # noqa: BLE001 - the log, a metric and /readyz report it
            service.troubles[TICK] = f"{type(error).__name__}: {error}"
            metrics.tick_failures.inc()
            log().exception("tick failed")
        try:
            await service.commands.maintain(service.settings)
        except JournalError as error:
            log().debug("not durable yet", reason=str(error))
        except Exception as error:  # noqa: BLE001 - the log and /readyz report it
            service.troubles[TICK] = f"{type(error).__name__}: {error}"
            log().exception("maintenance failed")
        service.ticked = ended = time.monotonic()
        metrics.tick_seconds.observe(ended - begun)
        await anyio.sleep(pause)
        service.loop_lag = max(0.0, time.monotonic() - ended - pause)
        metrics.loop_lag.observe(service.loop_lag)
