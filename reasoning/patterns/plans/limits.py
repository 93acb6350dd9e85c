"""How much an evaluation of a pattern may keep, and what it counts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Limits:
    """How much an evaluation may keep. What exceeds a limit is left out and counted (`Counters`).

    ``rows`` kept; ``candidates``: rows kept for one element and key; ``matches`` that one row
    completes; ``waiting`` matches; ``runs``: matches that have begun, for the strategies that
    select the next row.
    """

    rows: int = 10_000_000
    candidates: int = 1_000_000
    matches: int = 1_000_000
    waiting: int = 1_000_000
    runs: int = 1_000_000


DEFAULT_LIMITS: Final = Limits()


@dataclass(frozen=True, slots=True)
class Counters:
    """What an evaluation has done. The last seven are losses.

    ``rows`` taken, ``candidates`` looked at, ``matches`` made, before their last probes;
    ``late`` rows, behind the watermark; ``unstored`` rows beyond the limit of rows, ``crowded``
    ones beyond that of candidates; ``cut_short``: rows that complete more matches than the limit;
    ``unawaited`` matches, beyond the limit of those that wait; ``unstarted`` runs beyond theirs.
    ``rounded``: numbers that are no 64-bit integers.
    """

    rows: int
    candidates: int
    matches: int
    late: int
    unstored: int
    crowded: int
    cut_short: int
    unawaited: int
    unstarted: int
    rounded: int
