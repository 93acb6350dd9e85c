"""Why a match was recognized: the samples that are its events."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

Told: TypeAlias = str | int | float | bool | None
"""A value as samples have it."""


@dataclass(frozen=True, slots=True)
class MatchedEvent:
    """An event of a match: a sample of a stream, with its times (ns)."""

    event: str
    stream: str
    available: int
    valid: int
    values: Mapping[str, Told]


@dataclass(frozen=True, slots=True)
class ExplainedMatch:
    """A match with its times (ns) and results, and the events that it consists of, in order of the
    pattern."""

    available: int
    valid: int
    start: int
    end: int
    values: Mapping[str, Told]
    events: tuple[MatchedEvent, ...]


@dataclass(frozen=True, slots=True)
class PendingEvent:
    """An event that may still come, and the times (ns) between which; None: no bound."""

    event: str
    earliest: int
    latest: int | None


@dataclass(frozen=True, slots=True)
class PartialMatch:
    """Events that have come, by the pattern's names: their valid time (ns) and what the pattern
    reads of them; and the others."""

    events: tuple[tuple[str, int, Mapping[str, Told]], ...]
    pending: tuple[PendingEvent, ...]


@dataclass(frozen=True, slots=True)
class PartialMatches:
    """Partial matches at a watermark (ns), the newest first. ``more``: there may be others."""

    watermark: int
    partial: tuple[PartialMatch, ...]
    more: bool
