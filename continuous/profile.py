"""What the operators of a query have cost: rows out and time, measured as windows close."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from .logical import Plan


@dataclass(slots=True)
class Cost:
    """Of one operator, over all windows: how often it ran, rows out, and time with its inputs."""

    windows: int = 0
    rows: int = 0
    nanoseconds: int = 0


@dataclass(slots=True)
class Profile:
    """The costs by operator. ``clock`` tells ns: nothing in this room reads one by itself."""

    clock: Callable[[], int]
    _costs: dict[int, Cost] = field(default_factory=dict)
    # An operator is told apart by its identity, so it is kept from being another's.
    _plans: list[Plan] = field(default_factory=list)

    def add(self, plan: Plan, rows: int, nanoseconds: int) -> None:
        """An operator has given ``rows``."""
        cost = self._costs.get(id(plan))
        if cost is None:
            cost = self._costs[id(plan)] = Cost()
            self._plans.append(plan)
        cost.windows += 1
        cost.rows += rows
        cost.nanoseconds += nanoseconds

    def note(self, plan: Plan) -> str:
        """What an operator has cost, for people; "" where it has not run by itself."""
        cost = self._costs.get(id(plan))
        if cost is None:
            return ""
        rows, microseconds = cost.rows / cost.windows, cost.nanoseconds / cost.windows / 1000
        times = "window" if cost.windows == 1 else "windows"
        return f"    [{cost.windows} {times}: {rows:,.1f} rows, {microseconds:,.0f} µs each]"
