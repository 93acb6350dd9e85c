"""Verdicts of a formula over states that come in batches (SPEC §8).

A node of the formula is two tables of *moments*: for each state, and each binding of the node's
free variables, the index of the state at which the node is determined true there, and false. A
node follows from its parts: of a disjunction the true moment is the least of the parts', the false
moment the greatest; of `eventually` they are the least true moment in the interval, and the
greatest false moment or the moment at which the interval closes. That is folding of constants in
progression, as strong Kleene logic is compositional (docs/explanation/design/0011-formulas.md).

Unknown atoms have two readings: in the *lower* one an unknown atom counts against the formula, in
the *upper* one for it. True needs the lower reading true, false the upper one false, unknown the
lower one false and the upper one true.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from math import prod
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...languages.mtl.ast import Report, Temporal
from ...languages.mtl.checked import (
    CheckedMonitor,
    Constant,
    Formula,
    ObjectConstant,
    Within,
)
from ...streams.sample import Mask, Times
from ...streams.time import TIME_MAX, TIME_MIN
from ..states.states import States, Term
from .formulas import earliest, looks_back, reach_of, remembered_by, sorts_of
from .kept_states import KeptStates
from .nodes import END, Pass, column, spread_node, terms_of
from .robustness import Margins
from .timelines import Timelines
from .windows import NEVER, Moments
from .witness import NONE, Witnesses

Constants: TypeAlias = Mapping[str, Constant | ObjectConstant]
"""Values of parameters, by their names."""
_Places: TypeAlias = tuple[NDArray[np.int64], ...]
"""Cells of tables: the state, and the object of each axis."""


CELLS: Final = 1 << 13
"""Cells of a table that are made at once: some dozens of such tables fit into a core's cache."""
MOST_VALUES: Final = 10_000_000
"""The values of features that an explanation keeps: some hundred megabytes with its tables."""


MOST_STATES: Final = 1_000_000
"""The states that a formula may need."""
BYTES_OF_NODE: Final = 17
"""Memory of a node for a binding and state: two moments of eight bytes, and a truth."""


class TooManyStates(Exception):
    """A formula needs more states than it may keep. The message says what to do."""


@dataclass(frozen=True, slots=True, eq=False)
class Verdicts:
    """Verdicts of a part, in order of the deciding state, then of the binding, then of the start.

    All have shape ``(n,)``: ``start_time`` and ``decided_time`` are the valid times of two states
    of the ``part``, ``left`` when the deciding one left, ``value`` is 1 (true), 0 (false) or -1
    (unknown), ``binding`` has shape ``(n, parameters)``: the place of each parameter's object.
    """

    part: NDArray[np.int64]
    start_time: Times
    decided_time: Times
    left: Times
    value: NDArray[np.int8]
    binding: NDArray[np.int64]
    witness_time: Times
    """The valid time of the witness (`witness.Witnesses`), `TIME_MIN` where there is none."""
    robustness: NDArray[np.float64] | None = None
    """The margin of each verdict (`robustness.Margins`), NaN for an unknown one; None: not asked
    for."""
    unreported: Mapping[int, int] = field(default_factory=dict)
    """The number of further verdicts, by their value, which the monitor does not report."""

    def __len__(self) -> int:
        return len(self.part)


@dataclass(frozen=True, slots=True)
class _Moments:
    """When the formula is determined true, false and unknown; shape ``(n, objects of each
    axis)``."""

    true: Moments
    false: Moments
    unknown: Moments | None
    """None: never, as all atoms are known."""

    def decided(self) -> Moments:
        found = np.minimum(self.true, self.false)
        return found if self.unknown is None else np.minimum(found, self.unknown)

    def value(self, places: _Places, moment: Times) -> NDArray[np.int8]:
        """The verdict at each place as it is at a moment."""
        is_true = self.true[places] <= moment
        if self.unknown is None:
            return is_true.astype(np.int8)
        return np.where(is_true, 1, np.where(self.false[places] <= moment, 0, -1)).astype(np.int8)


class PartValues:
    """The values of a formula's parameters, or of its variable, for each part."""

    def __init__(self) -> None:
        self._columns: dict[str, NDArray[Any]] = {}

    def put(self, part: int, values: Constants) -> None:
        """Give parameters their values for a part."""
        for name, value in values.items():
            constant = value.value if isinstance(value, Constant) else value.iri
            known = self._columns.get(name)
            if known is None or part >= len(known):
                kind = object if isinstance(constant, str) else type(constant)
                more = np.empty(max(16, part + 1), kind)
                known = more if known is None else np.concatenate([known, more])
                self._columns[name] = known
            known[part] = constant

    def of(self, part: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        """The values at each state, by the parts of these."""
        return {name: known[part] for name, known in self._columns.items()}


class MonitorEvaluator:
    """Verdicts of a monitor over states; where parts have states of their own, of each by itself.

    Law (tests/laws/reasoning): each (binding, start) whose objects are present at the start has one
    verdict, at the state at which progression by the definition determines it, however the states
    are cut into batches. After `end` each has one.

    Cost: O(states kept + new states) numpy and compiled loops for each node and push, of the parts
    that have new ones; `until` and `since` that times the states of an interval. Memory: 17 bytes a
    node's binding and state kept. Kept are states from the oldest start without a verdict on, and
    before it as far as the past operators look. Where an interval of the past has no end these are
    the states that are remembered (`formulas.is_remembered`), of each object two at most; otherwise
    all of them, at most ``limit`` of a part.
    """

    def __init__(self, monitor: CheckedMonitor, *, limit: int = MOST_STATES) -> None:
        self._monitor = monitor
        self._limit = limit
        self._sorts = sorts_of(monitor)
        self._axes = tuple(sorted(name for name, _ in monitor.parameters))
        self._looks_back = looks_back(monitor.formula)
        self._remembered = remembered_by(monitor)
        self._kept: KeptStates | None = None
        self._values = PartValues()
        self.states_of: NDArray[np.int64] = np.zeros(1, np.int64)
        """The number of states of each part by now."""
        self._verdicts_of = np.zeros((3, 1), np.int64)
        """The verdicts of each part by now: unknown, false, true."""

    @property
    def terms(self) -> frozenset[Term]:
        """The terms whose values `push` needs."""
        return terms_of(self._monitor.formula, self._sorts)

    @property
    def pending(self) -> int:
        """The states kept."""
        return 0 if self._kept is None else len(self._kept.part)

    @property
    def states(self) -> States | None:
        """The states kept; None before the first."""
        return None if self._kept is None else self._kept.states

    @property
    def is_open(self) -> bool:
        """Whether a start seen by now has no verdict yet."""
        return self._kept is not None and not bool(self._kept.is_decided.all())

    def is_open_of(self, part: int) -> bool:
        """Whether a start of a part has no verdict yet."""
        kept = self._kept
        return kept is not None and not bool(kept.is_decided[kept.part == part].all())

    def settled(self) -> NDArray[np.int64]:
        """For each part and binding the valid time before which each start has its verdict, shape
        ``(parts, objects of each parameter in order)``; `TIME_MIN` for a part without states."""
        kept = self._kept
        assert kept is not None
        is_decided = kept.is_decided
        valid = kept.states.valid.reshape((-1,) + (1,) * (is_decided.ndim - 1))
        found = np.full((len(self.states_of), *is_decided.shape[1:]), TIME_MIN, np.int64)
        np.maximum.at(found, kept.part, np.broadcast_to(valid + 1, is_decided.shape))
        np.minimum.at(found, kept.part, np.where(is_decided, TIME_MAX, valid))
        order = [self._axes.index(name) + 1 for name, _ in self._monitor.parameters]
        return found.transpose([0, *order])

    def make_room_for(self, parts: int) -> None:
        """Let there be so many parts."""
        more = parts - len(self.states_of)
        if more > 0:
            grown = np.zeros(max(16, more, len(self.states_of)), np.int64)
            self.states_of = np.concatenate([self.states_of, grown])
            words = np.zeros((3, len(grown)), np.int64)
            self._verdicts_of = np.concatenate([self._verdicts_of, words], axis=1)

    def set_values(self, part: int, values: Constants) -> None:
        """Give parameters of the formula, or variables, their values for a part."""
        self._values.put(part, values)

    def verdicts_of(self, part: int) -> dict[int, int]:
        """The number of verdicts of a part by now, by their value."""
        return dict(zip((-1, 0, 1), self._verdicts_of[:, part].tolist(), strict=True))

    def drop(self, part: int) -> None:
        """Forget the states of a part."""
        if self._kept is not None:
            self._kept = self._kept.take(self._kept.part != part)

    def push(
        self, states: States, left: Times | None = None, part: NDArray[np.int64] | None = None
    ) -> Verdicts:
        """Take states; return the verdicts that they determine. ``left``: when each left; ``part``:
        of which part each is, in order of parts and time; None: all are of one. Raises
        `TooManyStates`."""
        count = len(states.valid)
        if not count:
            return no_verdicts(len(self._axes))
        part = np.zeros(count, np.int64) if part is None else part
        left = states.valid if left is None else left
        most = self._most_at_once(states)
        if count <= most:
            return self._pushed(states, left, part)
        cuts = [slice(start, start + most) for start in range(0, count, most)]
        return concatenated([self._pushed(states.take(cut), left[cut], part[cut]) for cut in cuts])

    def _pushed(self, states: States, left: Times, part: NDArray[np.int64]) -> Verdicts:
        count = len(states.valid)
        shape = tuple(states.present[self._sorts[name]].shape[1] for name in self._axes)
        is_decided = np.full((count, *shape), self._monitor.once)
        if self._monitor.once:
            # The first state of a part is its only start.
            first = Timelines.of(part, self.states_of).first
            is_decided[first[self.states_of[part[first]] == 0]] = False
        rows = KeptStates(states, is_decided, part, left)
        rest = None
        if self._kept is not None:
            mine, rest = self._kept.split(self._among(part))
            rows = mine.followed_by(rows).by_part()
        if len(rows.part) > self._limit and np.bincount(rows.part).max() > self._limit:
            raise TooManyStates(
                f"the formula needs more than {self._limit} states; give its intervals an end, or "
                "sample less often"
            )
        self.states_of += np.bincount(part, minlength=len(self.states_of))
        return self._decided(rows, rest)

    def advance(self, horizon: int | Times) -> Verdicts:
        """Learn that every later state is valid after ``horizon``, which may be one for each
        part."""
        if not self.is_open:
            return no_verdicts(len(self._axes))
        kept = self._kept
        assert kept is not None
        is_open = ~kept.is_decided.reshape(len(kept.part), -1).all(axis=1)
        rows, rest = kept.split(self._among(kept.part[is_open]))
        rows = rows.by_part()
        last = np.flatnonzero(np.diff(rows.part, append=-1))
        reached = horizon if isinstance(horizon, int) else horizon[rows.part[last]]
        known = rows.states.horizon.copy()
        known[last] = np.maximum(known[last], reached)
        rows = replace(rows, states=replace(rows.states, horizon=known))
        return self._decided(rows, rest)

    def end(self) -> Verdicts:
        """Learn that no further state comes."""
        return self.advance(END)

    def _most_at_once(self, states: States) -> int:
        """How many states to take at once. Those kept are evaluated or copied each time: they stay
        few beside the new ones."""
        columns = prod(states.present[sort].shape[1] for sort in self._sorts.values())
        most: int = max(1, CELLS // max(columns, 1), 4 * self.pending)
        return most

    def _among(self, parts: NDArray[np.int64]) -> Mask:
        """Whether each part is one of these."""
        found = np.zeros(len(self.states_of), np.bool_)
        found[parts] = True
        return found

    def _decided(self, rows: KeptStates, rest: KeptStates | None) -> Verdicts:
        """The verdicts that these states determine; keep those that are needed, and the ``rest``.
        Contract: they are in order of parts."""
        timelines = Timelines.of(rows.part, self.states_of)
        once = Pass(rows.states, self._sorts, timelines, self._values.of(rows.part))
        found = self._verdicts(rows, once)
        if len(found):
            np.add.at(self._verdicts_of, (found.value + 1, found.part), 1)
        rows = self._needed(rows, once)
        self._kept = rows if rest is None else rest.followed_by(rows)
        return found

    def _verdicts(self, rows: KeptStates, once: Pass) -> Verdicts:
        states = rows.states
        is_there = self._present(states)
        if self._monitor.robustness:
            over = once.over(reach_of(self._monitor.formula))
            decided = over.reshape((-1,) + (1,) * (is_there.ndim - 1))
        else:
            moments = self._moments(once)
            decided = moments.decided()
        new = (decided < NEVER) & ~rows.is_decided & is_there
        robustness = None
        # The places are in the order of axes; parameters are in that of the text.
        axes = [1 + self._axes.index(name) for name, _ in self._monitor.parameters]
        *columns, start = np.nonzero(np.ascontiguousarray(new.transpose(*axes, 0)))
        places = self._places(start, columns)
        moment = over[start] if self._monitor.robustness else decided[places]
        if np.count_nonzero(moment[1:] < moment[:-1]):
            order = np.argsort(moment, kind="stable")
            moment, start = moment[order], start[order]
            columns = [each[order] for each in columns]
            places = self._places(start, columns)
        if self._monitor.robustness:
            value, robustness = self._by_margins(once, places)
        else:
            value = moments.value(places, moment)
        np.logical_or(rows.is_decided, new | ~is_there, out=rows.is_decided)
        binding = np.stack(columns, axis=1) if columns else np.empty((len(moment), 0), np.int64)
        return Verdicts(
            rows.part[start],
            states.valid[start],
            states.valid[moment],
            rows.left[moment],
            value,
            binding,
            self._witness_times(once, value, places),
            robustness,
        )

    def _places(self, start: NDArray[np.int64], columns: Sequence[NDArray[np.int64]]) -> _Places:
        """Cells of tables, of the objects of each parameter."""
        names = [name for name, _ in self._monitor.parameters]
        return start, *(columns[names.index(name)] for name in self._axes)

    def _witness_times(
        self, once: Pass, value: NDArray[np.int8], places: tuple[NDArray[np.int64], ...]
    ) -> Times:
        """The times of the witnesses of verdicts at these places, of those that are reported."""
        found = np.full(len(value), TIME_MIN, np.int64)
        reports_all = self._monitor.report is not Report.VIOLATIONS
        for is_true in (False, True) if reports_all else (False,):
            mine = np.flatnonzero(value == is_true)
            if len(mine):
                named = zip(self._axes, places[1:], strict=True)
                columns = {name: each[mine] for name, each in named}
                witnesses = Witnesses(once)
                rows = witnesses.of(self._monitor.formula, is_true, places[0][mine], columns)
                found[mine] = np.where(rows == NONE, TIME_MIN, once.states.valid[rows])
        return found

    def _moments(self, once: Pass) -> _Moments:
        formula = self._monitor.formula
        shape = once.rows, *(once.states.present[self._sorts[name]].shape[1] for name in self._axes)
        lower = spread_node(once.node(formula, False), self._axes, shape)
        if once.is_known(formula):
            return _Moments(lower.true, lower.false, None)
        upper = spread_node(once.node(formula, True), self._axes, shape)
        return _Moments(lower.true, upper.false, np.maximum(lower.false, upper.true))

    def _by_margins(
        self, once: Pass, places: _Places
    ) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
        """The verdicts at these places, whose intervals are over, and their margins."""
        margins = Margins(once)
        by_name = dict(zip(self._axes, places[1:], strict=True))

        def margin(is_upper: bool) -> NDArray[np.float64]:
            axes, table = margins.of(self._monitor.formula, is_upper)
            found: NDArray[np.float64] = table[(places[0], *(by_name[name] for name in axes))]
            return found

        if not len(places[0]):
            return np.empty(0, np.int8), np.empty(0)
        low = margin(False)
        high = low if once.is_known(self._monitor.formula) else margin(True)
        value = np.where(low > 0, 1, np.where(high < 0, 0, -1)).astype(np.int8)
        # A margin of 0 does not tell `>` from `>=`.
        alike = np.flatnonzero((low == 0) | (high == 0))
        if len(alike):
            at = tuple(each[alike] for each in places)
            last = np.full(len(alike), once.rows - 1)
            value[alike] = self._moments(once).value(at, last)
        # Adding 0 makes 0 of -0.
        return value, np.where(value == 1, low, np.where(value == 0, high, np.nan)) + 0.0

    def _present(self, states: States) -> Mask:
        """Whether all objects of each binding are there at each state."""
        if len(self._axes) == 1:
            return states.present[self._sorts[self._axes[0]]]
        found = np.ones((len(states.valid), *(1 for _ in self._axes)), np.bool_)
        for i, name in enumerate(self._axes):
            own = states.present[self._sorts[name]]
            shape = [1] * found.ndim
            shape[0], shape[1 + i] = own.shape
            found = found & own.reshape(shape)
        return found

    def _needed(self, rows: KeptStates, once: Pass) -> KeptStates:
        """The states that a verdict to come needs."""
        count, timelines = len(rows.part), once.timelines
        is_open = ~rows.is_decided.reshape(count, -1).all(axis=1)
        # The last state stays: `advance` raises its horizon, and past operators look back from it.
        row = np.where(is_open, np.arange(count), timelines.end - 1)
        oldest = np.minimum.reduceat(row, timelines.first)
        keep = oldest
        if self._looks_back:
            keep = earliest(self._monitor.formula, oldest, partial(self._back, once))
        if len(keep) == 1 and not self._remembered:
            return rows.take(slice(int(keep[0]), None)) if keep[0] else rows
        needed = np.arange(count) >= np.repeat(keep, np.diff(timelines.first, append=count))
        if self._remembered:
            # The past of an object to come is unknown.
            needed[timelines.first] = True
        for formula in self._remembered:
            needed[_first_decided(formula, once)] = True
        return rows if needed.all() else rows.take(needed)

    def _back(self, once: Pass, formula: Formula, rows: NDArray[np.int64]) -> NDArray[np.int64]:
        """As `Pass.back`, but for what is remembered."""
        return rows if formula in self._remembered else once.back(formula, rows)


class StateKeeper(MonitorEvaluator):
    """Keeps all states and decides nothing: an explanation evaluates them once. Raises
    `TooManyStates` for more than `MOST_VALUES` values of features."""

    def _decided(self, rows: KeptStates, rest: KeptStates | None) -> Verdicts:
        self._kept = rows if rest is None else rest.followed_by(rows)
        kept = self._kept.states.values
        if sum(each.values.size for each in kept.values()) > MOST_VALUES:
            raise TooManyStates("the states have too many values to keep all of them")
        return no_verdicts(len(self._axes))


def _first_decided(formula: Within, once: Pass) -> NDArray[np.int64]:
    """The first row of each timeline and object that decides `once`, or `historically`, for good,
    in each reading. Contract: `is_remembered`."""
    found = []
    for is_upper in (False,) if once.is_known(formula) else (False, True):
        operand = once.node(formula.operand, is_upper)
        moments = operand.true if formula.operator is Temporal.ONCE else operand.false
        rows = np.where(moments < NEVER, column(once.at, moments.ndim), once.rows)
        found.append(np.minimum.reduceat(rows, once.timelines.first, axis=0).reshape(-1))
    first = np.concatenate(found)
    return first[first < once.rows]


def concatenated(parts: Sequence[Verdicts]) -> Verdicts:
    """Return the verdicts of states that were taken one after the other."""
    margins = [each.robustness for each in parts if each.robustness is not None]
    unreported: Counter[int] = Counter()
    for each in parts:
        unreported.update(each.unreported)
    return Verdicts(
        np.concatenate([each.part for each in parts]),
        np.concatenate([each.start_time for each in parts]),
        np.concatenate([each.decided_time for each in parts]),
        np.concatenate([each.left for each in parts]),
        np.concatenate([each.value for each in parts]),
        np.concatenate([each.binding for each in parts]),
        np.concatenate([each.witness_time for each in parts]),
        np.concatenate(margins) if margins else None,
        unreported,
    )


def no_verdicts(parameters: int) -> Verdicts:
    """Return no verdicts of a monitor with so many parameters."""
    none = np.empty(0, np.int64)
    values, binding = np.empty(0, np.int8), np.empty((0, parameters), np.int64)
    return Verdicts(none, none, none, none, values, binding, none)
