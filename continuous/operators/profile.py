"""What the operators of a query have cost: rows out and time, measured as windows close."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from ..algebra.plan import Plan, inputs


@dataclass(slots=True)
class Cost:
    """Of one operator, over all windows: how often it ran, rows out, time with its inputs, and time
    for it beside the evaluation of the plan (as rows come)."""

    windows: int = 0
    rows: int = 0
    nanoseconds: int = 0
    beside: int = 0


@dataclass(frozen=True, slots=True)
class Measured:
    """Of one operator, a window: rows out, and its own time in ns."""

    rows: float
    nanoseconds: float


@dataclass(slots=True)
class Profile:
    """The costs by operator. ``clock`` tells ns: nothing in this room reads one by itself."""

    clock: Callable[[], int]
    _costs: dict[int, Cost] = field(default_factory=dict)
    # An operator is told apart by its identity, so it is kept from being another's.
    _plans: list[Plan] = field(default_factory=list)

    def add(self, plan: Plan, rows: int, nanoseconds: int) -> None:
        """An operator has given ``rows``."""
        cost = self._of(plan)
        cost.windows += 1
        cost.rows += rows
        cost.nanoseconds += nanoseconds

    def beside(self, plan: Plan, nanoseconds: int) -> None:
        """Time was spent for an operator beside the evaluation of the plan."""
        self._of(plan).beside += nanoseconds

    @property
    def windows(self) -> int:
        """How many windows there were."""
        return max((cost.windows for cost in self._costs.values()), default=0)

    def measured(self, plan: Plan) -> Measured | None:
        """What an operator has cost; None where it has not run by itself."""
        cost = self._costs.get(id(plan))
        if cost is None or not cost.windows:
            return None
        below = (self._costs.get(id(part)) for part in inputs(plan))
        own = cost.nanoseconds - sum(one.nanoseconds for one in below if one is not None)
        spent = max(own, 0) + cost.beside
        return Measured(cost.rows / cost.windows, spent / cost.windows)

    def _of(self, plan: Plan) -> Cost:
        cost = self._costs.get(id(plan))
        if cost is None:
            cost = self._costs[id(plan)] = Cost()
            self._plans.append(plan)
        return cost
