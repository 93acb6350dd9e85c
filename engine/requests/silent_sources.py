"""Finds silent sources of adaptive subscriptions, and the streams that cause the silence."""

from __future__ import annotations

from ...matching.plan import UseStream
from ...streams.generator import StreamGenerator
from ..configuration.silent_streams import Silences
from .adaptive_subscription import AdaptiveSubscription, transformations_of


def silent_from(
    subscription: AdaptiveSubscription, source: StreamGenerator, silences: Silences
) -> int | None:
    """Return the time (ns) from which on a source counts as silent; None: unknown.

    For a stream of units that was read for a short time only, the streams behind it decide."""
    staleness = subscription.wish.staleness
    if silences.has_arrivals(source.name):
        return silences.silent_at(source.name, staleness)
    silent_at = subscription.unit.arrivals[source].silent_at(staleness)
    if silent_at is not None:
        return silent_at
    times = [
        silences.silent_at(node.stream)
        for node in subscription.nodes_behind(source)
        if isinstance(node, UseStream)
    ]
    known = [time for time in times if time is not None]
    return max(known) if known and len(known) == len(times) else None


def culprits(
    subscription: AdaptiveSubscription, source: StreamGenerator, silences: Silences, now: int
) -> tuple[str, ...]:
    """Return the causes of a silent source: the silent streams behind it, or, if none is silent,
    the transformations, which made no samples of their input."""
    nodes = subscription.nodes_behind(source)
    streams = dict.fromkeys(node.stream for node in nodes if isinstance(node, UseStream))
    silent = silences.silent_streams(now, subscription.wish.staleness)
    return (
        tuple(name for name in streams if name in silent)
        or tuple(sorted(transformations_of(nodes)))
        or tuple(streams)
    )
