"""What a match answers: the supply, and the transformation tree that was looked through.

[Introspection15 §4.3]: "every node represents a transformation or computational unit instance
and edges correspond to features". Here a node is an `Alternative`, and says what became of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from .plan import Supply
from .want import Want


class Outcome(StrEnum):
    """What became of an alternative."""

    CHOSEN = "chosen"
    POSSIBLE = "possible"
    FAILED = "failed"
    UNTRIED = "not tried"


@dataclass(frozen=True, slots=True)
class Alternative:
    """One way to get a feature. ``parts`` say, for one that failed, what it lacked."""

    text: str
    outcome: Outcome
    reason: str = ""
    parts: tuple[Alternative, ...] = ()


@dataclass(frozen=True, slots=True)
class Match:
    """The answer to a want.

    ``supply`` is None where nothing gives the feature; ``missing`` then says what would have to
    be there. ``tree`` are the alternatives for the wanted feature, in the order of trying.
    ``proven``: the strategy's optimum was found and proven (always so with *fast*, which looks
    for the first plan).
    """

    want: Want
    strategy: str
    supply: Supply | None
    tree: tuple[Alternative, ...]
    missing: tuple[str, ...]
    proven: bool = True
