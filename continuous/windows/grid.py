"""The arithmetic of windows ([Events14 §III], SPEC §5): grids of ends, without state.

In this folder content is always half-open on the left, ``(low, high]``. Times are integers, so
``[e - RANGE, e)`` is ``(e - RANGE - 1, e - 1]``; `Schedule.shift` is then -1. One convention saves
a second form of every comparison.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import gcd

from ...languages.csparql.ast import (
    ContinuousQuery,
    CountWindow,
    LandmarkWindow,
    TimeWindow,
    Window,
)
from ...languages.csparql.body import stream_iri
from ...streams.time import TIME_MAX
from ..algebra.options import Options
from ..algebra.plan import DEFAULT


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
    """A window over one input, the grid of its ends (None for a counting window: each evaluation is
    an end), and the graph that has its triples (DEFAULT, or the window's IRI in RSP-QL).

    ``low``: a landmark window contains nothing up to here. ``range`` is None if the window
    `lasts`: its content stays until other content comes, however much later. ``counted``: the
    window has a number of triples, not a length of time.
    """

    input: str
    graph: str
    window: Window
    grid: Grid | None
    low: int
    range: int | None
    counted: bool

    @property
    def lasts(self) -> bool:
        """Whether its content has no fixed duration: a landmark or counting window."""
        return self.range is None

    def bounds(self, end: int) -> tuple[int, int]:
        """Return ``(low, high]`` of this input's latest window at the evaluation ``end``; for a
        counting window, the bounds of all rows that it may contain."""
        grid = self.grid
        # Between two of its ends a window shows the content at the earlier one.
        high = end if grid is None else grid.floor(end)
        return (self.low if self.range is None else high - self.range), high


@dataclass(frozen=True, slots=True)
class Schedule:
    """When a query is evaluated, and over which windows.

    ``ends``: the grid of evaluations (shifted by ``shift``); None: an evaluation at each move of a
    counting window. ``windows``: by input, in order. ``pane``: the greatest length that divides
    every range, step and period. Each bound of a time window is therefore the end of a pane (0:
    there is no time window).
    """

    ends: Grid | None
    windows: tuple[InputWindow, ...]
    shift: int
    pane: int

    @property
    def uniform(self) -> bool:
        """Whether all inputs have the same time window in the same graph, evaluated at each of its
        ends."""
        first = self.windows[0]
        return isinstance(first.window, TimeWindow) and all(
            (one.window, one.grid, one.graph) == (first.window, self.ends, first.graph)
            for one in self.windows
        )

    @property
    def named(self) -> tuple[str, ...]:
        """The graphs that are windows."""
        return tuple(dict.fromkeys(one.graph for one in self.windows if one.graph != DEFAULT))

    def after(self, end: int) -> int:
        """Return the evaluation after ``end``, on the grid."""
        return end + (1 if self.ends is None else self.ends.step)

    def first_end(self, window: InputWindow, time: int) -> int:
        """Return the first evaluation whose ``window`` could contain a row at ``time``."""
        own = time if window.grid is None else window.grid.ceil(time)
        return own if self.ends is None else self.ends.ceil(own)


def schedule(query: ContinuousQuery, inputs: Sequence[str], options: Options) -> Schedule:
    """Return the schedule of ``query`` over ``inputs``.

    An input that FROM STREAM clauses name (by IRI or stream name) has their windows; any other has
    the query's WINDOW (or else the first clause's). The query is evaluated each COMPUTE EVERY, but
    not more often than the least STEP of its time windows; without either, at each move of a
    counting window. Raises ``ValueError`` if there is no window at all.
    """
    default = query.window or next((clause.window for clause in query.streams), None)
    chosen: list[tuple[str, str, Window]] = []
    for name in inputs or ("",):
        clauses = [c for c in query.streams if c.iri in (name, stream_iri(name))]
        if not clauses and default is None:
            raise ValueError(f"no window for stream {name!r}: write FROM STREAM … [RANGE … STEP …]")
        if not clauses:
            assert default is not None
            chosen.append((name, DEFAULT, default))
        chosen += [(name, clause.name or DEFAULT, clause.window) for clause in clauses]
    shift = -1 if options.bounds == "[)" else 0
    origin = options.origin + shift
    steps = [window.step for _, _, window in chosen if not isinstance(window, CountWindow)]
    period = max(query.every or 0, min(steps, default=0))
    ends = Grid(period, origin) if period else None
    ranges = [window.range for _, _, window in chosen if isinstance(window, TimeWindow)]
    pane = gcd(period, *steps, *ranges)
    windows = tuple(_window(*one, origin) for one in chosen)
    return Schedule(ends, windows, shift, pane)


def _window(input: str, graph: str, window: Window, origin: int) -> InputWindow:
    low, range = -TIME_MAX, None
    grid = Grid(window.step, origin)
    match window:
        case TimeWindow():
            range = window.range
        case LandmarkWindow(start) if start is not None:
            # Content is open on the left, and a landmark window includes its start.
            low = start - 1
    counted = isinstance(window, CountWindow)
    return InputWindow(input, graph, window, None if counted else grid, low, range, counted)
