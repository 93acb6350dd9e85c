"""Quality, cost and weight of a plan in a stream space ([Introspection15 §4.3])."""

from __future__ import annotations

from collections.abc import Callable

from .optimal_plan import SELECTION_COST, SYNCHRONIZATION_COST
from .plan import (
    Compute,
    Detect,
    Node,
    SelectObject,
    SelectObjects,
    Supply,
    Synchronize,
    UseStream,
    below_of,
    nodes_of_supply,
    nothing_runs,
)
from .space import StreamSpace
from .strategy import Kind, Strategy


def quality_of(supply: Supply, space: StreamSpace) -> float:
    """The least quality of its sources: each is as good as its unit, times the worst of its
    inputs. A stream or transformation that has left the space counts as 0."""
    qualities: dict[Node, float] = {}
    for node in nodes_of_supply(supply):
        below = min((qualities[part] for part in below_of(node)), default=1.0)
        qualities[node] = _own_quality(node, space) * below
    return min(qualities[source.node] for source in supply.sources)


def cost_of(
    supply: Supply, space: StreamSpace, is_running: Callable[[Node], bool] = nothing_runs
) -> float:
    """The sum of the costs of its distinct units that do not run yet."""
    return sum(cost_of_node(node, space, is_running) for node in nodes_of_supply(supply))


def cost_of_node(
    node: Node, space: StreamSpace, is_running: Callable[[Node], bool] = nothing_runs
) -> float:
    """What a node adds to the cost of a plan: nothing if it runs."""
    return 0.0 if is_running(node) else _own_cost(node, space, 0.0)


def weight_of(
    supply: Supply,
    space: StreamSpace,
    strategy: Strategy,
    is_running: Callable[[Node], bool] = nothing_runs,
) -> float:
    """The weight by which the strategy compares plans; less is better. With *quality* it is 1 minus
    the quality."""
    if strategy.kind is Kind.QUALITY:
        return 1.0 - quality_of(supply, space)
    total = 0.0
    for node in nodes_of_supply(supply):
        cost = 0.0 if is_running(node) else _own_cost(node, space, strategy.subscribers)
        total += strategy.weight(cost, _own_quality(node, space))
    return total


def _own_quality(node: Node, space: StreamSpace) -> float:
    match node:
        case UseStream(name):
            stream = space.streams.get(name)
            return 0.0 if stream is None else stream.quality
        case Compute(name) | Detect(name):
            unit = space.transformations.get(name)
            return 0.0 if unit is None else unit.quality
        case _:
            return 1.0


def _own_cost(node: Node, space: StreamSpace, subscribers: float) -> float:
    match node:
        case UseStream(name):
            stream = space.streams.get(name)
            own = 0.0 if stream is None else stream.cost
            return own + (subscribers * space.subscribers(name) if subscribers else 0.0)
        case SelectObject() | SelectObjects():
            return SELECTION_COST
        case Synchronize():
            return SYNCHRONIZATION_COST
        case Compute(name) | Detect(name):
            unit = space.transformations.get(name)
            return 0.0 if unit is None else unit.cost
