"""What the times of a plan imply: its simple temporal network, and the plan of the join (SPEC §8).

The variables of the network are the ends of the elements, ``0 … n-1``, and their starts,
``n … 2n-1``. The *minimal network* has for each pair the greatest difference that the constraints
allow (Dechter, Meiri and Pearl 1991). It tells which element may come last, how long rows are kept,
and between which times the rows of one element are searched when others are bound.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from .plan import (
    Bound,
    CountProbe,
    PatternPlan,
    PlanError,
    Point,
    Probe,
    Same,
    StateProbe,
)

INFINITE: Final = 1 << 60
"""No bound: some 36 years, as no duration may be longer."""


class ContradictoryTimes(PlanError):
    """The times of some events contradict each other: a cycle of constraints is negative."""


class UnboundedRetention(PlanError):
    """Rows would be kept for ever."""


@dataclass(frozen=True)
class Network:
    """The minimal network of a plan. ``greatest[a][b]``: the greatest ``variable_b - variable_a``,
    or `INFINITE`."""

    plan: PatternPlan
    greatest: tuple[tuple[int, ...], ...]

    @property
    def count(self) -> int:
        """The number of elements."""
        return len(self.plan.elements)

    def variable(self, point: Point) -> int:
        """The number of a point's variable."""
        return point.element + (self.count if point.is_start else 0)

    def reach(self, variable: int) -> int:
        """How much later than a variable the last event of a match may end."""
        return max(self.greatest[variable][: self.count])

    @cached_property
    def span(self) -> int:
        """How much later than the first end in a match the last one may be."""
        return max(map(self.reach, range(self.count)))

    @cached_property
    def retention(self) -> tuple[int, ...]:
        """For how long after its end a row of each element may still be joined, in ns.

        Raises `UnboundedRetention` with the element.
        """
        found = []
        for i, element in enumerate(self.plan.elements):
            reach = self.reach(i + self.count if element.is_kleene else i)
            if reach >= INFINITE:
                raise UnboundedRetention(
                    f"each {element.name} would be kept for ever, as the others may come at any "
                    "time after it",
                    f"bound the time from {element.name} to the others, or write WITHIN",
                    (i,),
                )
            found.append(reach)
        return tuple(found)

    def probe_retention(self, probe: Probe) -> int:
        """For how long after its end a row that a probe reads may still count, in ns. A match asks
        all its probes when the last of them can be answered.

        Raises `UnboundedRetention` with the element from which the probe counts.
        """
        low = probe.low if isinstance(probe, CountProbe) else probe.at
        row = self.greatest[self.variable(low.point)]
        ends = [
            row[self.variable(high.point)] + high.offset for high in map(_high, self.plan.probes)
        ]
        reach = max([self.reach(self.variable(low.point)), *ends])
        if reach >= INFINITE:
            element = low.point.element
            name = self.plan.elements[element].name
            raise UnboundedRetention(
                f"the rows of {probe.what.name} would be kept for ever, as {name} may have begun "
                "at any time before",
                f"bound how long {name} lasts, or write WITHIN",
                (element,),
            )
        return max(reach - low.offset, 0)

    @property
    def longest_wait(self) -> int:
        """How long after its last event a match may wait for its probes, in ns; at most 0: it never
        waits."""
        return max(
            (
                self.greatest[trigger][self.variable(high.point)] + high.offset + 1
                for trigger in self.triggers()
                for high in map(_high, self.plan.probes)
            ),
            default=0,
        )

    def triggers(self, *, is_ordered: bool = True) -> tuple[int, ...]:
        """The elements whose row may be the last of a match to come. ``is_ordered``: rows come in
        order of their ends."""
        return tuple(
            e
            for e in range(self.count)
            if not is_ordered or all(self.greatest[j][e] >= 0 for j in range(self.count))
        )

    def join_order(self, trigger: int) -> tuple[Level, ...]:
        """The other elements, in the order in which their rows are searched once ``trigger`` is
        bound: those that share a variable with what is bound first, then those of the narrowest
        window, then in order of the plan."""
        bound, levels = [trigger], []
        while len(bound) < self.count:
            left = [j for j in range(self.count) if j not in bound]
            best = min(left, key=lambda j: (not self._shared(j, bound), self._width(j, bound), j))
            levels.append(Level(best, self._shared(best, bound)))
            bound.append(best)
        return tuple(levels)

    def _width(self, element: int, bound: list[int]) -> int:
        """The narrowest window of the element's end, from one bound element."""
        d = self.greatest
        return min(min(d[b][element] + d[element][b], INFINITE) for b in bound)

    @cached_property
    def _variables(self) -> tuple[tuple[tuple[int, str], ...], ...]:
        return variables_of(self.plan)

    def _shared(self, element: int, bound: list[int]) -> tuple[Same, ...]:
        """One equality for each variable that the element shares with the bound ones: equality is
        transitive, so further ones say nothing new."""
        found = []
        for variable in self._variables:
            own = [column for j, column in variable if j == element]
            other = [(b, column) for b, column in variable if b in bound]
            if own and other:
                found.append(Same(element, own[0], *other[0]))
        return tuple(found)


@dataclass(frozen=True, slots=True)
class Level:
    """A step of the join: rows of ``element`` are looked up by these keys, of which ``second`` is
    bound before."""

    element: int
    keys: tuple[Same, ...]


def minimal_network(plan: PatternPlan) -> Network:
    """Compute the minimal network by Floyd and Warshall's algorithm.

    Raises `ContradictoryTimes` with the events on a negative cycle. Cost: O(n³) for n elements,
    some milliseconds for 16.
    """
    size = 2 * len(plan.elements)
    greatest = [[0 if a == b else INFINITE for b in range(size)] for a in range(size)]
    step = [list(range(size)) for _ in range(size)]
    """The first variable on the way of least weight from a to b."""
    for a, b, weight in _constraints(plan):
        greatest[a][b] = min(greatest[a][b], weight)
    bad = next((a for a in range(size) if greatest[a][a] < 0), None)
    if bad is not None:
        raise _contradiction(plan, [bad])
    for k in range(size):
        through = greatest[k]
        for a in range(size):
            first, row = greatest[a][k], greatest[a]
            if first >= INFINITE:
                continue
            for b in range(size):
                if through[b] < INFINITE and first + through[b] < row[b]:
                    row[b] = first + through[b]
                    step[a][b] = step[a][k]
            if row[a] < 0:
                raise _contradiction(plan, _way(step, a, k) + _way(step, k, a))
    return Network(plan, tuple(map(tuple, greatest)))


def variables_of(plan: PatternPlan) -> tuple[tuple[tuple[int, str], ...], ...]:
    """The shared variables: each the key columns ``(element, column)`` that must be equal, in
    order; they are in order of their first column."""
    classes: dict[tuple[int, str], set[tuple[int, str]]] = {}
    for each in plan.same:
        first, second = (each.first, each.first_column), (each.second, each.second_column)
        joined = classes.get(first, {first}) | classes.get(second, {second})
        classes.update(dict.fromkeys(joined, joined))
    found = {tuple(sorted(members)) for members in classes.values()}
    return tuple(sorted(found))


def _constraints(plan: PatternPlan) -> Iterable[tuple[int, int, int]]:
    """``(a, b, w)`` for ``variable_b - variable_a <= w``."""
    count = len(plan.elements)

    def number(point: Point) -> int:
        return point.element + (count if point.is_start else 0)

    for i, element in enumerate(plan.elements):
        yield i, count + i, 0
        if not (plan.has_intervals or element.is_kleene):
            yield count + i, i, 0
    for each in plan.between:
        first, second = number(each.first), number(each.second)
        if each.most is not None:
            yield first, second, _within_range(plan, each.most, each.first, each.second)
        if each.least is not None:
            yield second, first, -_within_range(plan, each.least, each.first, each.second)
    if plan.within is not None:
        _within_range(plan, plan.within)
        for i in range(count):
            for j in range(count):
                yield count + i, j, plan.within


def _within_range(plan: PatternPlan, duration: int, *points: Point) -> int:
    if abs(duration) >= INFINITE:
        raise PlanError(
            f"a duration of {duration} ns is longer than 36 years",
            "leave the bound out",
            tuple(point.element for point in points),
        )
    return duration


def _high(probe: Probe) -> Bound:
    """The time from which on a probe is decided."""
    return probe.at if isinstance(probe, StateProbe) else probe.high


def _way(step: list[list[int]], a: int, b: int) -> list[int]:
    """The variables on the way from a to b, without b."""
    found = [a]
    while (a := step[a][b]) != b:
        found.append(a)
    return found


def _contradiction(plan: PatternPlan, variables: list[int]) -> ContradictoryTimes:
    count = len(plan.elements)
    elements = tuple(sorted({each % count for each in variables}))
    names = [plan.elements[i].name for i in elements]
    if len(names) == 1:
        message = f"the times of {names[0]} contradict themselves"
    else:
        message = f"the times of {', '.join(names[:-1])} and {names[-1]} contradict each other"
    return ContradictoryTimes(message, "no match can meet all bounds: widen one of them", elements)
