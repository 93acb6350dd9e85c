"""The arithmetic of windows ([Events14 §III], SPEC §5): grids of ends, and no state.

Inside this room content is always half-open on the left, ``(low, high]``: times are integers, so
``[e - RANGE, e)`` is ``(e - RANGE - 1, e - 1]`` (`Schedule.shift` is -1 then).
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
    """A window over one input: what it is, the grid of its ends (None where each evaluation is
    one), and the graph that its triples are in (DEFAULT, or the IRI that RSP-QL gives it).

    ``low`` is the bound below which a landmark window holds nothing. ``range`` is None of a window
    that lasts: its content stays until other content comes, however much later. ``counted``: a
    number of triples makes the window, not time.
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
        return self.range is None

    def bounds(self, end: int) -> tuple[int, int]:
        """``(low, high]`` of the latest window of this input at the evaluation ``end``.

        Of a window that counts: of what may be in it.
        """
        grid = self.grid
        high = end if grid is None else grid.floor(end)
        return (self.low if self.range is None else high - self.range), high


@dataclass(frozen=True, slots=True)
class Schedule:
    """When a query is evaluated, over what of each input.

    ``ends``: the grid of evaluations (shifted by ``shift``); None: whenever a window that counts
    has moved on. ``windows``: by input, in order. ``pane``: the greatest length that divides every
    range, step and period, so that each bound of a window of time is the end of a pane (0 without
    one).
    """

    ends: Grid | None
    windows: tuple[InputWindow, ...]
    shift: int
    pane: int

    @property
    def uniform(self) -> bool:
        """Whether all inputs have one window of time that is evaluated at each of its ends, in one
        graph."""
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
        """The evaluation after ``end``, on the grid."""
        return end + (1 if self.ends is None else self.ends.step)

    def first_end(self, window: InputWindow, time: int) -> int:
        """The first evaluation that could see an element of ``window`` at ``time``."""
        own = time if window.grid is None else window.grid.ceil(time)
        return own if self.ends is None else self.ends.ceil(own)


def schedule(query: ContinuousQuery, inputs: Sequence[str], options: Options) -> Schedule:
    """The schedule of ``query`` over ``inputs``.

    An input that FROM STREAM clauses name (by IRI or stream name) has their windows; any other has
    the query's WINDOW (or, if there is none, the first clause's). The query is evaluated each
    COMPUTE EVERY, but not more often than the least STEP of its windows of time; where it has
    neither, whenever a window that counts has moved on. Raises ``ValueError`` when there is no
    window at all.
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
            low = start - 1
    counted = isinstance(window, CountWindow)
    return InputWindow(input, graph, window, None if counted else grid, low, range, counted)
