"""Which state bears witness to a verdict: where `always` fails, or `eventually` holds (SPEC §8)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...languages.mtl.ast import Temporal
from ...languages.mtl.checked import (
    And,
    Atom,
    Formula,
    Not,
    Or,
    Previous,
    Quantified,
    Truth,
    Until,
    Within,
)
from . import windows
from .nodes import END, Pass
from .windows import Moments

NONE = -1
"""No state bears witness: the end of an interval decides, or all states together."""
Places = Mapping[str, NDArray[np.int64]]
"""For each variable the place of an object, for each verdict: shape ``(n,)``."""


@dataclass(slots=True, eq=False)
class Witnesses:
    """The witnesses of verdicts over the states of one evaluation.

    Of `eventually f` that is true, and of `always f` that is false, it is the first state in the
    interval at which f is determined by then; of `f until g` that of g, or at which f fails while g
    may still hold. Other operators have that of the part that decides; an atom its own state. Cost:
    at most the states of an interval for each verdict.
    """

    once: Pass

    def of(self, formula: Formula, is_true: bool, rows: Moments, places: Places) -> Moments:
        """Return the row of the witness of each verdict, or `NONE`. ``rows``: those of the starts.
        Contract: each verdict is ``is_true``, and determined."""
        match formula:
            case Truth() | Atom():
                return rows
            case Not(operand):
                return self.of(operand, not is_true, rows, places)
            case And(left, right) | Or(left, right):
                return self._connected(isinstance(formula, Or), left, right, is_true, rows, places)
            case Previous(operand):
                found = self.of(operand, is_true, np.maximum(rows - 1, 0), places)
                return np.where(rows > 0, found, NONE)
            case Within(operator, _, operand):
                is_some = operator in (Temporal.EVENTUALLY, Temporal.ONCE)
                if is_some is not is_true:
                    return np.full(len(rows), NONE)
                first, last = self.once.bounds(operator.is_past, formula.interval)
                table, column = self._columns(operand, is_true, places, len(rows))
                by = self._moments(formula, is_true, rows, places)
                return windows.first_by(table, column, first[rows], last[rows], by)
            case Until():
                return self._until(formula, is_true, rows, places)
            case Quantified(is_universal, variable, sort, operand):
                if is_universal is is_true:
                    return np.full(len(rows), NONE)
                return self._of_object(variable, sort, operand, is_true, rows, places)

    def _moments(
        self, formula: Formula, is_true: bool, rows: Any, places: Places
    ) -> NDArray[np.int64]:
        """When a part is determined as wanted: true in the lower reading, false in the upper."""
        node = self.once.node(formula, not is_true)
        table = node.true if is_true else node.false
        found: NDArray[np.int64] = table[(rows, *(places[name] for name in node.axes))]
        return found

    def _connected(
        self, is_or: bool, left: Formula, right: Formula, is_true: bool, rows: Moments,
        places: Places,
    ) -> Moments:  # fmt: skip
        """That of the first part which decides alone, or of the last one where both have to."""
        a, b = (self._moments(part, is_true, rows, places) for part in (left, right))
        is_left = (a <= b) if is_or is is_true else (a >= b)
        found = np.empty(len(rows), np.int64)
        for part, mine in ((left, np.flatnonzero(is_left)), (right, np.flatnonzero(~is_left))):
            own = {name: each[mine] for name, each in places.items()}
            found[mine] = self.of(part, is_true, rows[mine], own)
        return found

    def _until(self, formula: Until, is_true: bool, rows: Moments, places: Places) -> Moments:
        """The state of the right part, or that at which the left one fails."""
        first, last = self.once.bounds(formula.is_past, formula.interval)
        closed = np.full(self.once.rows, NONE)
        if not formula.is_past:
            # The end of all streams comes after the last state, and so after what fails there.
            closed = self.once.over(formula.interval.end)
            last_row = self.once.rows - 1
            is_end = (closed == last_row) & (self.once.states.horizon[last_row] == END)
            closed = np.where(is_end, windows.NEVER, closed)
        left, left_column = self._columns(formula.left, is_true, places, len(rows))
        right, right_column = self._columns(formula.right, is_true, places, len(rows))
        return windows.deciding(
            left,
            right,
            left_column,
            right_column,
            rows,
            first[rows],
            last[rows],
            closed[rows],
            is_true=is_true,
            is_past=formula.is_past,
        )

    def _columns(
        self, formula: Formula, is_true: bool, places: Places, count: int
    ) -> tuple[Moments, Moments]:
        """A table with one axis behind the states, and the column of each verdict in it."""
        node = self.once.node(formula, not is_true)
        table = node.true if is_true else node.false
        flat = table.reshape(len(table), int(np.prod(table.shape[1:], dtype=np.int64)))
        if not node.axes:
            return flat, np.zeros(count, np.int64)
        at = [places[name] for name in node.axes]
        return flat, np.ravel_multi_index(at, table.shape[1:]).astype(np.int64)

    def _of_object(
        self, variable: str, sort: str, operand: Formula, is_true: bool, rows: Moments,
        places: Places,
    ) -> Moments:  # fmt: skip
        """That of the object which is determined first; of several the first state, so that the
        order of objects does not matter."""
        present = self.once.states.present[sort]
        best = np.full(len(rows), windows.NEVER)
        found = np.full(len(rows), NONE)
        for place in range(present.shape[1]):
            own = {**places, variable: np.full(len(rows), place, np.int64)}
            moments = self._moments(operand, is_true, rows, own)
            mine = np.flatnonzero(
                present[rows, place] & (moments <= best) & (moments < windows.NEVER)
            )
            part = {name: each[mine] for name, each in own.items()}
            state = self.of(operand, is_true, rows[mine], part)
            is_earlier = (found[mine] == NONE) | ((state != NONE) & (state < found[mine]))
            replaces = (moments[mine] < best[mine]) | is_earlier
            found[mine] = np.where(replaces, state, found[mine])
            best[mine] = moments[mine]
        return found
