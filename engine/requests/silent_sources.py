"""Which source of an adaptive subscription is silent, from when on, and what is to blame."""

from __future__ import annotations

from ...matching.plan import UseStream
from ...streams.generator import StreamGenerator
from ..configuration.silent_streams import Silences
from .adaptive_subscription import AdaptiveSubscription, transformations_of


def silent_from(
    found: AdaptiveSubscription, source: StreamGenerator, silences: Silences
) -> int | None:
    """From when on (ns) a source is silent; None: nobody knows.

    Of what is made, and read since a short time only, what it is made from may tell."""
    staleness = found.wish.staleness
    if silences.has_arrivals(source.name):
        return silences.silent_at(source.name, staleness)
    silent_at = found.unit.arrivals[source].silent_at(staleness)
    if silent_at is not None:
        return silent_at
    times = [
        silences.silent_at(node.stream)
        for node in found.nodes_behind(source)
        if isinstance(node, UseStream)
    ]
    known = [time for time in times if time is not None]
    return max(known) if known and len(known) == len(times) else None


def culprits(
    found: AdaptiveSubscription, source: StreamGenerator, silences: Silences, now: int
) -> tuple[str, ...]:
    """Of what a silent source is made from, what is silent itself: streams from outside, or
    else the transformations, which make nothing of what they get."""
    nodes = found.nodes_behind(source)
    streams = dict.fromkeys(node.stream for node in nodes if isinstance(node, UseStream))
    silent = silences.silent_streams(now, found.wish.staleness)
    return (
        tuple(name for name in streams if name in silent)
        or tuple(sorted(transformations_of(nodes)))
        or tuple(streams)
    )
