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
from typing import Final, TypeAlias

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
from ...streams.time import TIME_MIN
from ..states.states import States, Term
from .formulas import earliest, looks_back, reach_of, remembered_by, sorts_of
from .kept_states import KeptStates
from .nodes import END, Pass, column, spread_node, terms_of
from .robustness import Margins
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
    """Verdicts, in order of parts, then of the deciding state, of the binding and of the start.

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


class MonitorEvaluator:
    """Verdicts of a monitor over states that all objects share.

    Law (tests/laws/reasoning): each (binding, start) whose objects are present at the start has one
    verdict, at the state at which progression by the definition determines it, however the states
    are cut into batches. After `end` each has one.

    Cost: O(states kept + new states) numpy and compiled loops for each node and push; `until` and
    `since` that times the states of an interval. Memory: 17 bytes a node's binding and state kept.
    Kept are states from the oldest start without a verdict on, and before it as far as the past
    operators look. Where an interval of the past has no end these are the states that are
    remembered (`formulas.is_remembered`), of each object two at most; otherwise all of them, at
    most ``limit``.
    """

    def __init__(self, monitor: CheckedMonitor, *, limit: int = MOST_STATES) -> None:
        self._monitor = monitor
        self._limit = limit
        self._sorts = sorts_of(monitor)
        self._axes = tuple(sorted(name for name, _ in monitor.parameters))
        self._looks_back = looks_back(monitor.formula)
        self._remembered = remembered_by(monitor)
        self._kept: KeptStates | None = None
        self.seen = 0
        """The number of states by now."""

    @property
    def terms(self) -> frozenset[Term]:
        """The terms whose values `push` needs."""
        return terms_of(self._monitor.formula, self._sorts)

    @property
    def pending(self) -> int:
        """The states kept."""
        return 0 if self._kept is None else len(self._kept.left)

    @property
    def states(self) -> States | None:
        """The states kept; None before the first."""
        return None if self._kept is None else self._kept.states

    @property
    def is_open(self) -> bool:
        """Whether a start seen by now has no verdict yet."""
        return self._kept is not None and not bool(self._kept.is_decided.all())

    def settled(self) -> NDArray[np.int64]:
        """For each binding the valid time before which each start has its verdict, shape
        ``(objects of each parameter in order)``. Contract: there was a state."""
        kept = self._kept
        assert kept is not None
        valid = kept.states.valid.reshape((-1,) + (1,) * (kept.is_decided.ndim - 1))
        found: NDArray[np.int64]
        found = np.where(kept.is_decided, int(kept.states.valid[-1]) + 1, valid).min(axis=0)
        return found.transpose([self._axes.index(name) for name, _ in self._monitor.parameters])

    def push(self, states: States, left: Times | None = None) -> Verdicts:
        """Take states, in order of time; return the verdicts that they determine. ``left``: when
        each left. Raises `TooManyStates`."""
        count = len(states.valid)
        if not count:
            return no_verdicts(len(self._axes))
        left = states.valid if left is None else left
        most = self._most_at_once(states)
        if count <= most:
            return self._pushed(states, left)
        cuts = [slice(start, start + most) for start in range(0, count, most)]
        return concatenated([self._pushed(states.take(cut), left[cut]) for cut in cuts])

    def _pushed(self, states: States, left: Times) -> Verdicts:
        count = len(states.valid)
        shape = tuple(states.present[self._sorts[name]].shape[1] for name in self._axes)
        is_decided = np.full((count, *shape), self._monitor.once)
        if self._monitor.once and not self.seen:
            # The first state of all is the only start.
            is_decided[0] = False
        rows = KeptStates(states, is_decided, left)
        if self._kept is not None:
            rows = self._kept.followed_by(rows)
        if len(rows.left) > self._limit:
            raise TooManyStates(
                f"the formula needs more than {self._limit} states; give its intervals an end, or "
                "sample less often"
            )
        self.seen += count
        return self._decided(rows)

    def advance(self, horizon: int) -> Verdicts:
        """Learn that every later state is valid after ``horizon``."""
        kept = self._kept
        if kept is None or not self.is_open:
            return no_verdicts(len(self._axes))
        known = kept.states.horizon.copy()
        known[-1] = max(int(known[-1]), horizon)
        return self._decided(replace(kept, states=replace(kept.states, horizon=known)))

    def end(self) -> Verdicts:
        """Learn that no further state comes."""
        return self.advance(END)

    def _most_at_once(self, states: States) -> int:
        """How many states to take at once. Those kept are evaluated or copied each time: they stay
        few beside the new ones."""
        columns = prod(states.present[sort].shape[1] for sort in self._sorts.values())
        most: int = max(1, CELLS // max(columns, 1), 4 * self.pending)
        return most

    def _decided(self, rows: KeptStates) -> Verdicts:
        """The verdicts that these states determine; keep those that are needed."""
        once = Pass(rows.states, self._sorts, is_whole=self.seen == len(rows.left))
        found = self._verdicts(rows, once)
        self._kept = self._needed(rows, once)
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
            np.zeros(len(start), np.int64),
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
        count = len(rows.left)
        is_open = ~rows.is_decided.reshape(count, -1).all(axis=1)
        # The last state stays: `advance` raises its horizon, and past operators look back from it.
        keep = int(is_open.argmax()) if is_open.any() else count - 1
        if self._looks_back:
            row = np.array([keep])
            keep = int(earliest(self._monitor.formula, row, partial(self._back, once))[0])
        if not self._remembered:
            return rows.take(slice(keep, None)) if keep else rows
        needed = np.arange(count) >= keep
        # The past of an object to come is unknown.
        needed[0] = True
        for formula in self._remembered:
            needed[_first_decided(formula, once)] = True
        return rows if needed.all() else rows.take(needed)

    def _back(self, once: Pass, formula: Formula, rows: NDArray[np.int64]) -> NDArray[np.int64]:
        """As `Pass.back`, but for what is remembered."""
        return rows if formula in self._remembered else once.back(formula, rows)


class StateKeeper(MonitorEvaluator):
    """Keeps all states and decides nothing: an explanation evaluates them once. Raises
    `TooManyStates` for more than `MOST_VALUES` values of features."""

    def _decided(self, rows: KeptStates) -> Verdicts:
        self._kept = rows
        if sum(each.values.size for each in rows.states.values.values()) > MOST_VALUES:
            raise TooManyStates("the states have too many values to keep all of them")
        return no_verdicts(len(self._axes))


def _first_decided(formula: Within, once: Pass) -> NDArray[np.int64]:
    """The first row of each object that decides `once`, or `historically`, for good, in each
    reading. Contract: `is_remembered`."""
    found = []
    for is_upper in (False,) if once.is_known(formula) else (False, True):
        operand = once.node(formula.operand, is_upper)
        moments = operand.true if formula.operator is Temporal.ONCE else operand.false
        rows = np.where(moments < NEVER, column(once.at, moments.ndim), once.rows)
        found.append(rows.min(axis=0).reshape(-1))
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
