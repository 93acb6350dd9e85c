"""Metrics for Prometheus: requests as they happen, streams as they are when asked."""

from __future__ import annotations

from collections.abc import Iterable

from prometheus_client import CollectorRegistry, Counter, Histogram, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from ..engine.engine import Engine
from .sse import Feeds

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
_FATES = ("accepted", "used", "late", "duplicate", "expired")


class Metrics:
    """The service's own registry: several services in one process do not meet."""

    def __init__(self, engine: Engine, feeds: Feeds) -> None:
        self._registry = CollectorRegistry()
        self._registry.register(_Streams(engine, feeds))
        self._requests = Counter(
            "dyknow_http_requests",
            "Requests answered",
            ["method", "route", "status"],
            registry=self._registry,
        )
        self._seconds = Histogram(
            "dyknow_http_request_seconds",
            "Time until a response is complete (event streams and live samples excepted)",
            ["route"],
            registry=self._registry,
        )
        self._refusals = Counter(
            "dyknow_refusals",
            "Requests and connections refused, by the title of the problem",
            ["reason"],
            registry=self._registry,
        )
        self.tick_failures = Counter(
            "dyknow_tick_failures", "Ticks that failed", registry=self._registry
        )

    def request(self, method: str, route: str, status: int, seconds: float | None) -> None:
        """Count a request; ``seconds`` None for one that has no end of its own."""
        self._requests.labels(method, route, str(status)).inc()
        if seconds is not None:
            self._seconds.labels(route).observe(seconds)

    def refused(self, reason: str) -> None:
        """Count a refusal by what the service protects itself from."""
        self._refusals.labels(reason).inc()

    def text(self) -> bytes:
        """All metrics in the text format of Prometheus."""
        return generate_latest(self._registry)


class _Streams(Collector):
    """Reads the streams' own counters at each scrape: nothing is counted twice."""

    def __init__(self, engine: Engine, feeds: Feeds) -> None:
        self._engine = engine
        self._feeds = feeds

    def describe(self) -> Iterable[Metric]:
        return ()

    def collect(self) -> Iterable[Metric]:
        samples = CounterMetricFamily(
            "dyknow_samples", "Samples by fate", labels=["stream", "fate"]
        )
        kept = GaugeMetricFamily("dyknow_samples_kept", "Samples in history", labels=["stream"])
        pending = GaugeMetricFamily(
            "dyknow_samples_pending", "Samples held back within the lateness", labels=["stream"]
        )
        subscribers = GaugeMetricFamily(
            "dyknow_subscribers", "Subscriptions served", labels=["stream"]
        )
        for view in self._engine.streams():
            for fate in _FATES:
                samples.add_metric([view.name, fate], getattr(view.counters, fate))
            pending.add_metric([view.name], view.counters.pending)
            kept.add_metric([view.name], view.samples_kept)
            subscribers.add_metric([view.name], view.subscribers)
        yield samples
        yield kept
        yield pending
        yield subscribers
        yield GaugeMetricFamily(
            "dyknow_event_requests", "Event requests that run", value=len(self._engine.events())
        )
        yield from self._clients()

    def _clients(self) -> Iterable[Metric]:
        clients = self._feeds.all
        yield GaugeMetricFamily(
            "dyknow_event_stream_clients", "Clients of event streams", value=len(clients)
        )
        yield GaugeMetricFamily(
            "dyknow_event_stream_blocked",
            "Clients of event streams that have not taken what they were sent",
            value=clients.blocked,
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
        refused = CounterMetricFamily(
            "dyknow_event_stream_refusals",
            "Clients for whom there was no place, by the limit",
            labels=["limit"],
        )
        for limit, count in clients.refused.items():
            refused.add_metric([limit], count)
        yield refused
