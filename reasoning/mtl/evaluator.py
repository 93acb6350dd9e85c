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

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...languages.mtl.ast import Interval, Report
from ...languages.mtl.checked import (
    CheckedMonitor,
    Previous,
    Until,
    Within,
)
from ...streams.sample import Mask, Times
from ...streams.time import TIME_MIN
from ...streams.time_arithmetic import earlier
from ..states.states import States, Term, Values
from .formulas import bound_sorts, parts_of, reach_of, readings_of
from .nodes import END, Pass, spread_node, term_of
from .robustness import Margins
from .windows import NEVER, Moments
from .witness import NONE, Witnesses

_Places: TypeAlias = tuple[NDArray[np.int64], ...]
"""Cells of tables: the state, and the object of each axis."""


CELLS: Final = 1 << 13
"""Cells of a table that are made at once: some dozens of such tables fit into a core's cache."""
MOST_VALUES: Final = 10_000_000
"""The values of features that an explanation keeps: some hundred megabytes with its tables."""


class TooManyStates(Exception):
    """A formula needs more states than it may keep. The message says what to do."""


@dataclass(frozen=True, slots=True, eq=False)
class Verdicts:
    """Verdicts, in order of the deciding state, then of the binding, then of the start.

    All have shape ``(n,)``: ``start`` and ``decided`` are indices of states from the first one on,
    ``start_time`` and ``decided_time`` their valid times, ``value`` is 1 (true), 0 (false) or -1
    (unknown), ``binding`` has shape ``(n, parameters)``: the place of each parameter's object.
    """

    start: Times
    start_time: Times
    decided: Times
    decided_time: Times
    value: NDArray[np.int8]
    binding: NDArray[np.int64]
    witness_time: Times
    """The valid time of the witness (`witness.Witnesses`), `TIME_MIN` where there is none."""
    robustness: NDArray[np.float64] | None = None
    """The margin of each verdict (`robustness.Margins`), NaN for an unknown one; None: not asked
    for."""

    def __len__(self) -> int:
        return len(self.start)


@dataclass(slots=True)
class _Rows:
    """The states kept, as one `States`, and for each whether the verdict of a binding is out."""

    states: States
    is_decided: Mask
    first: int = 0
    """Index of the first state kept."""


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
    """Verdicts of a monitor over states.

    Law (tests/laws/reasoning): each (binding, start) whose objects are present at the start has one
    verdict, at the state at which progression by the definition determines it, however the states
    are cut into batches. After `end` each has one.

    Cost: O(states kept + new states) numpy and compiled loops for each node and push; `until` and
    `since` that times the states of an interval. Memory: 17 bytes a node's binding and state kept.
    Kept are states from the oldest start without a verdict on, and before it as far as the past
    operators look; all of them if a past interval has no bound, at most ``limit``.
    """

    def __init__(self, monitor: CheckedMonitor, *, limit: int = 1_000_000) -> None:
        self._monitor = monitor
        self._limit = limit
        self._sorts = sorts_of(monitor)
        self._axes = tuple(sorted(name for name, _ in monitor.parameters))
        self._looks_back = _looks_back(monitor.formula)
        self._kept: _Rows | None = None

    @property
    def terms(self) -> frozenset[Term]:
        """The terms whose values `push` needs."""
        found = readings_of(self._monitor.formula)
        return frozenset(term_of(reading, self._sorts) for reading in found)

    @property
    def pending(self) -> int:
        """The states kept."""
        return 0 if self._kept is None else len(self._kept.states.valid)

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
        ``(objects of each parameter in order)``."""
        assert self._kept is not None
        is_open = ~self._kept.is_decided
        first = np.argmax(is_open, axis=0)
        valid = self._kept.states.valid
        found = np.asarray(np.where(is_open.any(axis=0), valid[first], valid[-1] + 1))
        return found.transpose([self._axes.index(name) for name, _ in self._monitor.parameters])

    def push(self, states: States) -> Verdicts:
        """Take states; return the verdicts that they determine. Raises `TooManyStates`."""
        most = self._most_at_once(states)
        if len(states.valid) <= most:
            self._kept = self._joined(states)
            return self._decide()
        found = []
        for start in range(0, len(states.valid), most):
            self._kept = self._joined(states.part(slice(start, start + most)))
            found.append(self._decide())
        return _concatenated(found)

    def advance(self, horizon: int) -> Verdicts:
        """Learn that every later state is valid after ``horizon``."""
        if self._kept is None or not len(self._kept.states.valid):
            return _no_verdicts(len(self._axes))
        known = self._kept.states.horizon
        known[-1] = max(known[-1], horizon)
        return self._decide()

    def end(self) -> Verdicts:
        """Learn that no further state comes."""
        return self.advance(END)

    def _most_at_once(self, states: States) -> int:
        """How many states to take at once. Those kept are evaluated each time: they stay few beside
        the new ones."""
        columns = prod(states.present[sort].shape[1] for sort in self._sorts.values())
        most: int = max(1, CELLS // max(columns, 1), 4 * self.pending)
        return most

    def _joined(self, new: States) -> _Rows:
        """The states kept, and the new ones after them."""
        count = len(new.valid)
        shape = tuple(new.present[self._sorts[name]].shape[1] for name in self._axes)
        is_decided = np.zeros((count, *shape), np.bool_)
        if self._monitor.once:
            # The first state is the only start.
            is_decided[1 if self._kept is None else 0 :] = True
        if self._kept is None:
            horizon = np.maximum.accumulate(new.horizon)
            return _Rows(
                States(new.valid, horizon, new.objects, new.present, new.values), is_decided
            )
        rows, kept = self._kept, self._kept.states
        if len(kept.valid) + count > self._limit:
            raise TooManyStates(
                f"the formula needs more than {self._limit} states; give its intervals an end, or "
                "sample less often"
            )
        values = {
            term: Values(
                _extended(kept.values[term].values, part.values),
                _extended(kept.values[term].known, part.known),
            )
            for term, part in new.values.items()
        }
        present = {s: _extended(kept.present[s], part) for s, part in new.present.items()}
        horizon = np.maximum.accumulate(np.concatenate([kept.horizon, new.horizon]))
        valid = np.concatenate([kept.valid, new.valid])
        states = States(valid, horizon, new.objects, present, values)
        return _Rows(states, _extended(rows.is_decided, is_decided), rows.first)

    def _decide(self) -> Verdicts:
        rows = self._kept
        assert rows is not None
        states = rows.states
        once = Pass(states, self._sorts, rows.first)
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
        rows.is_decided |= new | ~is_there
        binding = np.stack(columns, axis=1) if columns else np.empty((len(moment), 0), np.int64)
        found = Verdicts(
            start + rows.first,
            states.valid[start],
            moment + rows.first,
            states.valid[moment],
            value,
            binding,
            self._witness_times(once, value, places),
            robustness,
        )
        self._forget(rows)
        return found

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

    def _forget(self, rows: _Rows) -> None:
        """Drop the states that no verdict to come needs."""
        states = rows.states
        count = len(states.valid)
        open_rows = np.flatnonzero(~rows.is_decided.reshape(count, -1).all(axis=1))
        # The last state stays: `advance` raises its horizon, and past operators look back from it.
        oldest = int(open_rows[0]) if len(open_rows) else count - 1
        keep = oldest
        if self._looks_back and count:
            keep = earliest(self._monitor.formula, oldest, states.valid)
        if keep < 1:
            return
        rows.states = states.part(slice(keep, None))
        rows.is_decided = rows.is_decided[keep:]
        rows.first += keep


class StateKeeper(MonitorEvaluator):
    """Keeps all states and decides nothing: an explanation evaluates them once. Raises
    `TooManyStates` for more than `MOST_VALUES` values of features."""

    def _decide(self) -> Verdicts:
        assert self._kept is not None
        kept = self._kept.states.values
        if sum(each.values.size for each in kept.values()) > MOST_VALUES:
            raise TooManyStates("the states have too many values to keep all of them")
        return _no_verdicts(len(self._axes))


def sorts_of(monitor: CheckedMonitor) -> dict[str, str]:
    """Return the sort of each variable, an IRI."""
    return {**dict(monitor.parameters), **bound_sorts(monitor.formula)}


def earliest(formula: Any, row: int, valid: Times) -> int:
    """Return the first row that the formula looks at from ``row`` or later ones."""
    match formula:
        case Previous(operand):
            return earliest(operand, max(0, row - 1), valid)
        case Within(operator, interval) if operator.is_past:
            row = _rows_back(interval, row, valid)
        case Until(True, interval):
            row = _rows_back(interval, row, valid)
        case _:
            pass
    return min([row, *(earliest(part, row, valid) for part in parts_of(formula))])


def _looks_back(formula: Any) -> bool:
    """Whether the formula has an operator of the past."""
    match formula:
        case Previous() | Until(True):
            return True
        case Within(operator) if operator.is_past:
            return True
        case _:
            return any(map(_looks_back, parts_of(formula)))


def _rows_back(interval: Interval, row: int, valid: Times) -> int:
    if interval.end is None:
        return 0
    return int(np.searchsorted(valid, earlier(valid[row : row + 1], interval.end)[0], "left"))


def _extended(kept: NDArray[Any], new: NDArray[Any]) -> NDArray[Any]:
    """Rows kept, with the columns that new objects added, and new rows after them."""
    if kept.shape[1:] != new.shape[1:]:
        more = zip(kept.shape[1:], new.shape[1:], strict=True)
        kept = np.pad(kept, [(0, 0), *((0, n - k) for k, n in more)])
    return np.concatenate([kept, new])


def _concatenated(parts: Sequence[Verdicts]) -> Verdicts:
    """The verdicts of all parts, in order."""
    margins = [each.robustness for each in parts if each.robustness is not None]
    return Verdicts(
        np.concatenate([each.start for each in parts]),
        np.concatenate([each.start_time for each in parts]),
        np.concatenate([each.decided for each in parts]),
        np.concatenate([each.decided_time for each in parts]),
        np.concatenate([each.value for each in parts]),
        np.concatenate([each.binding for each in parts]),
        np.concatenate([each.witness_time for each in parts]),
        np.concatenate(margins) if margins else None,
    )


def _no_verdicts(parameters: int) -> Verdicts:
    none = np.empty(0, np.int64)
    return Verdicts(
        none, none, none, none, np.empty(0, np.int8), np.empty((0, parameters), np.int64), none
    )
