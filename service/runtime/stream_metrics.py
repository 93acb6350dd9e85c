"""Metrics of each stream and unit, in the text format of Prometheus.

There may be tens of thousands of streams: this module writes lines directly from the counters, and
yields to other requests after some of them. The oldest `most` streams and units have lines of their
own; all others have common lines with empty labels. Cost: about 10 µs a stream.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Sequence
from typing import Final, TypeAlias

from ...engine.engine import Engine
from ...engine.units.base import ComputationalUnit
from ...streams.generator import StreamGenerator
from ...streams.time import SECOND

SLICE = 200
"""Streams that are written before the event loop gets a turn."""
_LINES = 10_000
Families: TypeAlias = tuple[tuple[str, str, str, tuple[str, ...]], ...]
"""Name, type and text of metrics, and the labels that distinguish several values of one."""
_STREAMS: Final[Families] = (
    (
        "dyknow_samples_total",
        "counter",
        "Samples by fate",
        tuple(f'fate="{each}",' for each in ("accepted", "used", "late", "duplicate", "expired")),
    ),
    (
        "dyknow_batches_ahead_total",
        "counter",
        "Batches refused, as a sample was stamped too far ahead of the clock",
        ("",),
    ),
    ("dyknow_samples_pending", "gauge", "Samples held back within the lateness", ("",)),
    ("dyknow_samples_kept", "gauge", "Samples in history", ("",)),
    ("dyknow_subscribers", "gauge", "Subscriptions served", ("",)),
    ("dyknow_stream_lag_seconds", "gauge", "How long ago the last sample became available", ("",)),
    (
        "dyknow_stream_watermark_lag_seconds",
        "gauge",
        "How far behind the clock the watermark is",
        ("",),
    ),
)
_UNITS: Final[Families] = (
    ("dyknow_unit_busy_seconds_total", "counter", "Time that the unit has worked", ("",)),
    ("dyknow_unit_windows_total", "counter", "Windows that the unit has evaluated", ("",)),
    (
        "dyknow_unit_overruns_total",
        "counter",
        "Windows without a result, because they needed more than they may",
        ("",),
    ),
    ("dyknow_unit_late_samples_total", "counter", "Samples that came too late for the unit", ("",)),
    ("dyknow_unit_errors_total", "counter", "Errors of the unit", ("",)),
    ("dyknow_unit_lag_seconds", "gauge", "How far behind its inputs the unit is", ("",)),
    (
        "dyknow_unit_failed",
        "gauge",
        "Whether the unit was cut off, and why",
        ('reason="error",', 'reason="quarantined",'),
    ),
)
_FAILED: Final = ((None, None), (1, None), (None, 1))
"""The values of ``dyknow_unit_failed`` by reason: without failure, for an error, a quarantine."""
Values: TypeAlias = Sequence[float | None]
"""One value a line, in the order of the families; None: no line."""


class StreamMetrics:
    """The metrics of the streams and units of ``engine``, ``most`` of each in own lines."""

    def __init__(self, engine: Engine, most: int) -> None:
        self._engine = engine
        self._streams = _Lines(_STREAMS, most)
        self._units = _Lines(_UNITS, most)

    async def text(self, now: int) -> bytes:
        """The text of all families of streams and units at the time ``now`` (ns)."""
        generators = self._engine.generators()
        streams = (
            (f'stream="{escaped(each.name)}"', _stream_values(each, now)) for each in generators
        )
        told = await self._streams.text(streams, 'stream=""')
        units = ((_unit_label(each), _unit_values(each)) for each in self._engine.units())
        return told + await self._units.text(units, 'stream="",transformation="",unit=""')


def _stream_values(generator: StreamGenerator, now: int) -> Values:
    counters, stream = generator.counters, generator.stream
    # A stream that has ended has no lag.
    last = None if generator.is_ended else stream.last_available
    watermark = None if generator.is_ended else generator.watermark
    return (
        counters.accepted,
        counters.used,
        counters.late,
        counters.duplicate,
        counters.expired,
        counters.ahead,
        counters.pending,
        len(stream),
        generator.subscribers,
        None if last is None else (now - last) / SECOND,
        None if watermark is None else (now - watermark) / SECOND,
    )


def _unit_label(unit: ComputationalUnit) -> str:
    return (
        f'stream="{escaped(unit.output.name)}",'
        f'transformation="{escaped(unit.transformation)}",unit="{escaped(unit.name)}"'
    )


def _unit_values(unit: ComputationalUnit) -> Values:
    lag = None if unit.failure is not None else unit.lag
    failed = 0 if unit.failure is None else 2 if unit.is_quarantined else 1
    return (
        unit.busy / SECOND,
        unit.windows,
        unit.overruns,
        unit.late,
        unit.counters.errors,
        None if lag is None else lag / SECOND,
        *_FAILED[failed],
    )


class _Lines:
    """The lines of some families: of ``most`` things their own, of the others common ones."""

    def __init__(self, families: Families, most: int) -> None:
        self._families = families
        self._most = most
        self._kinds = [kind for _, kind, _, labels in families for _ in labels]
        self._is_lag = ["_lag_" in name for name, _, _, labels in families for _ in labels]
        self._counted: list[float] = [0.0] * len(self._kinds)
        """The counters in the common lines, which never decrease."""
        self._before: list[float] = [0.0] * len(self._kinds)
        """The sums of these counters at the last scrape."""
        self._summing = asyncio.Lock()
        """One scrape sums at a time: if an earlier scrape ended later, its older sums would make
        the next one count an increase twice."""

    async def text(self, things: Iterable[tuple[str, Values]], others: str) -> bytes:
        async with self._summing:
            lines = await self._found(things, others)
        return await self._written(lines)

    async def _found(self, things: Iterable[tuple[str, Values]], others: str) -> list[list[str]]:
        """The lines of each kind of value, without the metric's name."""
        lines: list[list[str]] = [[] for _ in self._kinds]
        further: list[float | None] = [None] * len(self._kinds)
        for i, (label, values) in enumerate(things):
            if i < self._most:
                for line, value in zip(lines, values, strict=True):
                    line.append("" if value is None else f"{label}}} {float(value)}")
            else:
                self._add(further, values)
            if i % SLICE == SLICE - 1:
                await asyncio.sleep(0)
        self._count(further)
        for line, value in zip(lines, further, strict=True):
            if value is not None:
                line.append(f"{others}}} {float(value)}")
        return lines

    def _add(self, further: list[float | None], values: Values) -> None:
        for i, value in enumerate(values):
            if value is not None:
                known = further[i]
                if known is None:
                    further[i] = value
                else:
                    further[i] = max(known, value) if self._is_lag[i] else known + value

    def _count(self, further: list[float | None]) -> None:
        """Keep the counters of common lines from decreasing when a thing is removed, which would
        look like a restart: each grows by the increase of the sum since the last scrape."""
        for i, kind in enumerate(self._kinds):
            if kind == "counter":
                found = further[i] or 0.0
                self._counted[i] += max(0.0, found - self._before[i])
                self._before[i] = found
                further[i] = self._counted[i] if self._counted[i] or found else further[i]

    async def _written(self, lines: list[list[str]]) -> bytes:
        parts, i = [], 0
        for name, kind, text, labels in self._families:
            parts.append(f"# HELP {name} {text}\n# TYPE {name} {kind}\n".encode())
            for own in labels:
                prefix, found = f"{name}{{{own}", lines[i]
                for first in range(0, len(found), _LINES):
                    part = found[first : first + _LINES]
                    parts.append("".join([f"{prefix}{line}\n" for line in part if line]).encode())
                    await asyncio.sleep(0)
                i += 1
        return b"".join(parts)


def escaped(value: str) -> str:
    """A label's value as the text format has it."""
    return value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
