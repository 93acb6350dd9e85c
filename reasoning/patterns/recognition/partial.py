"""Partial matches: which events have come, and when each of the others may still come (SPEC §8).

Under any match they are not kept: they are enumerated from the rows of an evaluator on demand. The
strategies that select the next row keep them, as runs.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from ....streams.time import TIME_MAX, TIME_MIN
from ..plans.network import INFINITE, Network
from ..plans.plan import OWN, CountProbe, PatternPlan, Point, elements_of
from ..plans.row_values import Bound, Number, Row, are_same, holds, time_of

MOST_STEPS: Final = 100_000
"""Rows tried for one answer."""


@dataclass(frozen=True, slots=True)
class Pending:
    """An event that has not come, and the times (ns) between which it may; None: no bound."""

    element: int
    earliest: int
    latest: int | None


@dataclass(frozen=True, slots=True)
class Partial:
    """A partial match: the rows of the events that have come, each with its element, and the
    others. Of a Kleene element it has the first row, and the last one if that is another."""

    rows: tuple[tuple[int, Row], ...]
    pending: tuple[Pending, ...]

    @property
    def last(self) -> int:
        """The time (ns) of the last event."""
        return max(row.end for _, row in self.rows)

    def keys(self, columns: Collection[str]) -> set[Number | None]:
        """The keys in these columns of its rows."""
        return {row.values.get(column) for _, row in self.rows for column in columns}


@dataclass(frozen=True, slots=True)
class Wanted:
    """All these ``keys`` are wanted, each in one of these ``columns`` of a row."""

    keys: frozenset[int | None] = frozenset()
    columns: tuple[str, ...] = ()


NOTHING: Final = Wanted()
"""Nothing in particular: all partial matches."""


@dataclass(frozen=True, slots=True)
class Partials:
    """Partial matches, the newest first. ``has_more``: there are or may be others."""

    found: tuple[Partial, ...]
    has_more: bool


def partial_matches(
    network: Network,
    rows: Sequence[Sequence[Row]],
    now: int,
    limit: int,
    wanted: Wanted = NOTHING,
) -> Partials:
    """Return the partial matches of a plan without repetition at the watermark ``now`` (ns).

    A set of rows for some of its elements is one if they meet what the plan says of them, and if
    each of the others may still come: not before ``now``. ``rows`` are those of each element, then
    of each probe.

    Cost: exponential in the elements, at most `MOST_STEPS` rows.
    """
    search = _Search(network, rows, now)
    found = newest(search.partials(), limit, wanted)
    return Partials(found.found, found.has_more or search.is_over)


def partial_runs(
    network: Network,
    runs: Iterable[Sequence[tuple[Row, Row]]],
    now: int,
    limit: int,
    wanted: Wanted = NOTHING,
) -> Partials:
    """Return the partial matches among ``runs`` at the watermark ``now`` (ns): those that have not
    lasted too long. ``runs`` have the first and the last row of each element that they have bound.
    ``wanted`` as for `partial_matches`. Probes are not asked: they are of whole matches.

    Cost: O(runs)."""
    found = (_of_run(network, run, now) for run in runs)
    return newest((each for each in found if each is not None), limit, wanted)


def _of_run(network: Network, run: Sequence[tuple[Row, Row]], now: int) -> Partial | None:
    """The partial match of a run; None if the next event cannot come any more."""
    plan, state = network.plan, len(run) - 1
    times = {}
    for element, (first, last) in enumerate(run):
        start = first.start if plan.has_intervals else first.end
        times[network.variable(Point(element, True))] = start
        times[network.variable(Point(element))] = last.end
    low_only = network.variable(Point(state)) if plan.elements[state].is_kleene else None
    pending = []
    for element in range(state + 1, len(plan.elements)):
        # Of a Kleene element the first row: it ends after it begins, and before the last one ends.
        is_kleene = plan.elements[element].is_kleene
        low, _ = _window(network, network.variable(Point(element, is_kleene)), times)
        latest = network.variable(Point(element, is_kleene and not plan.has_intervals))
        # A repeated part that goes on moves the bounds that begin with its last row.
        _, high = _window(network, latest, {v: t for v, t in times.items() if v != low_only})
        if high < now:
            return None
        pending.append(Pending(element, max(low, now), None if high == TIME_MAX else high))
    rows = []
    for element, (first, last) in enumerate(run):
        rows.append((element, first))
        if last.number != first.number:
            rows.append((element, last))
    return Partial(tuple(rows), tuple(pending))


def newest(found: Iterable[Partial], limit: int, wanted: Wanted) -> Partials:
    """Return the wanted ones, at most ``limit``, the newest first."""
    chosen = [each for each in found if each.keys(wanted.columns) >= wanted.keys]
    chosen.sort(key=lambda each: (-each.last, -len(each.rows)))
    return Partials(tuple(chosen[:limit]), len(chosen) > limit)


def _window(network: Network, own: int, times: Mapping[int, int]) -> tuple[int, int]:
    """The least and the greatest time of a variable by those of others."""
    greatest = network.greatest
    low, high = TIME_MIN, TIME_MAX
    for number, time in times.items():
        if greatest[own][number] < INFINITE:
            low = max(low, time - greatest[own][number])
        if greatest[number][own] < INFINITE:
            high = min(high, time + greatest[number][own])
    return low, high


class _Search:
    def __init__(self, network: Network, rows: Sequence[Sequence[Row]], now: int) -> None:
        self._network = network
        self._plan: PatternPlan = network.plan
        compared: list[set[str]] = [set() for _ in rows]
        for same in self._plan.same:
            compared[same.first].add(same.first_column)
            compared[same.second].add(same.second_column)
        self._rows = [
            sorted(
                # A missing key equals none: such a row is of no match.
                (row for row in each if all(row.values[key] is not None for key in keys)),
                key=lambda row: (-row.end, -row.number),
            )
            for each, keys in zip(rows, compared, strict=True)
        ]
        self._now = now
        self._steps = 0

    @property
    def is_over(self) -> bool:
        """Whether the search ended for want of steps."""
        return self._steps >= MOST_STEPS

    def partials(self) -> Iterator[Partial]:
        return self._from(0, {})

    def _from(self, element: int, bound: Bound) -> Iterator[Partial]:
        """The partial matches with these rows for the elements before ``element``."""
        if element == len(self._plan.elements):
            if 0 < len(bound) < element and (pending := self._pending(bound)) is not None:
                yield Partial(tuple(sorted(bound.items())), pending)
            return
        yield from self._from(element + 1, bound)
        for row in self._rows[element]:
            if self.is_over:
                return
            self._steps += 1
            extended = {**bound, element: row}
            if self._fits(element, extended):
                yield from self._from(element + 1, extended)

    def _fits(self, element: int, bound: Bound) -> bool:
        """Whether the row of an element fits the others."""
        plan, row = self._plan, bound[element]
        if plan.is_distinct and any(
            e != element and other.number == row.number for e, other in bound.items()
        ):
            return False
        low, high = self._window(Point(element), bound)
        first, last = self._window(Point(element, True), bound)
        start = time_of(plan, Point(element, True), bound)
        if not (low <= row.end <= high and first <= start <= last):
            return False
        return all(
            are_same(each, bound)
            for each in plan.same
            if {each.first, each.second} <= bound.keys() and element in (each.first, each.second)
        ) and all(
            holds(plan, each, bound)
            for each in plan.conditions
            if element in elements_of(each) <= bound.keys()
        )

    def _window(self, point: Point, bound: Bound) -> tuple[int, int]:
        """The least and the greatest time of a point by those of the bound rows."""
        points = (p for element in bound for p in (Point(element), Point(element, True)))
        times = {self._network.variable(p): time_of(self._plan, p, bound) for p in points}
        return _window(self._network, self._network.variable(point), times)

    def _pending(self, bound: Bound) -> tuple[Pending, ...] | None:
        """The windows of the other elements; None if one of them cannot come any more, or a probe
        is violated whatever comes."""
        found = []
        for element in range(len(self._plan.elements)):
            if element in bound:
                continue
            low, high = self._window(Point(element), bound)
            if high < self._now:
                return None
            found.append(Pending(element, max(low, self._now), None if high == TIME_MAX else high))
        for number, probe in enumerate(self._plan.probes, len(self._plan.elements)):
            if isinstance(probe, CountProbe) and self._is_exceeded(number, probe, bound):
                return None
        return tuple(found)

    def _is_exceeded(self, number: int, probe: CountProbe, bound: Bound) -> bool:
        """Whether more rows have come than a probe allows, whatever else comes."""
        if probe.most is None or probe.low.point.element not in bound:
            return False
        low = time_of(self._plan, probe.low.point, bound) + probe.low.offset
        least, _ = self._window(probe.high.point, bound)
        if probe.high.point.element not in bound:
            least = max(least, self._now)
        high = least + probe.high.offset
        count = 0
        for row in self._rows[number]:
            whole = {**bound, OWN: row}
            count += (
                low <= row.end <= high
                and all(each.second in bound and are_same(each, whole) for each in probe.same)
                and all(
                    elements_of(each) <= whole.keys() and holds(self._plan, each, whole)
                    for each in probe.conditions
                )
            )
        return count > probe.most
