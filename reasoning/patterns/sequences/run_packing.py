"""A plan for runs as arrays: what a row must meet to be taken, and when that is settled (SPEC §8).

A run binds the elements in order. A condition is tested as soon as all that it reads is settled:

- on each row of its last element; with ``a[i-1]`` or ``avg(a[..i-1].x)`` from the second row on;
- if it reads the whole of its last element (``a[a.LEN]``, ``avg(a[].x)``, the end of a Kleene
  element) when that is complete: when a row of the next element comes, or the match ends.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, TypeGuard

import numpy as np
from numpy.typing import NDArray

from ..evaluation.conditions import COLUMNS, ConditionPacker
from ..evaluation.packing import (
    KEYS,
    PROBE_KEYS,
    PackedRows,
    Packer,
    is_own,
    padded,
)
from ..plans.network import Network, minimal_network, variables_of
from ..plans.plan import (
    OWN,
    Aggregate,
    Arithmetic,
    Between,
    ColumnType,
    Condition,
    Constant,
    CountProbe,
    Expression,
    Function,
    Listed,
    PatternPlan,
    PlanError,
    Point,
    Position,
    Selection,
    Time,
    Value,
    elements_of,
    leaves_of,
)

Integers = NDArray[np.int64]

# The conditions of an element (from, below): on each row, from the second row on, on the whole.
EACH, EACH_BELOW, REPEATED, REPEATED_BELOW, WHOLE, WHOLE_BELOW = range(6)
# An accumulator: its element, its column (-1: it counts rows), whether that has numbers. In a run
# it has four words: how many values, their sum, the least, the greatest.
OF_ELEMENT, OF_COLUMN, OF_NUMBERS = range(3)
WORDS: Final = 4
# An aggregate: its accumulator and its function's place in `FUNCTIONS`.
ACCUMULATOR, FUNCTION = range(2)
FUNCTIONS: Final = (Function.COUNT, Function.SUM, Function.MIN, Function.MAX, Function.AVG)


@dataclass(frozen=True, slots=True)
class PackedRuns(PackedRows):
    """A plan of n elements as runs read it."""

    keys: Integers
    """The words of element e's keys in row e. Runs are looked up by these."""
    steps: Integers
    """The conditions of each element."""
    each: Integers
    """For each condition the Kleene elements each row of which must meet it, as bits."""
    accumulators: Integers
    aggregates: Integers
    """In the order of their words in the row of aggregates."""
    kleene: int
    """The Kleene elements, as bits."""
    listed: int
    """The Kleene elements all rows of which are kept, as bits."""
    is_sorted: bool
    """Whether runs make the matches of a row in order of their rows."""

    @property
    def width(self) -> int:
        """The number of words in a record, and in the row of aggregates."""
        return max(COLUMNS + len(self.columns), len(self.aggregates))


def sequence_network(plan: PatternPlan) -> Network:
    """Return the minimal network of a plan whose elements follow each other.

    Raises `ContradictoryTimes`, `UnboundedRetention`.
    """
    count = len(plan.elements)
    order = tuple(Between(Point(i), Point(i + 1, True), 1) for i in range(count - 1))
    network = minimal_network(
        PatternPlan(
            plan.columns,
            plan.elements,
            (*plan.between, *order),
            probes=plan.probes,
            within=plan.within,
            has_intervals=plan.has_intervals,
            max_matches=1,
        )
    )
    _ = network.retention
    return network


def pack_runs(plan: PatternPlan, network: Network, part: str | None = None) -> PackedRuns:
    """Pack a plan. Under any match buffer e has the rows of element e, by their keys. ``part``: a
    column by which runs are looked up, too.

    Raises `PlanError`: a condition reads ``a[i]`` where no row is meant; `UnboundedRetention`.
    """
    if plan.trends:
        raise PlanError("aggregates over all matches are evaluated as trends")
    if plan.hulls:
        raise PlanError("events that follow each other do not last for the same time")
    _check_rows(plan)
    return RunPacker(plan, network, part=part).packed_runs()


@dataclass(slots=True)
class RunPacker(Packer):
    """Packs a plan whose elements follow each other."""

    part: str | None = None
    each: list[int] = field(default_factory=list)
    keys: list[tuple[str, ...]] = field(init=False)

    def packed_runs(self) -> PackedRuns:
        plan = self.plan
        keys = self.keys = self.run_keys()
        own = self._own_conditions()
        is_any = plan.selection is Selection.ANY_MATCH
        if is_any:
            for e in range(len(plan.elements)):
                self._buffer(e, keys[e])
        self.each = [0] * len(self.conditions)
        conditions = [*self.times(), *self._equalities()]
        conditions += [
            each
            for each in plan.conditions
            if not any(is_own(plan, each, e) for e in range(len(plan.elements)))
        ]
        steps = [self._step(e, conditions) for e in range(len(plan.elements))]
        probes = [self._probe(i, probe) for i, probe in enumerate(plan.probes)]
        for output in plan.outputs:
            if not isinstance(output.value, Listed):
                for leaf in leaves_of(output.value):
                    if isinstance(leaf, Aggregate):
                        self.conditions.aggregate(leaf)
        accumulators, aggregates = _accumulators(self.conditions)
        kleene = sum(1 << e for e, each in enumerate(plan.elements) if each.is_kleene)
        listed = {o.value.element for o in plan.outputs if isinstance(o.value, Listed)}
        bits = sum(1 << e for e in listed)
        for each in self.each:
            bits |= each
        self.each += [0] * (len(self.conditions) - len(self.each))
        return PackedRuns(
            self.columns,
            self._kinds(),
            own,
            padded([self._buffer_row(*each) for each in self.buffers], KEYS),
            padded(probes, PROBE_KEYS),
            self.conditions.arrays(),
            np.array([[self._places[c] for c in row] for row in keys], np.int64).reshape(
                len(keys), -1
            ),
            np.array(steps, np.int64),
            np.array(self.each, np.int64),
            accumulators,
            aggregates,
            kleene,
            # Equal first and last rows leave the order of matches to the nodes.
            kleene if is_any else bits,
            is_sorted=not (kleene or conditions),
        )

    def _step(self, element: int, conditions: list[Condition]) -> list[int]:
        """The conditions that are settled with an element."""
        settled = [c for c in conditions if max(elements_of(c), default=0) == element]
        whole = [c for c in settled if reads_whole(self.plan, c, element)]
        repeated = [c for c in settled if c not in whole and reads_before(c)]
        each = [c for c in settled if c not in whole and c not in repeated]
        found: list[int] = []
        for group, taken in ((each, element), (repeated, element), (whole, -1)):
            found += self.conditions.extend(group)
            self.each += [
                self._each_of(condition) & ~(1 << taken if taken >= 0 else 0) for condition in group
            ]
        return found

    def _each_of(self, condition: Condition) -> int:
        """The Kleene elements of which a condition reads each row, as bits."""
        found = 0
        for leaf in leaves_in(condition):
            if isinstance(leaf, Value) and leaf.position is Position.EACH:
                found |= int(self.plan.elements[leaf.element].is_kleene) << leaf.element
        return found

    def run_keys(self) -> list[tuple[str, ...]]:
        """For each element the columns that runs are looked up by: under next match the variables
        that each element has."""
        count = len(self.plan.elements)
        match self.plan.selection:
            case Selection.PARTITION_CONTIGUITY:
                return [self.plan.partition] * count
            case Selection.STRICT_CONTIGUITY:
                return [()] * count
        found: list[list[str]] = [[] for _ in range(count)]
        for variable in variables_of(self.plan):
            first = dict(reversed(variable))
            if len(first) == count:
                for e in range(count):
                    found[e].append(first[e])
        if self.part is not None:
            # A single element has it equal with no other one.
            found = [[*(c for c in each if c != self.part), self.part] for each in found]
        return [tuple(each) for each in found]

    def times(self) -> list[Condition]:
        """The bounds on times that do not follow from the order of the elements."""
        found = []
        for each in self.plan.between:
            first, second = each.first, each.second
            is_implied = first.element < second.element and not first.is_start
            later = Time((second.element,), second.is_start)
            earlier = Time((first.element,), first.is_start)
            if each.least is not None and not (is_implied and each.least <= 1):
                low = Arithmetic("+", earlier, Constant(each.least))
                found.append(Condition(">=", later, low))
            if each.most is not None:
                high = Arithmetic("+", earlier, Constant(each.most))
                found.append(Condition("<=", later, high))
        return found

    def _is_compared(self, element: int, variable: tuple[tuple[int, str], ...]) -> bool:
        return dict(reversed(variable)).get(element) in self.keys[element]

    def _equalities(self) -> list[Condition]:
        """The equal keys that runs are not looked up by: of each element with the first one, and of
        the rows of a Kleene element with its first."""
        found = []
        for variable in variables_of(self.plan):
            columns = dict(reversed(variable))
            if self.is_looked_up(columns):
                continue
            leader = min(columns)
            other = Value(leader, columns[leader], Position.FIRST)
            for element, column in sorted(columns.items()):
                if element != leader or self.plan.elements[element].is_kleene:
                    found.append(Condition("=", Value(element, column), other))
        return found

    def is_looked_up(self, columns: dict[int, str]) -> bool:
        """Whether all rows of a run agree in a variable with these columns."""
        places = {
            self.keys[e].index(columns[e]) if columns.get(e) in self.keys[e] else -1
            for e in range(len(self.keys))
        }
        return len(places) == 1 and -1 not in places


def reads_whole(plan: PatternPlan, condition: Condition, element: int) -> bool:
    """Whether a condition reads what is settled only when a Kleene element is complete."""
    if element not in elements_of(condition) or not plan.elements[element].is_kleene:
        return False
    for leaf in leaves_in(condition):
        match leaf:
            case Value(e, _, Position.LAST) | Aggregate(_, e, _, False) if e == element:
                return True
            case Time(elements, False) if element in elements:
                return True
    return False


def reads_before(condition: Condition) -> bool:
    """Whether a condition reads ``a[i-1]`` or ``a[..i-1]``."""
    return any(map(is_before, leaves_in(condition)))


def is_before(leaf: Expression) -> TypeGuard[Value | Aggregate]:
    match leaf:
        case Value(_, _, Position.PREVIOUS) | Aggregate(_, _, _, True):
            return True
        case _:
            return False


def leaves_in(condition: Condition) -> list[Expression]:
    return [*leaves_of(condition.left), *leaves_of(condition.right)]


def _accumulators(packer: ConditionPacker) -> tuple[Integers, Integers]:
    """What runs add up, and the aggregates of that."""
    known: dict[tuple[int, str | None], int] = {}
    aggregates = [
        [known.setdefault((a.element, a.column), len(known)), FUNCTIONS.index(a.function)]
        for a in packer.aggregates
    ]
    accumulators = []
    for element, column in known:
        is_number = column is not None and packer.plan.type_of(column) is ColumnType.NUMBER
        word = -1 if column is None else packer.places[column]
        accumulators.append([element, word, int(is_number)])
    return (
        np.array(accumulators, np.int64).reshape(-1, 3),
        np.array(aggregates, np.int64).reshape(-1, 2),
    )


def _check_rows(plan: PatternPlan) -> None:
    """Refuse what reads a row of a Kleene element that is not meant."""
    for condition in plan.conditions:
        last = max(elements_of(condition), default=0)
        if not reads_before(condition):
            continue
        before = [leaf for leaf in leaves_in(condition) if is_before(leaf)]
        if reads_whole(plan, condition, last) or any(leaf.element != last for leaf in before):
            name = plan.elements[before[0].element].name
            raise PlanError(
                f"{name}[i-1] has no place in a condition on what comes after {name}[i]",
                f"compare it with {name}[i] and with earlier events",
                tuple(sorted(elements_of(condition))),
            )
    for probe in plan.probes:
        conditions = probe.conditions if isinstance(probe, CountProbe) else probe.state
        for condition in conditions:
            for leaf in leaves_in(condition):
                _check_settled(plan, leaf)
    for output in plan.outputs:
        if not isinstance(output.value, Listed):
            for leaf in leaves_of(output.value):
                _check_settled(plan, leaf)
        elif not plan.elements[output.value.element].is_kleene:
            name = plan.elements[output.value.element].name
            raise PlanError(f"{name} is one event", "write + after its type")


def _check_settled(plan: PatternPlan, leaf: Expression) -> None:
    """Refuse what has another value for each row of a match."""
    is_open = is_before(leaf) or (
        isinstance(leaf, Value)
        and leaf.position is Position.EACH
        and leaf.element != OWN
        and plan.elements[leaf.element].is_kleene
    )
    if is_open and isinstance(leaf, Value | Aggregate):
        name = plan.elements[leaf.element].name
        raise PlanError(
            f"{name} has several rows",
            f"write {name}[1], {name}[{name}.LEN] or an aggregate over {name}[]",
            (leaf.element,),
        )
