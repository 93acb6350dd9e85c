"""Verdicts of a formula over states that many objects share, 64 objects a word.

For each state from the oldest start without a verdict on, and for each node of the formula, a row
of bits says at which objects the node is known to be true, and a row at which it is false
(`programs`). A new state changes some rows of each node, from the atoms up (`steps`).

While all atoms that matter are known, both readings of unknown atoms are one. The first that is not
known begins a program of both readings over the states kept, from their atoms; when it matters no
more, that of one reading goes on.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ....languages.mtl.ast import Report
from ....languages.mtl.checked import (
    CheckedMonitor,
    Formula,
    Until,
    Within,
)
from ....streams.jit import JIT
from ....streams.sample import Mask, Times
from ....streams.time import TIME_MIN
from ...states.states import States, Term
from .. import programs
from ..evaluator import MOST_STATES, TooManyStates, Verdicts, concatenated, no_verdicts
from ..formulas import earliest, looks_back, sorts_of
from ..nodes import END, Pass, Threshold, terms_of
from ..programs import Compiler, Program
from . import layout, verdicts
from .layout import CONTROLS

ROWS: Final = 64
"""The least number of states that there is room for."""
CELLS: Final = 1 << 12
"""Words of a table that are filled at once: some dozens of such tables fit into a core's cache."""
_COUNTS: Final = slice(layout.EMITTED, layout.UNKNOWNS + 1)


def bits_of_state(monitor: CheckedMonitor) -> int:
    """Return the bits of a state for an object, in one reading: of the nodes and atoms, whether it
    is there, and whether its verdict is out and new. Contract: `is_sliced`."""
    compiler = Compiler(monitor)
    nodes = len(compiler.program(has_two_readings=False).nodes)
    return nodes * programs.TABLES + 2 * len(compiler.atoms) + len(compiler.domains) + 2


def is_sliced(monitor: CheckedMonitor) -> bool:
    """Whether this evaluator takes a monitor whose objects share their states."""
    return JIT and programs.is_sliced(monitor)


class SlicedEvaluator:
    """Verdicts of a monitor over shared states. Contract: `is_sliced`.

    Law (tests/laws/reasoning): those of `MonitorEvaluator`, in the same order, with the same
    witnesses; a report of violations counts the others.

    Cost: for each state and node, words of objects / 64 for each row that changes or waits; at most
    the states of the longest interval, for `until`, `since` and the past times those of its
    interval. Memory: 4 bits a node, object and state kept, in each reading. Kept are the states
    that `MonitorEvaluator` keeps.
    """

    def __init__(self, monitor: CheckedMonitor, *, limit: int = MOST_STATES) -> None:
        self._monitor = monitor
        self._limit = limit
        self._sorts = sorts_of(monitor)
        self._compiler = Compiler(monitor)
        self._looks_back = looks_back(monitor.formula)
        self._count = 0
        """The states in the rows; those before the first row were dropped."""
        self._atoms = [
            (each, Threshold.of_atom(each, self._sorts)) for each in self._compiler.atoms
        ]
        self._domains_of_atoms = list(map(self._compiler.domain, self._compiler.atoms))
        self._objects = [1] + [0] * (len(self._compiler.domains) - 1)
        """The columns in use of each domain."""
        self._last_unknown = -1
        """The row of the last state with an unknown atom."""
        self.seen = 0
        """The number of states by now."""
        self._control = np.zeros(CONTROLS, np.int64)
        self._control[layout.IS_WHOLE] = 1
        self._control[layout.LOOKS_BACK] = self._looks_back
        self._control[layout.REPORTS_ALL] = monitor.report is not Report.VIOLATIONS
        self._control[layout.ROOT_DOMAIN] = self._compiler.root_domain
        self._out = np.empty((256, 6), np.int64)
        self._none = no_verdicts(len(monitor.parameters))
        self._programs = [self._compiler.program(has_two_readings=each) for each in (False, True)]
        self._has_two_readings = False
        self._make_tables(ROWS, np.ones(len(self._objects), np.int64))

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_bytes"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._bytes = self._tables.view(np.uint8)

    @property
    def terms(self) -> frozenset[Term]:
        """The terms whose values `push` needs."""
        return terms_of(self._monitor.formula, self._sorts)

    @property
    def pending(self) -> int:
        """The states kept."""
        return self._count - self._oldest()

    @property
    def states(self) -> States | None:
        """None: the values of states are not kept."""
        return None

    @property
    def is_open(self) -> bool:
        """Whether a start seen by now has no verdict yet."""
        return int(self._control[layout.OPEN]) < self._count

    def settled(self) -> NDArray[np.int64]:
        """As `MonitorEvaluator.settled`."""
        domain = self._compiler.root_domain
        rows = slice(int(self._control[layout.OPEN]), self._count)
        present = self._tables[self._control[layout.PRESENT] + domain, rows]
        bits = present & ~self._tables[self._control[layout.DONE], rows]
        is_open = _unpacked(bits, self._objects[domain])
        # Where none is open all starts by now have their verdicts.
        after = np.append(self._valid[rows], self._valid[self._count - 1] + 1)
        is_open = np.concatenate([is_open, np.ones((1, is_open.shape[1]), np.bool_)])
        found: NDArray[np.int64] = after[is_open.argmax(axis=0)]
        return found if self._monitor.parameters else found[0]

    def push(self, states: States, left: Times | None = None) -> Verdicts:
        """As `MonitorEvaluator.push`."""
        count, at = len(states.valid), 0
        if not count:
            return self._none
        left = states.valid if left is None else left
        self._widen(states)
        found = []
        while at < count:
            cut = slice(at, at + self._make_room(count - at))
            some = states if cut == slice(0, count) else states.take(cut)
            found.append(self._taken(some, left[cut]))
            at = cut.stop
        return found[0] if len(found) == 1 else concatenated(found)

    def advance(self, horizon: int) -> Verdicts:
        """As `MonitorEvaluator.advance`."""
        if not self.is_open:
            return self._none
        last = self._count - 1
        self._horizon[last] = max(int(self._horizon[last]), horizon)
        self._run(last, self._count, is_new=False)
        return self._emitted()

    def end(self) -> Verdicts:
        """Learn that no further state comes."""
        return self.advance(END)

    # -- states ------------------------------------------------------------------------------

    def _taken(self, states: States, left: Times) -> Verdicts:
        """Take states for which there are rows."""
        begin, count = self._count, len(states.valid)
        rows = slice(begin, begin + count)
        self._valid[rows], self._horizon[rows] = states.valid, states.horizon
        self._left[rows] = left
        control = self._control
        first = int(control[layout.PRESENT])
        for domain, sort in enumerate(self._compiler.domains[1:], start=1):
            self._put(first + domain, rows, states.present[sort])
        # A single start is the first state of all.
        done = self._tables[control[layout.DONE], rows]
        done[:] = ~np.uint64(0) if self._monitor.once else np.uint64(0)
        if self._monitor.once and not self.seen:
            done[0] = 0
        is_unknown = self._take_atoms(states, rows)
        self.seen += count
        cut = begin
        if is_unknown is not None and is_unknown.any():
            unknown = np.flatnonzero(is_unknown) + begin
            if not self._has_two_readings:
                cut = int(unknown[0])
                self._count = cut
                self._run(begin, cut)
                self._read(two_readings=True)
            self._last_unknown = int(unknown[-1])
        self._count = begin + count
        self._run(cut, self._count)
        found = self._emitted()
        if self._has_two_readings and self._last_unknown < self._oldest():
            self._read(two_readings=False)
        return found

    def _take_atoms(self, states: States, rows: slice) -> Mask | None:
        """Take the values of atoms; return at which states one that matters is unknown, or None."""
        once = found = None
        for number, (atom, threshold) in enumerate(self._atoms):
            if threshold is None:
                once = once or Pass(states, self._sorts)
                _, holds, known = once.atom(atom)
            else:
                holds, known = threshold.of(states)
            if holds.ndim == 1:
                holds = holds[:, None]
            domain = self._domains_of_atoms[number]
            table = int(self._control[layout.HOLDS]) + number
            if known is None:
                self._put(table, rows, holds)
                self._tables[table + len(self._compiler.atoms), rows] = self._used[domain]
                continue
            known = known.reshape(holds.shape)
            self._put(table, rows, holds & known)
            self._put(table + len(self._compiler.atoms), rows, known)
            unknown: Mask = np.logical_or.reduce(~known & self._matters(domain, states), axis=1)
            found = unknown if found is None else found | unknown
        return found

    def _put(self, table: int, rows: slice, bits: Mask) -> None:
        """Write truths, shape ``(states, objects)``, into rows of a table."""
        packed = np.packbits(bits, axis=1, bitorder="little")
        self._bytes[table, rows, : packed.shape[1]] = packed

    def _matters(self, domain: int, states: States) -> Mask:
        """At which states and objects it matters whether an atom is known: of those that were there
        at a start without a verdict. The past may be that of an object to come."""
        if self._looks_back or not domain:
            return np.ones((1, 1), np.bool_)
        table = self._tables[self._control[layout.PRESENT] + domain]
        rows = table[int(self._control[layout.OPEN]) : self._count]
        before = _unpacked(np.bitwise_or.reduce(rows, axis=0)[None], self._objects[domain])
        present = states.present[self._compiler.domains[domain]]
        return np.logical_or.accumulate(np.concatenate([before, present]))[1:]

    # -- room --------------------------------------------------------------------------------

    def _make_tables(self, rows: int, words: NDArray[np.int64]) -> None:
        """New tables for the program."""
        nodes, control = len(self._program.nodes), self._control
        wide = int(words.max())
        atoms, domains = len(self._compiler.atoms), len(words)
        tables = nodes * programs.TABLES
        control[layout.HOLDS] = tables
        control[layout.KNOWN] = tables + atoms
        control[layout.PRESENT] = tables + 2 * atoms
        control[layout.DONE] = tables + 2 * atoms + domains
        control[layout.NEWS] = tables + 2 * atoms + domains + 1
        lower, upper = self._program.lower, self._program.upper
        control[layout.LOWER_T : layout.UPPER_F + 1] = (
            lower.true, lower.false, upper.true, upper.false,
        )  # fmt: skip
        self._tables = np.zeros((tables + 2 * atoms + domains + 2, rows, wide), np.uint64)
        # A view: pickle would make a copy of it.
        self._bytes = self._tables.view(np.uint8)
        # A closed formula is about something that is always there.
        self._tables[tables + 2 * atoms, :, 0] = 1
        self._valid, self._horizon, self._left = np.zeros((3, rows), np.int64)
        self._words = words
        self._full = np.zeros((nodes, rows), np.uint8)
        self._stamp, self._changed = np.zeros((2, nodes, rows), np.int64)
        self._changes, self._first, self._closed = np.zeros((3, nodes), np.int64)
        self._spare = np.zeros((4, wide), np.uint64)
        self._fresh = np.zeros(2 * rows, np.int64)
        self._use_columns()

    def _use_columns(self) -> None:
        """Let nodes wait for the objects that there are; for all columns where the past of an
        object to come counts."""
        self._used = np.zeros((len(self._words), self._tables.shape[2]), np.uint64)
        for domain, objects in enumerate(self._objects):
            packed = np.packbits(np.ones(objects, np.bool_), bitorder="little")
            self._used.view(np.uint8)[domain, : len(packed)] = packed
        self._masks = self._used.copy()
        if self._looks_back:
            self._masks[1:] = ~np.uint64(0)

    def _widen(self, states: States) -> None:
        """Let there be columns for all objects of the states."""
        objects = [1, *(states.present[sort].shape[1] for sort in self._compiler.domains[1:])]
        if objects == self._objects:
            return
        self._objects = objects
        words = (np.array(objects) + 63) // 64
        if (words > self._words).any():
            # A quarter more, as more objects may come.
            self._again(np.where(words > self._words, words + words // 4, self._words))
        else:
            self._use_columns()
        if self._looks_back and self._count:
            # The states before an object came are unknown to it.
            self._last_unknown = self._count - 1
            if not self._has_two_readings:
                self._read(two_readings=True)

    def _make_room(self, wanted: int) -> int:
        """Make room for some of so many states; return for how many."""
        rows = self._tables.shape[1]
        if self._count + wanted > rows:
            kept = self.pending
            most = min(wanted, self._limit - kept)
            if most < 1:
                raise TooManyStates(
                    f"the formula needs more than {self._limit} states; give its intervals an end, "
                    "or sample less often"
                )
            # So many that states kept are moved seldom.
            batch = min(most, CELLS // self._tables.shape[2])
            needed = max(ROWS, 2 * kept + 1, kept + batch)
            self._move(needed if needed > rows or 4 * needed < rows else rows)
            rows = self._tables.shape[1]
        return min(wanted, rows - self._count)

    def _move(self, rows: int) -> None:
        """Drop the states that are needed no more; let there be so many rows. Contract: a state
        follows, as the rows that changed last are forgotten."""
        oldest, count = self._oldest(), self._count
        old, pointers = self._arrays, (self._first, self._closed)
        if rows != self._tables.shape[1]:
            self._make_tables(rows, self._words)
        for new, before in zip(self._arrays, old, strict=True):
            if new.ndim == 1:
                new[: count - oldest] = before[oldest:count]
            else:
                new[:, : count - oldest] = before[:, oldest:count]
        # Rows of the nodes begin empty.
        self._tables[: int(self._control[layout.HOLDS]), count - oldest : count] = 0
        self._first, self._closed = (np.maximum(each - oldest, 0) for each in pointers)
        self._count -= oldest
        self._last_unknown -= oldest
        self._control[layout.OPEN] -= oldest
        if oldest:
            self._control[layout.IS_WHOLE] = 0

    @property
    def _arrays(self) -> tuple[NDArray[Any], ...]:
        """Those with an entry a state: their second axis is that of states, or their only one."""
        return self._tables, self._full, self._stamp, self._valid, self._horizon, self._left

    @property
    def _program(self) -> Program:
        """That of the reading, or of both."""
        return self._programs[self._has_two_readings]

    def _read(self, *, two_readings: bool) -> None:
        """Evaluate unknown atoms in two readings, or all are known."""
        self._has_two_readings = two_readings
        self._again(self._words)

    def _again(self, words: NDArray[np.int64]) -> None:
        """Evaluate the states in the rows again, from their atoms: by another program, or over more
        words."""
        given, times = self._given, (self._valid, self._horizon, self._left)
        self._make_tables(len(self._valid), words)
        self._given[:, :, : given.shape[2]] = given
        self._valid, self._horizon, self._left = times
        self._control[layout.IS_REPLAY] = 1
        self._run(0, self._count)
        self._control[layout.IS_REPLAY] = 0
        if not self._looks_back:
            np.maximum(self._first, self._control[layout.OPEN], out=self._first)

    @property
    def _given(self) -> NDArray[np.uint64]:
        """The tables that do not follow from others."""
        control = self._control
        return self._tables[control[layout.HOLDS] : control[layout.DONE] + 1]

    def _oldest(self) -> int:
        """The row of the first state that a verdict to come needs."""
        if not self._count:
            return 0
        # The last one stays: `advance` raises its horizon, and past operators look back from it.
        row = min(int(self._control[layout.OPEN]), self._count - 1)
        return int(earliest(self._monitor.formula, row, self._back)) if self._looks_back else row

    def _back(self, formula: Formula, row: int) -> int:
        """The first row that an operator of the past looks at from a row."""
        if not isinstance(formula, Within | Until):
            return max(row - 1, 0)
        end = formula.interval.end
        assert end is not None, "a past interval has an end"
        limit = max(int(self._valid[row]) - end, TIME_MIN)
        return int(self._valid[: row + 1].searchsorted(limit))

    # -- verdicts ----------------------------------------------------------------------------

    def _run(self, begin: int, end: int, *, is_new: bool = True) -> None:
        size = (end - begin) * self._tables.shape[2]
        while begin < end:
            begin = verdicts.run.run(
                self._tables, self._valid, self._horizon, self._program.nodes, self._words,
                self._masks, self._full, self._stamp, self._changed, self._changes, self._first,
                self._closed, self._spare, self._fresh, self._control, self._out, begin, end,
                int(is_new), size=size,
            )  # fmt: skip
            if begin < end:
                self._out = np.concatenate([self._out, np.empty_like(self._out)])

    def _emitted(self) -> Verdicts:
        """The verdicts since the last time."""
        control = self._control
        count, trues, unknowns = control[_COUNTS].tolist()
        control[_COUNTS] = 0
        unreported = {1: trues, -1: unknowns}
        if not count:
            none = self._none
            return Verdicts(
                none.part, none.start_time, none.decided_time, none.left, none.value, none.binding,
                none.witness_time, unreported=unreported,
            )  # fmt: skip
        start, decided, witness, row, place, value = self._out[:count].T.copy()
        return Verdicts(
            np.zeros(count, np.int64),
            start,
            decided,
            self._left[row],
            value.astype(np.int8),
            place.reshape(-1, 1)[:, : len(self._monitor.parameters)],
            witness,
            unreported=unreported,
        )


def _unpacked(words: NDArray[np.uint64], objects: int) -> Mask:
    """The truths of so many objects, shape ``(n, objects)``, in words of shape ``(n, words)``."""
    found = np.unpackbits(words.view(np.uint8), axis=1, count=objects, bitorder="little")
    return found.astype(np.bool_)
