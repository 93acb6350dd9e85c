"""The result of a match: the supply, and the transformation tree that was searched.

[Introspection15 §4.3]: "every node represents a transformation or computational unit instance
and edges correspond to features". Here a node is an `Alternative` with its outcome.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from .plan import Supply
from .want import Want


class Outcome(StrEnum):
    """The outcome of an alternative."""

    CHOSEN = "chosen"
    POSSIBLE = "possible"
    FAILED = "failed"
    UNTRIED = "not tried"


@dataclass(frozen=True, slots=True)
class Alternative:
    """One way to get a feature: ``stream``, or a transformation. The ``parts`` of a failed one are
    the things that it lacked."""

    text: str
    outcome: Outcome
    reason: str = ""
    parts: tuple[Alternative, ...] = ()
    stream: str | None = None


@dataclass(frozen=True, slots=True)
class Match:
    """The answer to a want.

    ``supply`` is None where nothing gives the feature; ``missing`` then lists the reasons at the
    leaves of the tree. ``tree`` has the alternatives for the feature, in the order of trying.
    ``proven``: the strategy's optimum was found and proven (always so with *fast*, which looks for
    the first plan).
    """

    want: Want
    strategy: str
    supply: Supply | None
    tree: tuple[Alternative, ...]
    missing: tuple[str, ...]
    proven: bool = True

    @property
    def lacks(self) -> tuple[str, ...]:
        """The reasons of ``missing`` after what was wanted, at least one; none with a supply."""
        if self.supply is not None:
            return ()
        reasons = self.missing or ("no stream or transformation provides it",)
        return tuple(f"{self.want}: {reason}" for reason in reasons)
