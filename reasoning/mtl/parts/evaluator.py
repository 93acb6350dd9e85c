"""Verdicts of a formula over the states of parts, each by itself, in one compiled call.

The verdicts of `mtl.evaluator.MonitorEvaluator`, by a program (`loop`).
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ....languages.mtl.ast import Report
from ....languages.mtl.checked import CheckedMonitor, Constant
from ....streams.sample import Times
from ....streams.time import TIME_MIN
from ...states.states import States, Term
from .. import programs
from ..evaluator import (
    MOST_STATES,
    Constants,
    TooManyStates,
    Verdicts,
    concatenated,
    no_verdicts,
)
from ..formulas import looks_back, reach_of, sorts_of
from ..nodes import END, Pass, Threshold, terms_of
from ..programs import LONGEST, Compiler, Program
from ..robustness import margin_of_atom
from . import layout, loop
from .layout import CURSORS, SIDES
from .loop import (
    AT_ONCE,
    CONTROLS,
    COUNT,
    EMITTED,
    HAS_MARGINS,
    IS_SINGLE,
    LIMIT,
    LOOKS_BACK,
    NEEDED,
    OPEN,
    PART_FIELDS,
    PLACES,
    REACH,
    REPORTS_ALL,
    SEEN,
    SETTLED,
    STOPPED_FOR,
    TRUES,
    UNKNOWNS,
    UNREPORTED_UNKNOWN,
    USED,
)

ROWS: Final = 2048
"""States of a part that are evaluated at once, unless more are kept: their tables fit into a core's
cache."""
CUT: Final = 8192
"""States whose atoms are compared at once."""
SMALLEST: Final = 64
"""Places for states, rows of the tables, and room for verdicts of a new evaluator."""


def bytes_of_state(monitor: CheckedMonitor) -> int:
    """Return the most bytes of a state that is kept; fewer as long as no atom was unknown."""
    compiler = Compiler(monitor)
    nodes = max(len(each.nodes) for each in _programs(compiler))
    return 8 * _fields(monitor, len(compiler.atoms), nodes)


def _fields(monitor: CheckedMonitor, atoms: int, nodes: int) -> int:
    """The fields of a state in the loop."""
    more = atoms if monitor.robustness else nodes
    return layout.ATOMS + layout.words_of(atoms) + more


def _programs(compiler: Compiler) -> list[Program]:
    """That of one reading, and that of both."""
    return [compiler.program(has_two_readings=each) for each in (False, True)]


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


class PartEvaluator:
    """Verdicts of a monitor over the states of parts. Contract: they are about one
    object (`formulas.is_of_one_object`).

    Law (tests/laws/reasoning/mtl/test_part_evaluator.py): those of `MonitorEvaluator` for each
    part.

    Cost: one call of a compiled loop. A new state costs some steps for each node and what it
    decides, not the states kept; but a start of `since` that waits for later states looks at its
    interval again with each of them, and with robustness a part with new states evaluates all it
    has. `advance` looks at all parts. Memory: `bytes_of_state` a state kept, at most six times,
    104 bytes a part and 48 for each node of the program of both readings. Kept are the states that
    `MonitorEvaluator` keeps.
    """

    def __init__(self, monitor: CheckedMonitor, *, limit: int = MOST_STATES) -> None:
        self._monitor = monitor
        self._limit = limit
        self._sorts = sorts_of(monitor)
        self._values = PartValues()
        compiler = Compiler(monitor)
        self._atoms = [(each, Threshold.of_atom(each, self._sorts)) for each in compiler.atoms]
        both = _programs(compiler)
        count = max(len(each.nodes) for each in both)
        self._nodes = np.zeros((len(both), count, programs.FIELDS), np.int64)
        self._roots = np.zeros((len(both), 5), np.int64)
        self._kinds = np.zeros((len(both), count), np.int64)
        for place, program in enumerate(both):
            self._nodes[place, : len(program.nodes)] = packed = _packed(program)
            self._roots[place] = *_roots(program), len(packed)
            self._kinds[place, : len(packed)] = _kinds(packed)
        if monitor.robustness:
            # The margin of a past without an end is that of all its states.
            self._kinds &= ~layout.REMEMBERED
        self._parts = _no_parts(1)
        self._cursors = np.zeros((1, count, CURSORS), np.int64)
        # The program of both readings, with more nodes, is needed from the first unknown atom on.
        fields = _fields(monitor, len(self._atoms), len(both[0].nodes))
        self._states = np.zeros((fields, SMALLEST), np.int64)
        self._out = np.empty((SMALLEST, 7), np.int64)
        self._control = np.zeros(CONTROLS, np.int64)
        self._control[HAS_MARGINS] = monitor.robustness
        reach = reach_of(monitor.formula)
        self._control[REACH] = programs.NO_END if reach is None else min(reach, LONGEST)
        self._control[LOOKS_BACK] = looks_back(monitor.formula)
        self._make_rows(SMALLEST)
        self._control[IS_SINGLE] = monitor.once
        self._control[REPORTS_ALL] = monitor.report is not Report.VIOLATIONS
        self._control[AT_ONCE], self._control[LIMIT] = ROWS, min(limit, layout.MOST_ROWS)
        self._none = no_verdicts(1)

    @property
    def terms(self) -> frozenset[Term]:
        """The terms whose values `push` needs."""
        return terms_of(self._monitor.formula, self._sorts)

    @property
    def pending(self) -> int:
        """The states kept."""
        return int(self._parts[:, COUNT].sum())

    @property
    def states(self) -> States | None:
        """None: the values of states are not kept."""
        return None

    @property
    def seen(self) -> int:
        """The number of states by now."""
        return int(self._parts[:, SEEN].sum())

    @property
    def states_of(self) -> NDArray[np.int64]:
        """The number of states of each part by now."""
        return self._parts[:, SEEN]

    @property
    def is_open(self) -> bool:
        """Whether a start seen by now has no verdict yet."""
        return bool(self._parts[:, OPEN].any())

    def is_open_of(self, part: int) -> bool:
        """Whether a start of a part has no verdict yet."""
        return bool(self._parts[part, OPEN])

    def settled(self) -> NDArray[np.int64]:
        """For each part the valid time before which each start has its verdict; `TIME_MIN` for one
        without states."""
        return self._parts[:, SETTLED]

    def make_room_for(self, parts: int) -> None:
        """Let there be so many parts."""
        more = parts - len(self._parts)
        if more > 0:
            more = max(16, more, len(self._parts))
            self._parts = np.concatenate([self._parts, _no_parts(more)])
            cursors = np.zeros((more, *self._cursors.shape[1:]), np.int64)
            self._cursors = np.concatenate([self._cursors, cursors])

    def set_values(self, part: int, values: Constants) -> None:
        """Give parameters of the formula, or its variable, their values for a part."""
        self._values.put(part, values)

    def verdicts_of(self, part: int) -> dict[int, int]:
        """The number of verdicts of a part by now, by their value."""
        counts = self._parts[part, UNKNOWNS : TRUES + 1].tolist()
        return dict(zip((-1, 0, 1), counts, strict=True))

    def drop(self, part: int) -> None:
        """Forget the states of a part."""
        self._parts[part, [COUNT, PLACES, OPEN, SETTLED]] = 0, 0, 0, TIME_MIN

    def push(
        self, states: States, left: Times | None = None, part: NDArray[np.int64] | None = None
    ) -> Verdicts:
        """As `MonitorEvaluator.push`; ``part``: of which part each state is, in order of parts and
        time; None: all are of one."""
        count = len(states.valid)
        if not count:
            return self._none
        left = states.valid if left is None else left
        part = np.zeros(count, np.int64) if part is None else part
        cuts = [slice(start, start + CUT) for start in range(0, count, CUT)]
        if len(cuts) == 1:
            return self._pushed(states, left, part)
        return concatenated([self._pushed(states.take(c), left[c], part[c]) for c in cuts])

    def _pushed(self, states: States, left: Times, part: NDArray[np.int64]) -> Verdicts:
        times = np.empty((3, len(part)), np.int64)
        times[0], times[1] = states.valid, states.horizon
        times[2] = left
        part = np.ascontiguousarray(part)
        return self._taken(*self._given(states, part), times, part, is_new=True)

    def advance(self, horizon: int | Times) -> Verdicts:
        """As `MonitorEvaluator.advance`; the horizon may be one for each part."""
        part = np.flatnonzero(self._parts[:, OPEN])
        if not len(part):
            return self._none
        times = np.empty((3, len(part)), np.int64)
        times[1] = horizon if isinstance(horizon, int) else horizon[part]
        nothing = np.empty((len(self._atoms) + 1, 0), np.uint8), np.empty((0, 0))
        return self._taken(*nothing, times, part, is_new=False)

    def end(self) -> Verdicts:
        """Learn that no further state comes."""
        return self.advance(END)

    def _given(
        self, states: States, part: NDArray[np.int64]
    ) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
        """The atoms of states and their margins, as the loop reads them."""
        given = np.empty((len(self._atoms) + 1, len(part)), np.uint8)
        margins = np.empty((len(self._atoms) if self._monitor.robustness else 0, len(part)))
        once = None
        for i, (atom, threshold) in enumerate(self._atoms):
            if threshold is None or len(margins):
                once = once or Pass(states, self._sorts, values=self._values.of(part))
                _, holds, known = once.atom(atom)
            else:
                holds, known = threshold.of(states)
            given[i] = holds.reshape(-1)
            if known is not None and not known.all():
                given[i, ~known.reshape(-1)] = layout.UNKNOWN
                self._make_fields()
            if once is not None and len(margins):
                margins[i] = margin_of_atom(once, atom)[1].reshape(-1)
        given[-1] = states.present[self._monitor.parameters[0][1]].reshape(-1)
        return given, margins

    def _taken(
        self, given: NDArray[np.uint8], margins: NDArray[np.float64], times: Times,
        part: NDArray[np.int64], *, is_new: bool,
    ) -> Verdicts:  # fmt: skip
        at, control = 0, self._control
        while True:
            states, tables, out = self._states, self._tables, self._out
            at = loop.take(
                self._nodes, self._roots, self._kinds, given, margins, times, part, at,
                int(is_new), states, states.view(np.float64), self._parts, self._cursors,
                tables, tables.view(np.float64), self._scratch, control, out, out.view(np.float64),
                size=max(len(part), states.shape[1] // 16),
            )  # fmt: skip
            if at == len(part):
                return self._verdicts()
            self._make_room(int(control[STOPPED_FOR]), int(control[NEEDED]))

    def _make_room(self, what: int, needed: int) -> None:
        """Make room for what the loop stopped for."""
        match what:
            case loop.PLACES_WANTED:
                counts = self._parts[:, COUNT]
                used = int(np.maximum(2 * counts, loop.FEWEST)[counts > 0].sum())
                wide = _apart(used + used // 2 + needed)
                states = np.empty((len(self._states), wide), np.int64)
                self._control[USED] = loop.move(self._states, states, self._parts)
                self._states = states
            case loop.ROWS_WANTED:
                self._make_rows(2 * needed)
            case loop.ROOM_WANTED:
                more = np.empty((max(needed, len(self._out)), self._out.shape[1]), np.int64)
                self._out = np.concatenate([self._out, more])
            case _:
                raise TooManyStates(
                    f"the formula needs more than {self._limit} states; give its intervals an end, "
                    "or sample less often"
                )

    def _make_fields(self) -> None:
        """Let states have the fields of the program of both readings."""
        fields = _fields(self._monitor, len(self._atoms), self._nodes.shape[1])
        more = fields - len(self._states)
        if more:
            others = np.empty((more, self._states.shape[1]), np.int64)
            self._states = np.concatenate([self._states, others])

    def _make_rows(self, rows: int) -> None:
        """New tables, for so many states of a part."""
        nodes = self._nodes.shape[1]
        tables = 3 * nodes + 2 if self._control[HAS_MARGINS] else nodes
        self._tables = np.empty((tables, _apart(rows)), np.int64)
        self._scratch = np.empty((loop.SCRATCH, max(rows, nodes, 4)), np.int64)

    def _verdicts(self) -> Verdicts:
        """The verdicts since the last time."""
        count, trues, unknowns = self._control[_COUNTS].tolist()
        if not (count or trues or unknowns):
            return self._none
        self._control[_COUNTS] = 0
        # A copy: the loop writes there again.
        part, start, decided, witness, left, value, margin = self._out[:count].T.copy()
        binding = np.zeros((count, 1), np.int64)
        margins = margin.view(np.float64) if self._monitor.robustness else None
        unreported = {1: trues, -1: unknowns}
        return Verdicts(
            part, start, decided, left, value.astype(np.int8), binding, witness, margins, unreported
        )


_COUNTS: Final = slice(EMITTED, UNREPORTED_UNKNOWN + 1)


def _apart(width: int) -> int:
    """At least so many columns, so that those of one number in two rows do not compete for the same
    place in a core's cache."""
    return width if width < 512 else width // 512 * 512 + 536


def _no_parts(count: int) -> NDArray[np.int64]:
    """Parts without states."""
    parts = np.zeros((count, PART_FIELDS), np.int64)
    parts[:, SETTLED] = TIME_MIN
    return parts


def _table(table: Any) -> Any:
    """The number of a table of a program among those of the loop, which has `SIDES` a node."""
    return table // programs.TABLES * SIDES + table % programs.TABLES


def _packed(program: Program) -> NDArray[np.int64]:
    """The nodes of a program, with the tables of the loop."""
    nodes = program.nodes.copy()
    columns = slice(programs.LEFT_T, programs.RIGHT_F + 1)
    nodes[:, columns] = _table(nodes[:, columns])
    return nodes


def _roots(program: Program) -> list[int]:
    lower, upper = program.lower, program.upper
    return [_table(each) for each in (lower.true, lower.false, upper.true, upper.false)]


def _kinds(nodes: NDArray[np.int64]) -> list[int]:
    """What each node is, for the loop."""
    found: list[int] = []
    for node in nodes.tolist():
        operation = node[programs.OPERATION]
        operands = {
            programs.OR: (programs.LEFT_T, programs.RIGHT_T),
            programs.ONCE: (programs.LEFT_T,),
            programs.SPREAD: (programs.LEFT_T,),
        }.get(operation, ())
        is_over_states = all(found[node[each] // SIDES] & layout.OF_STATE for each in operands)
        if operation in _OF_STATES and is_over_states:
            found.append(layout.OF_STATE)
        elif operation == programs.ONCE and is_over_states:
            has_end = node[programs.END] != programs.NO_END
            found.append(0 if has_end else layout.REMEMBERED)
        else:
            found.append(0)
    return found


_OF_STATES: Final = (
    programs.ATOM,
    programs.TRUTH,
    programs.OR,
    programs.SPREAD,
)
