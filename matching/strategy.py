"""Strategies to choose one of the possible plans ([Introspection15 §4.3], SPEC §7)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum


class UnknownStrategy(ValueError):
    """A text that is no strategy."""


class Kind(StrEnum):
    """The aim of a strategy."""

    FAST = "fast"
    """The first valid plan, depth first."""
    COST = "cost"
    """The plan with the least total cost: shared units count once, running units nothing."""
    QUALITY = "quality"
    """The plan with the best information quality."""
    WEIGHTED = "weighted"
    """The plan with the least sum, over its units, of weighted cost and lost quality."""


@dataclass(frozen=True, slots=True)
class Strategy:
    """``cost`` and ``quality`` weigh a unit's cost and what it lacks to perfect quality.

    ``subscribers`` is the cost of each reader that a stream has already: with it, a stream that
    many read is avoided ([Introspection15 §4.3]).
    """

    kind: Kind = Kind.FAST
    cost: float = 1.0
    quality: float = 0.0
    subscribers: float = 0.0

    @classmethod
    def parse(cls, text: str) -> Strategy:
        """``fast``, ``cost``, ``cost:subscribers=0.1``, ``quality``,
        ``weighted:cost=1,quality=10``. Raises `UnknownStrategy`.
        """
        name, _, rest = text.partition(":")
        if name not in list(Kind):
            raise UnknownStrategy(f"there is no strategy {name!r}; there is: {', '.join(Kind)}")
        kind = Kind(name)
        allowed = {
            Kind.COST: {"subscribers"},
            Kind.WEIGHTED: {"cost", "quality", "subscribers"},
        }.get(kind, set())
        weights = {"quality": 1.0} if kind is Kind.WEIGHTED else {}
        for part in rest.split(",") if rest else ():
            key, _, value = (piece.strip() for piece in part.partition("="))
            if key not in allowed:
                known = ", ".join(sorted(allowed)) or "none"
                raise UnknownStrategy(f"{name} has no parameter {key!r}; it has: {known}")
            weights[key] = _weight(key, value)
        return cls(kind, **weights)

    def __str__(self) -> str:
        """The text that `parse` reads."""
        match self.kind:
            case Kind.COST if self.subscribers:
                return f"cost:subscribers={self.subscribers:g}"
            case Kind.WEIGHTED:
                text = f"weighted:cost={self.cost:g},quality={self.quality:g}"
                return text + (f",subscribers={self.subscribers:g}" if self.subscribers else "")
            case _:
                return str(self.kind)

    def weight(self, cost: float, quality: float) -> float:
        """The weight of one more unit or stream of this cost and quality."""
        return self.cost * cost + self.quality * (1.0 - quality)


def _weight(key: str, value: str) -> float:
    try:
        weight = float(value)
    except ValueError:
        weight = math.nan
    if not 0 <= weight < math.inf:
        raise UnknownStrategy(f"{key} is a number, 0 or more, not {value!r}")
    return weight
