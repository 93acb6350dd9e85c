"""A plan without repetition as arrays, which the compiled join reads as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..plans.network import INFINITE, Network, variables_of
from ..plans.plan import (
    OWN,
    Aggregate,
    Arithmetic,
    Bound,
    Condition,
    Constant,
    CountProbe,
    Expression,
    Listed,
    PatternPlan,
    PlanError,
    Position,
    Probe,
    Same,
    Selection,
    StateProbe,
    Time,
    Value,
    elements_of,
    leaves_of,
)
from .conditions import COLUMNS, ConditionArrays, ConditionPacker

Integers = NDArray[np.int64]

# A buffer: the element or, from n on, the probe whose rows it holds; for how long; whether the last
# row before that stays, too; the number of its keys, and their words.
OF, RETAINED, KEEPS_LAST, KEY_COUNT, KEYS = range(5)
# A level of the join: its element, buffer, conditions (from, below), whether all rows in the window
# are matches, whether its row may be one that is bound, then keys as in a probe.
ELEMENT, BUFFER, CONDITION, BELOW, IS_WHOLE, MAY_REPEAT = range(6)
LEVEL_KEYS: Final = 6
# A probe: its buffer, whether it asks the state, the times (element, whether its start, offset),
# the counts, the conditions, then keys: element and word of each.
PROBED, ASKS_STATE, LOW, LOW_START, LOW_OFFSET, HIGH, HIGH_START, HIGH_OFFSET = range(8)
LEAST, MOST, PROBE_CONDITION, PROBE_BELOW = range(8, 12)
PROBE_KEYS: Final = 12
# Settings of a plan as a whole.
COUNT, HAS_INTERVALS, IS_DISTINCT, IS_ORDERED, MOST_MATCHES, MOST_CANDIDATES, PART_WORD = range(7)
SETTINGS: Final = 7


@dataclass(frozen=True, slots=True)
class PackedRows:
    """What each evaluation reads of a plan of n elements."""

    columns: tuple[str, ...]
    """The columns that are read, in the order of their words in a record."""
    kinds: Integers
    """For each source: the elements, and from bit n on the probes, that read it."""
    own: Integers
    """The own conditions of element or probe e are ``own[e] .. own[e + 1] - 1``."""
    buffers: Integers
    probes: Integers
    conditions: ConditionArrays

    @property
    def width(self) -> int:
        """The number of words in a record."""
        return COLUMNS + len(self.columns)


@dataclass(frozen=True, slots=True)
class PackedPlan(PackedRows):
    """A plan of n elements as the join reads it."""

    triggers: Integers
    levels: Integers
    """Level l of trigger g in row ``g n + l``; level 0 is the trigger."""
    greatest: Integers
    hulls: Integers
    """The elements of both sides, as bits."""
    is_sorted: bool
    """Whether the join makes the matches of a row in order of the plan's elements."""


@dataclass(slots=True)
class Packer:
    """Packs what each evaluation reads of a plan."""

    plan: PatternPlan
    network: Network
    conditions: ConditionPacker = field(init=False)
    columns: tuple[str, ...] = field(init=False)
    buffers: dict[tuple[int, tuple[str, ...]], int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.columns = columns_read(self.plan)
        self.conditions = ConditionPacker(self.plan, self._places)

    @property
    def _places(self) -> dict[str, int]:
        return {name: COLUMNS + i for i, name in enumerate(self.columns)}

    def _kinds(self) -> Integers:
        read = [*self.plan.elements, *(probe.what for probe in self.plan.probes)]
        masks = [
            sum(1 << i for i, each in enumerate(read) if kind in each.kinds)
            for kind in self.plan.kinds()
        ]
        return np.array(masks, np.int64)

    def _own_conditions(self) -> Integers:
        """The conditions that a row meets or not by itself: also those of the plan on one element,
        and equal keys of one."""
        starts = [0]
        for i, element in enumerate(self.plan.elements):
            self.conditions.extend(element.conditions)
            alone = [each for each in self.plan.conditions if is_own(self.plan, each, i)]
            self.conditions.extend(_owned(each, i) for each in alone)
            for variable in variables_of(self.plan):
                own = [column for e, column in variable if e == i]
                known = own[:1] if self._is_compared(i, variable) else []
                # A key must equal itself: a missing one does not.
                self.conditions.extend(
                    Condition("=", Value(OWN, own[0]), Value(OWN, each))
                    for each in own[len(known) :]
                )
            starts.append(len(self.conditions))
        for probe in self.plan.probes:
            self.conditions.extend(probe.what.conditions)
            starts.append(len(self.conditions))
        return np.array(starts, np.int64)

    def _is_compared(self, element: int, variable: tuple[tuple[int, str], ...]) -> bool:
        """Whether the first key of a variable in an element is known to be there."""
        return len(variable) > 1

    def _probe(self, number: int, probe: Probe) -> list[int]:
        buffer = self._buffer(
            len(self.plan.elements) + number, tuple(each.first_column for each in probe.same)
        )
        keys = self._keys(probe.same)
        match probe:
            case CountProbe(_, low, high, least, most, _, conditions):
                counts = [least, INFINITE if most is None else most]
                times = [*self._time(low), *self._time(high)]
                return [buffer, 0, *times, *counts, *self.conditions.extend(conditions), *keys]
            case StateProbe(_, at, _, state):
                times = self._time(at) * 2
                return [buffer, 1, *times, 0, 0, *self.conditions.extend(state), *keys]

    def _time(self, bound: Bound) -> list[int]:
        point = bound.point
        slot = self.conditions.slot_at(point.element, is_start=point.is_start)
        return [slot, int(point.is_start), bound.offset]

    def _keys(self, same: tuple[Same, ...]) -> list[int]:
        """The bound row and the word of the keys that are looked up."""
        return [
            x
            for each in same
            for x in (
                self.conditions.slot(each.second, Position.FIRST),
                self._places[each.second_column],
            )
        ]

    def _buffer(self, of: int, keys: tuple[str, ...]) -> int:
        return self.buffers.setdefault((of, keys), len(self.buffers))

    def _buffer_row(self, of: int, keys: tuple[str, ...]) -> list[int]:
        words = [self._places[key] for key in keys]
        if of < len(self.plan.elements):
            return [of, self.network.retention[of], 0, len(words), *words]
        probe = self.plan.probes[of - len(self.plan.elements)]
        keeps_last = int(isinstance(probe, StateProbe))
        return [of, self.network.probe_retention(probe), keeps_last, len(words), *words]


def pack(plan: PatternPlan, network: Network, *, is_ordered: bool) -> PackedPlan:
    """Pack a plan.

    Raises `PlanError`: a plan with repetition or another strategy than any match has no join,
    probes need rows in order; `UnboundedRetention`.
    """
    if plan.trends or plan.selection is not Selection.ANY_MATCH:
        raise PlanError(f"{plan.selection} is evaluated by runs, and trends by products")
    if any(each.is_kleene for each in plan.elements):
        raise PlanError("a pattern with repetition is not evaluated by a join")
    if plan.probes and not is_ordered:
        raise PlanError("what did not happen is only known of rows in order of their ends")
    return _JoinPacker(plan, network, is_ordered=is_ordered).packed()


@dataclass(slots=True)
class _JoinPacker(Packer):
    is_ordered: bool = True

    def packed(self) -> PackedPlan:
        plan, network = self.plan, self.network
        count = len(plan.elements)
        own = self._own_conditions()
        triggers = network.triggers(is_ordered=self.is_ordered)
        orders = [[e, *(each.element for each in network.join_order(e))] for e in triggers]
        levels = [level for e in triggers for level in self._levels(e)]
        probes = [self._probe(i, probe) for i, probe in enumerate(plan.probes)]
        hulls = [[sum(1 << e for e in set(side)) for side in (h.left, h.right)] for h in plan.hulls]
        return PackedPlan(
            self.columns,
            self._kinds(),
            own,
            padded([self._buffer_row(*each) for each in self.buffers], KEYS),
            padded(probes, PROBE_KEYS),
            self.conditions.arrays(),
            np.array(triggers, np.int64),
            padded(levels, LEVEL_KEYS),
            np.array(network.greatest, np.int64).reshape(2 * count, 2 * count),
            np.array(hulls, np.int64).reshape(-1, 2),
            len(triggers) == 1 and orders[0][1:] == sorted(orders[0][1:]),
        )

    def _levels(self, trigger: int) -> list[list[int]]:
        first = self.conditions.extend(
            each for each in self.plan.conditions if not elements_of(each)
        )
        rows, bound = [[trigger, 0, *first, 0, 0]], [trigger]
        order = self.network.join_order(trigger)
        for level in order:
            e = level.element
            known = {e, *bound}
            from_, below = self.conditions.extend(
                each
                for each in self.plan.conditions
                if e in elements_of(each) <= known and elements_of(each) != {e}
            )
            may_repeat = any(self._may_be_one(e, b) for b in bound)
            is_free = not (self.plan.probes or self.plan.hulls or self.plan.has_intervals)
            is_whole = is_free and from_ == below and not may_repeat and level is order[-1]
            buffer = self._buffer(e, tuple(each.first_column for each in level.keys))
            keys = self._keys(level.keys)
            rows.append([e, buffer, from_, below, int(is_whole), int(may_repeat), *keys])
            bound.append(e)
        return rows

    def _may_be_one(self, a: int, b: int) -> bool:
        """Whether one row may suit both elements, by its source and its end."""
        d = self.network.greatest
        share = set(self.plan.elements[a].kinds) & set(self.plan.elements[b].kinds)
        return bool(share) and d[a][b] >= 0 and d[b][a] >= 0


def columns_read(plan: PatternPlan) -> tuple[str, ...]:
    """The columns that a plan reads, in its order."""
    found = set(plan.partition)
    read = [*plan.elements, *(probe.what for probe in plan.probes)]
    conditions = [*plan.conditions, *(each for element in read for each in element.conditions)]
    same = list(plan.same)
    for probe in plan.probes:
        same.extend(probe.same)
        conditions.extend(probe.conditions if isinstance(probe, CountProbe) else probe.state)
    for equal in same:
        found.update((equal.first_column, equal.second_column))
    sides: list[Expression] = [side for each in conditions for side in (each.left, each.right)]
    for output in plan.outputs:
        if isinstance(output.value, Listed):
            found.add(output.value.column)
        else:
            sides.append(output.value)
    for side in sides:
        for leaf in leaves_of(side):
            if isinstance(leaf, Value | Aggregate) and leaf.column is not None:
                found.add(leaf.column)
    found.update(each.column for each in plan.trends if each.column is not None)
    return tuple(each.name for each in plan.columns if each.name in found)


def is_own(plan: PatternPlan, condition: Condition, element: int) -> bool:
    """Whether each row of an element meets a condition or not by itself."""
    if elements_of(condition) != {element}:
        return False
    return not plan.elements[element].is_kleene or all(
        isinstance(leaf, Constant) or (isinstance(leaf, Value) and leaf.position is Position.EACH)
        for side in (condition.left, condition.right)
        for leaf in leaves_of(side)
    )


def _owned(condition: Condition, element: int) -> Condition:
    """A condition on one element as one on its own row."""
    return Condition(
        condition.operator, _own(condition.left, element), _own(condition.right, element)
    )


def _own(expression: Expression, element: int) -> Expression:
    match expression:
        case Value(_, column, position):
            return Value(OWN, column, position)
        case Time(_, is_start):
            return Time((OWN,), is_start)
        case Arithmetic(operator, left, right):
            return Arithmetic(operator, _own(left, element), _own(right, element))
        case _:
            return expression


def padded(rows: list[list[int]], least: int) -> Integers:
    """Rows of different lengths as an array of two dimensions and of a width of ``least``."""
    width = max([least, *(len(row) for row in rows)])
    return np.array([row + [0] * (width - len(row)) for row in rows], np.int64).reshape(-1, width)


def kind_codes(kinds: tuple[str, ...], known: Mapping[str, int]) -> Integers:
    """The numbers of sources in the plan, -1 for one that it does not read."""
    return np.array([known.get(kind, -1) for kind in kinds], np.int64)
