"""The measured cost of a query's operators: rows out and time, recorded as windows close."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from ..algebra.plan import Plan, inputs


@dataclass(slots=True)
class Cost:
    """The cost of one operator over all windows: runs, rows out, time including its inputs, and
    time spent for it outside the evaluation of the plan (as rows come)."""

    windows: int = 0
    rows: int = 0
    nanoseconds: int = 0
    beside: int = 0


@dataclass(frozen=True, slots=True)
class Measured:
    """The cost of one operator per window: rows out, and its own time in ns."""

    rows: float
    nanoseconds: float


@dataclass(slots=True)
class Profile:
    """The costs by operator. ``clock`` returns ns: nothing below reads a clock by itself."""

    clock: Callable[[], int]
    _costs: dict[int, Cost] = field(default_factory=dict)
    # Costs are keyed by id(plan). A reference keeps the plan alive, so its id is not reused.
    _plans: list[Plan] = field(default_factory=list)

    def add(self, plan: Plan, rows: int, nanoseconds: int) -> None:
        """Record a run of an operator with ``rows`` out."""
        cost = self._of(plan)
        cost.windows += 1
        cost.rows += rows
        cost.nanoseconds += nanoseconds

    def beside(self, plan: Plan, nanoseconds: int) -> None:
        """Record time spent for an operator outside the evaluation of the plan."""
        self._of(plan).beside += nanoseconds

    @property
    def windows(self) -> int:
        """The number of windows."""
        return max((cost.windows for cost in self._costs.values()), default=0)

    def measured(self, plan: Plan) -> Measured | None:
        """Return the cost of an operator, or None if it has not run by itself."""
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
