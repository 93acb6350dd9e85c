"""Metrics for Prometheus: the service counts requests as they happen, and reads streams and units
at each scrape.

docs/reference/metrics.md lists the metrics. `stream_metrics` writes those of streams and units,
since there may be tens of thousands; Prometheus' client library writes all others.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    Info,
    ProcessCollector,
    generate_latest,
)
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from ...engine.engine import Engine
from ...streams.time import Clock
from ..admission.memory_limit import Memory
from ..config.logs import log
from ..config.version import __version__
from ..durability.command_queue import CommandQueue
from ..durability.journal_metrics import JournalState
from ..http.body_limit import UnderWay
from ..http.response_limit import LongAnswers
from ..sse.feeds import Feeds
from ..workers.metrics import WorkerMetrics
from ..workers.services import Isolation
from .stream_metrics import StreamMetrics

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
_MOMENTS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0)
"""The buckets of histograms of the event loop, in seconds."""
_METHODS = frozenset(("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"))
OTHER = "other"
"""The label of unknown methods: a client may send any number of them."""


class Metrics:
    """The metrics of one service, in its own registry: a process may have several services."""

    def __init__(
        self,
        engine: Engine,
        feeds: Feeds,
        bodies: UnderWay,
        answers: LongAnswers,
        clock: Clock,
        commands: CommandQueue,
        isolation: Isolation,
        memory: Memory,
        streams: int,
    ) -> None:
        """``streams``: the number of streams, and of units, with lines of their own."""
        self._clock = clock
        self._commands = commands
        self._streams = StreamMetrics(engine, streams)
        self._journal = JournalState(commands)
        self._registry = registry = CollectorRegistry()
        self._is_told = False
        """Whether the log has the warning that the disk does not answer."""
        ProcessCollector(registry=registry)
        registry.register(_Service(engine, feeds, bodies, answers, memory))
        registry.register(self._journal)
        commands.metrics.register(registry)
        registry.register(WorkerMetrics(isolation.pools))
        self._ready = Gauge("dyknow_ready", "Whether the service is ready", registry=registry)
        build = {"version": __version__, "python": sys.version.split()[0]}
        Info("dyknow_build", "The running version", registry=registry).info(build)
        self._requests = Counter(
            "dyknow_http_requests",
            "Requests answered",
            ["method", "route", "status"],
            registry=registry,
        )
        self._seconds = Histogram(
            "dyknow_http_request_seconds",
            "Time until a response begins to be sent (event streams and live samples excepted)",
            ["route"],
            registry=registry,
        )
        self._refusals = Counter(
            "dyknow_refusals",
            "Requests and connections refused, by the title of the problem",
            ["reason"],
            registry=registry,
        )
        self._reloads = Counter(
            "dyknow_tokens_reloads",
            "Readings of the changed file of tokens",
            ["outcome"],
            registry=registry,
        )
        for outcome in ("taken", "refused"):
            self._reloads.labels(outcome)
        self.tick_failures = Counter("dyknow_tick_failures", "Ticks that failed", registry=registry)
        self.tick_seconds = Histogram(
            "dyknow_tick_seconds",
            "Duration of ticks of the engine",
            registry=registry,
            buckets=_MOMENTS,
        )
        self.loop_lag = Histogram(
            "dyknow_event_loop_lag_seconds",
            "Delay of a timer of the event loop",
            registry=registry,
            buckets=_MOMENTS,
        )

    def request(self, method: str, route: str, status: int, seconds: float | None) -> None:
        """Count a request; ``seconds`` None for one that has no end of its own."""
        self._requests.labels(method if method in _METHODS else OTHER, route, str(status)).inc()
        if seconds is not None:
            self._seconds.labels(route).observe(seconds)

    def refused(self, reason: str) -> None:
        """Count a refusal by the title of its problem."""
        self._refusals.labels(reason).inc()

    def tokens_read(self, outcome: str) -> None:
        """Count a reading of the file of tokens."""
        self._reloads.labels(outcome).inc()

    def tell_readiness(self, reasons: Callable[[], list[str]]) -> None:
        """Set the function that returns why the service is not ready."""
        self._ready.set_function(lambda: not reasons())

    async def text(self) -> bytes:
        """All metrics in the text format of Prometheus."""
        try:
            self._journal.use = await self._commands.disk_use()
            self._is_told = False
        except (OSError, TimeoutError) as error:
            # Omit these metrics only.
            self._journal.use = None
            if not self._is_told:  # one warning, not one a scrape
                reason = str(error) or "it did not answer in time"
                log().warning("the disk does not say how full it is", reason=reason)
            self._is_told = True
        return generate_latest(self._registry) + await self._streams.text(self._clock())


class _Service(Collector):
    """Reads the counters of the service's parts at each scrape."""

    def __init__(
        self,
        engine: Engine,
        feeds: Feeds,
        bodies: UnderWay,
        answers: LongAnswers,
        memory: Memory,
    ) -> None:
        self._engine = engine
        self._clients = feeds.all
        self._bodies = bodies
        self._answers = answers
        self._memory = memory

    def describe(self) -> Iterable[Metric]:
        return ()

    def collect(self) -> Iterable[Metric]:
        clients = self._clients
        engine = self._engine
        yield _gauge("dyknow_streams", "Streams", len(engine.generators()))
        yield _gauge("dyknow_units", "Computational units", len(engine.units()))
        yield _gauge(
            "dyknow_units_behind",
            "Units with a backlog of windows",
            len(engine.backlog.units),
        )
        yield _gauge("dyknow_event_requests", "Running event requests", len(engine.event_ids()))
        yield _gauge("dyknow_bodies", "Requests under way", self._bodies.bodies)
        yield _gauge("dyknow_bodies_bytes", "Bytes of bodies under way", self._bodies.bytes)
        answers = self._answers.all
        yield _gauge("dyknow_long_answers", "Long answers under way", answers.count)
        yield _gauge("dyknow_long_answers_bytes", "Bytes of long answers under way", answers.bytes)
        yield _refusals(
            "dyknow_long_answer_refusals",
            "Long answers refused, by the limit",
            self._answers.refused,
        )
        memory = self._memory
        yield _gauge("dyknow_memory_limit_bytes", "Memory that the service may take", memory.limit)
        yield CounterMetricFamily(
            "dyknow_memory_refusals", "Requests refused for lack of memory", value=memory.refused
        )
        yield _gauge("dyknow_event_stream_clients", "Clients of event streams", len(clients))
        yield _gauge(
            "dyknow_event_stream_blocked",
            "Clients of event streams that have not taken what they were sent",
            clients.blocked,
        )
        yield CounterMetricFamily(
            "dyknow_event_stream_bytes", "Bytes of events sent to clients", value=clients.sent
        )
        ends = CounterMetricFamily(
            "dyknow_event_stream_ends", "Event streams that ended, by reason", labels=["reason"]
        )
        for reason, count in clients.ends.items():
            ends.add_metric([reason], count)
        yield ends
        yield _refusals(
            "dyknow_event_stream_refusals",
            "Clients of event streams refused, by the limit",
            clients.refused,
        )


def _refusals(name: str, text: str, refused: Mapping[str, int]) -> Metric:
    family = CounterMetricFamily(name, text, labels=["limit"])
    for limit, count in refused.items():
        family.add_metric([limit], count)
    return family


def _gauge(name: str, text: str, value: float) -> Metric:
    return GaugeMetricFamily(name, text, value=value)
