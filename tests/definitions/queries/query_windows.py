"""Windows, reports and stream operators by their definition (docs/explanation/semantics.md, SPEC
§5).

An evaluation is an end and what each window holds then. Elements are told apart by identity.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count, pairwise
from math import inf
from typing import Any


@dataclass(frozen=True)
class Time:
    """``(end - range, end]`` or ``[end - range, end)``, at multiples of ``step``."""

    range: int
    step: int


@dataclass(frozen=True)
class Count:
    """The last ``size`` elements, moving with each ``step``-th."""

    size: int
    step: int


@dataclass(frozen=True)
class Landmark:
    """Everything from ``start`` on (None: from the beginning), at multiples of ``step``."""

    start: int | None
    step: int


@dataclass(frozen=True)
class Clause:
    """A window on a stream; ``name`` is that of a named window."""

    stream: str
    window: Time | Count | Landmark
    name: Any = None


@dataclass(frozen=True)
class Evaluation:
    """``contents``: the elements of each clause. ``active``: "non-empty" reports it."""

    end: int
    contents: tuple[tuple, ...]
    active: bool

    @property
    def key(self) -> tuple:
        return tuple(tuple(map(id, content)) for content in self.contents)


Streams = Mapping[str, Sequence[Any]]
EMPTY = Evaluation(-(10**9), (), False)


def evaluations(
    clauses: Sequence[Clause], streams: Streams, every: int | None, origin: int, bounds: str
) -> list[Evaluation]:
    """All in order: from the first with content to one after the last that can differ."""
    steps = [c.window.step for c in clauses if not isinstance(c.window, Count)]
    if not steps and every is None:
        return by_moves(clauses, streams, 0 if bounds == "(]" else 1)
    period = max(every or 0, min(steps, default=0))
    return list(on_grid(clauses, streams, period, origin, bounds))


def on_grid(
    clauses: Sequence[Clause], streams: Streams, period: int, origin: int, bounds: str
) -> Iterator[Evaluation]:
    times = [element.time for clause in clauses for element in streams[clause.stream]]
    if not times:
        return
    longest = max([c.window.range for c in clauses if isinstance(c.window, Time)], default=0)
    most = max([period, *(c.window.step for c in clauses)])
    last = max(times) + longest + 3 * most
    begun = False
    before: tuple[tuple, ...] = tuple(() for _ in clauses)
    for k in count((min(times) - origin) // period - 1):
        end = origin + k * period
        if end > last:
            return
        contents = tuple(content(c.window, streams[c.stream], end, origin, bounds) for c in clauses)
        active = any(
            bool(now) if isinstance(c.window, Time) else fresh(now, then)
            for c, now, then in zip(clauses, contents, before, strict=True)
        )
        begun = begun or active
        if begun:
            yield Evaluation(end, contents, active)
        before = contents


def fresh(now: tuple, then: tuple) -> bool:
    """Whether a window that lasts has got something since."""
    return bool({id(e) for e in now} - {id(e) for e in then})


def content(window: Any, elements: Sequence[Any], end: int, origin: int, bounds: str) -> tuple:
    """What the window holds at ``end``, or at its last own end before."""
    match window:
        case Count(size, step):
            come = [e for e in elements if has_come(e.time, end, bounds)]
            moved = len(come) // step * step
            return tuple(come[max(moved - size, 0) : moved])
        case Time(range, step):
            own = origin + (end - origin) // step * step
            if bounds == "(]":
                return tuple(e for e in elements if own - range < e.time <= own)
            return tuple(e for e in elements if own - range <= e.time < own)
        case Landmark(start, step):
            own = origin + (end - origin) // step * step
            first = -inf if start is None else start
            return tuple(e for e in elements if first <= e.time and has_come(e.time, own, bounds))
    raise TypeError(window)


def has_come(time: int, end: int, bounds: str) -> bool:
    """Whether an end lets an element of this time in."""
    return time <= end if bounds == "(]" else time < end


def by_moves(clauses: Sequence[Clause], streams: Streams, shift: int) -> list[Evaluation]:
    """Only windows of a count: an evaluation for each move of each.

    Moves of one time go input by input, in the order of the clauses.
    Its end is the time of the element that moved it; one later where ends are exclusive.
    """
    inputs = list(streams)
    moves = [
        (streams[c.stream][at - 1].time, inputs.index(c.stream), place, at)
        for place, c in enumerate(clauses)
        for at in range(c.window.step, len(streams[c.stream]) + 1, c.window.step)
    ]
    contents: list[tuple] = [() for _ in clauses]
    found = []
    for time, _, place, at in sorted(moves):
        clause = clauses[place]
        contents[place] = tuple(streams[clause.stream][max(at - clause.window.size, 0) : at])
        found.append(Evaluation(time + shift, tuple(contents), True))
    return found


def reported(found: Sequence[Evaluation], report: str, passed: float = -inf) -> list[bool]:
    """Which of them give a result. ``passed``: ends before it had closed when the input ended, so
    that "close" gives them, though nothing came any more."""
    active = [k for k, evaluation in enumerate(found) if evaluation.active]
    if report == "non-empty" or not active:
        return [evaluation.active for evaluation in found]
    if report == "close":
        ends = [evaluation.end for evaluation in found]
        return [active[0] <= k and (k <= active[-1] or end < passed) for k, end in enumerate(ends)]
    nothing = tuple(() for _ in found[0].contents)
    keys = [nothing, *(evaluation.key for evaluation in found)]
    return [now != then for then, now in pairwise(keys)]


def operated(operator: str, results: Sequence[Any], wanted: Sequence[bool]) -> Iterator[tuple]:
    """``(place, what of the result goes on)`` of RSTREAM, ISTREAM, DSTREAM; results are Counters.

    A difference of bags. The result before the first evaluation is empty.
    """
    before: Counter = Counter()
    for place, (now, report) in enumerate(zip(results, wanted, strict=True)):
        if operator == "RSTREAM":
            if report:
                yield place, now
        else:
            difference = now - before if operator == "ISTREAM" else before - now
            if report or difference:
                yield place, difference
        before = now
