"""A plan of trends as arrays: what two rows that follow each other must meet (SPEC §8).

Trends are not enumerated, so a condition may read two neighbours in a match at most: two successive
rows of a Kleene element (``a[i]`` and ``a[i-1]``), or the last row of an element and the first one
of the next.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..evaluation.conditions import START
from ..evaluation.packing import KEYS, PackedRows, is_own, padded
from ..plans.network import Network, variables_of
from ..plans.plan import (
    ColumnType,
    Condition,
    Constant,
    Key,
    Output,
    PatternPlan,
    PlanError,
    Position,
    Selection,
    Time,
    Value,
    elements_of,
    leaves_of,
)
from .run_packing import RunPacker, leaves_in

Integers = NDArray[np.int64]

# The conditions of an element (from, below): on a row after another one of the same element; on its
# first row, after the last one of the element before.
AFTER, AFTER_BELOW, ENTRY, ENTRY_BELOW = range(4)


@dataclass(frozen=True, slots=True)
class PackedTrends(PackedRows):
    """A plan of n elements as trends read it. Buffer e has the rows of element e by their keys."""

    keys: Integers
    """The words of element e's keys in row e."""
    steps: Integers
    """The conditions of each element."""
    accumulators: Integers
    """What is added up: element, word (-1: rows are counted), whether that has numbers. If
    an output is the start of the matches, the first has the starts of the first element."""
    kleene: int
    """The Kleene elements, as bits."""

    def is_free(self, plan: PatternPlan) -> bool:
        """Whether a row may follow each earlier one of its keys, of the elements that may stand
        there."""
        has_conditions = (self.steps[:, AFTER] < self.steps[:, ENTRY_BELOW]).any()
        return not (plan.has_intervals or has_conditions or (self.keys != self.keys[0]).any())


def pack_trends(plan: PatternPlan, network: Network, part: str | None = None) -> PackedTrends:
    """Pack a plan. ``part``: as for `pack_runs`.

    Raises `PlanError`: a condition reads rows that are not neighbours, an output reads others than
    the last one, something must not happen; `UnboundedRetention`.
    """
    if not plan.trends or plan.selection is not Selection.ANY_MATCH:
        raise PlanError("only aggregates over any match are evaluated as trends")
    if plan.probes or plan.hulls:
        probed = tuple(probe.what.name for probe in plan.probes)
        raise PlanError(
            f"aggregates over all matches know nothing of {', '.join(probed) or 'equal times'}",
            "list the matches, or select the next match",
        )
    for output in plan.outputs:
        _check_output(plan, output)
    return _TrendPacker(plan, network, part=part).packed_trends()


def accumulators(plan: PatternPlan) -> list[tuple[int, str | None]]:
    """What is added up for the trends: elements and columns, each once."""
    found = [(each.element, each.column) for each in plan.trends if each.element is not None]
    return list(dict.fromkeys(found))


@dataclass(slots=True)
class _TrendPacker(RunPacker):
    def packed_trends(self) -> PackedTrends:
        plan, count = self.plan, len(self.plan.elements)
        self.keys = self.run_keys()
        own = self._own_conditions()
        for e in range(count):
            self._buffer(e, self.keys[e])
        conditions = [*self.times(), *self._chained_equalities()]
        conditions += [
            each for each in plan.conditions if not any(is_own(plan, each, e) for e in range(count))
        ]
        after: list[list[Condition]] = [[] for _ in range(count)]
        entry: list[list[Condition]] = [[] for _ in range(count)]
        for condition in conditions:
            element, is_entry = _neighbours(plan, condition)
            (entry if is_entry else after)[element].append(condition)
        steps = [
            [*self.conditions.extend(after[e]), *self.conditions.extend(entry[e])]
            for e in range(count)
        ]
        added = [[0, START, 0]] if any(map(is_start, plan.outputs)) else []
        for element, column in accumulators(plan):
            is_number = column is not None and plan.type_of(column) is ColumnType.NUMBER
            added.append([element, -1 if column is None else self._places[column], int(is_number)])
        return PackedTrends(
            self.columns,
            self._kinds(),
            own,
            padded([self._buffer_row(*each) for each in self.buffers], KEYS),
            np.zeros((0, 0), np.int64),
            self.conditions.arrays(),
            np.array([[self._places[c] for c in row] for row in self.keys], np.int64).reshape(
                count, -1
            ),
            np.array(steps, np.int64),
            np.array(added, np.int64).reshape(-1, 3),
            sum(1 << e for e, each in enumerate(plan.elements) if each.is_kleene),
        )

    def _chained_equalities(self) -> list[Condition]:
        """The equal keys that rows are not looked up by, from neighbour to neighbour."""
        found = []
        for variable in variables_of(self.plan):
            columns = dict(reversed(variable))
            if self.is_looked_up(columns):
                continue
            elements = sorted(columns)
            for e in elements:
                own = Value(e, columns[e])
                if self.plan.elements[e].is_kleene:
                    before = Value(e, columns[e], Position.PREVIOUS)
                    found.append(Condition("=", own, before))
                if e != elements[-1]:
                    last = self._at(e, columns[e], Position.LAST)
                    after = next(each for each in elements if each > e)
                    found.append(
                        Condition("=", self._at(after, columns[after], Position.FIRST), last)
                    )
        return found

    def _at(self, element: int, column: str, position: Position) -> Value:
        is_kleene = self.plan.elements[element].is_kleene
        return Value(element, column, position if is_kleene else Position.EACH)


def _neighbours(plan: PatternPlan, condition: Condition) -> tuple[int, bool]:
    """The element whose row a condition is tested on; whether on its first row, after the element
    before."""
    elements = sorted(elements_of(condition))
    match elements:
        case [e]:
            is_entry = False
        case [first, e] if first + 1 == e:
            is_entry = True
        case _:
            raise _not_neighbours(plan, condition)
    for leaf in leaves_in(condition):
        match leaf:
            case Value(element, _, position):
                is_kleene = plan.elements[element].is_kleene
                if is_entry:
                    wanted = Position.LAST if element != e else Position.FIRST
                    fits = position is wanted if is_kleene else True
                else:
                    fits = position in (Position.EACH, Position.PREVIOUS)
            case Time(members, is_start):
                is_single = not any(plan.elements[x].is_kleene for x in members)
                is_edge = len(members) == 1 and is_start == (members[0] == e)
                fits = is_entry and (is_single or is_edge)
            case Constant() | Key():
                fits = True
            case _:
                fits = False
        if not fits:
            raise _not_neighbours(plan, condition)
    return e, is_entry


def _not_neighbours(plan: PatternPlan, condition: Condition) -> PlanError:
    elements = tuple(sorted(elements_of(condition)))
    names = " and ".join(plan.elements[e].name for e in elements) or "no event"
    return PlanError(
        f"aggregates over all matches test rows that follow each other: a condition on {names} "
        "reads others",
        "compare a[i] with a[i-1], or a[a.LEN] with the next event; or list the matches",
        elements,
    )


def _check_output(plan: PatternPlan, output: Output) -> None:
    """Outputs beside trends have the row that ends the matches, or the start of the earliest."""
    last = len(plan.elements) - 1
    if is_start(output):
        return
    for leaf in leaves_of(output.value):  # type: ignore[arg-type]
        match leaf:
            case Value(element, _, position):
                fits = element == last and (
                    position is Position.LAST or not plan.elements[last].is_kleene
                )
            case Time(elements, False):
                fits = last in elements
            case Constant() | Key():
                fits = True
            case _:
                fits = False
        if not fits:
            raise PlanError(
                f"{output.name} is no value of {plan.elements[last].name}, which ends the matches",
                "aggregate over the others",
            )


def is_start(output: Output) -> bool:
    """Whether an output is the start of the earliest match."""
    return isinstance(output.value, Time) and output.value.is_start and 0 in output.value.elements
