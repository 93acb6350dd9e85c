"""The arithmetic of windows ([Events14 §III], SPEC §5): grids of ends, and no state.

Inside this room content is always half-open on the left, ``(low, high]``: times are integers, so
``[e - RANGE, e)`` is ``(e - RANGE - 1, e - 1]`` (`Grid.shift` is -1 then).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import gcd

from ..languages.csparql.ast import ContinuousQuery, TimeWindow
from ..languages.csparql.body import stream_iri
from .options import Options


@dataclass(frozen=True, slots=True)
class Grid:
    """The multiples ``origin + k * step``."""

    step: int
    origin: int

    def floor(self, time: int) -> int:
        """The greatest point ≤ ``time``."""
        return time - (time - self.origin) % self.step

    def ceil(self, time: int) -> int:
        """The least point ≥ ``time``."""
        return time + (self.origin - time) % self.step


@dataclass(frozen=True, slots=True)
class InputWindow:
    """The window over one input: its RANGE and the grid of its ends (shifted, see above)."""

    range: int
    grid: Grid

    def bounds(self, end: int) -> tuple[int, int]:
        """``(low, high]`` of the latest window of this input at the evaluation ``end``."""
        high = self.grid.floor(end)
        return high - self.range, high


@dataclass(frozen=True, slots=True)
class Schedule:
    """When a query is evaluated, over what of each input.

    ``ends``: the grid of evaluations (shifted by ``shift``), ``inputs`` a window an input in order,
    ``pane`` the greatest length that divides every range and step.
    """

    ends: Grid
    inputs: tuple[InputWindow, ...]
    shift: int
    pane: int

    @property
    def uniform(self) -> bool:
        """Whether all inputs have one window that is evaluated at each of its ends."""
        first = self.inputs[0]
        return all(window == first for window in self.inputs) and first.grid == self.ends

    def first_end(self, input: int, time: int) -> int:
        """The first evaluation that could see an element of ``input`` at ``time``."""
        return self.ends.ceil(self.inputs[input].grid.ceil(time))


def schedule(query: ContinuousQuery, inputs: tuple[str, ...], options: Options) -> Schedule:
    """The schedule of ``query`` over ``inputs``.

    An input that a FROM STREAM clause names (by IRI or stream name) has its window; any other has
    the query's WINDOW (or, if there is none, the first clause's). The query is evaluated each
    COMPUTE EVERY, but not more often than its least STEP. Raises ``ValueError`` when there is no
    window at all.
    """
    clauses = {clause.iri: clause.window for clause in query.streams}
    default = query.window or next(iter(clauses.values()), None)
    windows = [clauses.get(name) or clauses.get(stream_iri(name), default) for name in inputs]
    windows = windows or [default]
    shift = -1 if options.bounds == "[)" else 0
    origin = options.origin + shift
    checked: list[TimeWindow] = []
    for name, window in zip(inputs or ("",), windows, strict=True):
        if window is None:
            raise ValueError(f"no window for stream {name!r}: write FROM STREAM … [RANGE … STEP …]")
        checked.append(window)
    period = max(query.every or 0, min(window.step for window in checked))
    pane = period
    for window in checked:
        pane = gcd(pane, window.range, window.step)
    return Schedule(
        Grid(period, origin),
        tuple(InputWindow(window.range, Grid(window.step, origin)) for window in checked),
        shift,
        pane,
    )
