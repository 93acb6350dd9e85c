"""Choose the way to adapt a stream to a policy."""

from __future__ import annotations

from ..stream_rules import Rules
from .adaptation import Adaptation, Filtering, OnDrop
from .approximation import Approximating
from .policy import GRID_LIMIT, Approximation, ChangeBy, Order, Policy
from .reordering import Reordering
from .sample_chain import Chain


def adapt(
    policy: Policy,
    on_drop: OnDrop | None = None,
    *,
    limit: int = GRID_LIMIT,
    rules: Rules | None = None,
) -> Adaptation:
    """Adapt one stream to ``policy``, from now on; it passes what it drops to ``on_drop``.

    ``limit``: how many samples ``use most recent`` may make at once before it raises
    `PolicyError`. ``rules`` are those of the stream that it makes.
    """
    if policy.approximation is Approximation.MOST_RECENT:
        return Approximating(policy, on_drop, limit=limit)
    if policy.period is not None:
        return Chain(policy, on_drop, rules)
    waits = policy.order is not Order.ANY and policy.max_delay is not None
    if not waits or isinstance(policy.change, ChangeBy):
        return Filtering(policy, on_drop, rules)
    return Reordering(policy, on_drop, rules)
