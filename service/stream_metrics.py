"""Metrics of each stream and unit, in the text format of Prometheus.

There may be tens of thousands of streams: lines are written straight from the counters, and after
some of them everybody else gets a turn. Cost: about 10 µs a stream.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Final

from ..engine.engine import Engine
from ..engine.unit import ComputationalUnit
from ..streams.generator import StreamGenerator
from ..streams.time import SECOND

SLICE = 200
"""So many streams are written before the event loop looks at anything else."""
_LINES = 10_000
_FATES: Final = ("accepted", "used", "late", "duplicate", "expired")
_STREAMS: Final = (
    ("dyknow_samples_total", "counter", "Samples by fate"),
    ("dyknow_samples_pending", "gauge", "Samples held back within the lateness"),
    ("dyknow_samples_kept", "gauge", "Samples in history"),
    ("dyknow_subscribers", "gauge", "Subscriptions served"),
    ("dyknow_stream_lag_seconds", "gauge", "How long ago the last sample became available"),
    ("dyknow_stream_watermark_lag_seconds", "gauge", "How far behind the clock the watermark is"),
)
_UNITS: Final = (
    ("dyknow_unit_busy_seconds_total", "counter", "Time that the unit has worked"),
    ("dyknow_unit_windows_total", "counter", "Windows that the unit has evaluated"),
)


async def stream_metrics(engine: Engine, now: int) -> bytes:
    """All families of streams and units at the time ``now`` (ns)."""
    streams: list[list[str]] = [[] for _ in _STREAMS]
    for i, generator in enumerate(engine.generators(), start=1):
        _add_stream(streams, generator, now)
        if i % SLICE == 0:
            await asyncio.sleep(0)
    units: list[list[str]] = [[] for _ in _UNITS]
    for i, unit in enumerate(engine.units(), start=1):
        _add_unit(units, unit)
        if i % SLICE == 0:
            await asyncio.sleep(0)
    return await _text(_STREAMS, streams) + await _text(_UNITS, units)


def _add_stream(families: list[list[str]], generator: StreamGenerator, now: int) -> None:
    samples, pending, kept, subscribers, lag, watermark_lag = families
    stream = f'stream="{escaped(generator.name)}"}}'
    label = f"{{{stream}"
    counters = generator.counters
    for fate in _FATES:
        samples.append(f'{{fate="{fate}",{stream} {getattr(counters, fate)}.0')
    pending.append(f"{label} {counters.pending}.0")
    kept.append(f"{label} {len(generator.stream)}.0")
    subscribers.append(f"{label} {generator.subscribers}.0")
    # An end is no delay.
    last = generator.stream.last_available
    if last is not None and not generator.is_ended:
        lag.append(f"{label} {(now - last) / SECOND}")
    if generator.watermark is not None and not generator.is_ended:
        watermark_lag.append(f"{label} {(now - generator.watermark) / SECOND}")


def _add_unit(families: list[list[str]], unit: ComputationalUnit) -> None:
    busy, windows = families
    label = f'{{stream="{escaped(unit.output.name)}",'
    label += f'transformation="{escaped(unit.transformation)}",unit="{unit.name}"}}'
    busy.append(f"{label} {unit.busy / SECOND}")
    windows.append(f"{label} {unit.windows}.0")


async def _text(names: Sequence[tuple[str, str, str]], families: list[list[str]]) -> bytes:
    parts = []
    for (name, kind, text), lines in zip(names, families, strict=True):
        parts.append(f"# HELP {name} {text}\n# TYPE {name} {kind}\n".encode())
        for first in range(0, len(lines), _LINES):
            part = lines[first : first + _LINES]
            parts.append("".join([f"{name}{line}\n" for line in part]).encode())
            await asyncio.sleep(0)
    return b"".join(parts)


def escaped(value: str) -> str:
    """A label's value as the text format has it."""
    return value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
