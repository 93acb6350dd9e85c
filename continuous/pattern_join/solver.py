"""Joins of triple patterns by a compiled loop, over the rows of all windows as numbers.

The loop evaluates the parts of a plan that are patterns with constant predicates, their joins, and
numeric filters on them (`plan_cut`); `executor` evaluates the rest. Law (tests/laws): the solutions
equal those of `executor.execute`, in an order that depends on the rows and the evaluations only.

Cost: some ten microseconds per window, then tens of nanoseconds per new row and per step of its
joins, and a few per solution that stays. Memory: some 200 bytes per triple of the windows; per
solution 4 bytes per pattern and 9 per variable; static triples of the named predicates once. If
there are many more solutions than triples, they are not kept but found again each time.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import NamedNode

from ...rdf.dictionary import HeldTerms
from ...rdf.namespaces import RDF_TYPE
from ...rdf.timed import Kind, ObjectColumn
from ..algebra.expressions import (
    Call,
    Const,
    Expression,
    Var,
    postorder,
    variables,
)
from ..algebra.plan import Plan, Position, TypeScan, outputs
from ..columns.budget import BudgetExceeded
from ..columns.relation import Relation, TermValues, decode, decode_terms
from ..operators.sources import StaticSide
from ..values.literals import canonical
from .join_kernel import CONSTANT, DOUBTFUL, OVERSPENT, VARIABLE, match
from .plan_cut import OPERATIONS, Slot, conditions, leaves, slot_of
from .row_kernels import BY_OBJECT, BY_SLOT, BY_SUBJECT, BY_TRIPLE, LOST
from .static_rows import StaticArrays, StaticRows
from .window_rows import PatternRows

_FIRST_CAPACITY = 256
_MOST = 4
"""The greatest number of kept solutions per row."""
_NEVER = -2
_KINDS = tuple(Kind)


class PatternJoin:
    """One part of a plan as tables for the compiled loop."""

    def __init__(
        self, part: Plan, shown: frozenset[str], slots: Mapping[Slot, int], terms: TermValues
    ) -> None:
        self.terms = terms
        self.variables = tuple(sorted(outputs(part)))
        self._shown = [name for name in self.variables if name in shown]
        places = [self._shown.index(name) if name in shown else -1 for name in self.variables]
        self._places = np.array(places, np.int64)
        place = {name: i for i, name in enumerate(self.variables)}
        constants: dict[Const, int] = {}

        def position(one: Position) -> int:
            if isinstance(one, Var):
                return place[one.name]
            return -1 - constants.setdefault(one, len(constants))

        rows = []
        for leaf in leaves(part):
            object = leaf.sort if isinstance(leaf, TypeScan) else leaf.object
            rows.append([slots[slot_of(leaf)], position(leaf.subject), position(object)])
        self.patterns = np.array(rows, np.int64).reshape(-1, 3)
        operations: list[tuple[int, int]] = []
        starts, needs = [0], []
        for condition in conditions(part):
            operations.extend(_compiled(condition, place, constants))
            starts.append(len(operations))
            names = variables(condition)
            needs.append([name in names for name in self.variables])
        self.operations = np.array(operations, np.int64).reshape(-1, 2)
        self.filter_starts = np.array(starts, np.int64)
        self.filter_needs = np.array(needs, np.bool_)
        self.filter_needs = self.filter_needs.reshape(len(needs), len(self.variables))
        # The loop compares ids of canonical terms. `HeldTerms` keeps those in the dictionary.
        self._named = HeldTerms(terms.dictionary, (canonical(one.term) for one in constants))
        encoded = terms.encode(ObjectColumn(Kind.TERM, self._named.ids))
        self.constant_tags, self.constant_bits = encoded
        self._uniform = np.zeros(len(self._shown), np.int8)
        self._kept, self._seen, self._seen_selection = 0, 0, _NEVER
        """The numbers of kept solutions and of rows at the last evaluation, and its selection."""
        self._entered = np.zeros(len(slots), np.int64)
        self._solutions: NDArray[np.int32] = np.empty((0, len(rows) + 1), np.int32)
        self._tags: NDArray[np.int8] = np.empty((len(self._shown), 0), np.int8)
        self._bits: NDArray[np.int64] = np.empty((len(self._shown), 0), np.int64)

    def chains(self) -> Iterable[tuple[int, int]]:
        """Yield the chains that the loop may follow, as slot and bit."""
        ends = self.patterns[:, 1:].tolist()
        all_ends = [end for pair in ends for end in set(pair)]
        for slot, subject, object in self.patterns.tolist():
            # A variable at another end, too, may be bound before the loop gets to this pattern.
            by_subject, by_object = (
                end < 0 or all_ends.count(end) > 1 for end in (subject, object)
            )
            yield slot, 1 << BY_SLOT
            if by_subject or subject == object:
                yield slot, 1 << BY_SUBJECT
            if by_object:
                yield slot, 1 << BY_OBJECT
            if by_subject and by_object:
                yield slot, 1 << BY_TRIPLE

    def solve(self, rows: PatternRows, static: StaticArrays) -> Relation | None:
        """Return the solutions over these rows; None if `expression_evaluation` must evaluate a
        filter."""
        # Rows of a selection without evaluation may have expired, so the kept solutions are stale.
        from_scratch = self._seen_selection != rows.selections - 1
        if from_scratch:
            self._kept = 0
        most_kept = _FIRST_CAPACITY + _MOST * rows.count
        while True:
            with self.terms.budget.pauses.released():
                stayed, found = match(
                    rows.rows,
                    rows.heads,
                    rows.sizes,
                    rows.visible,
                    rows.floors,
                    rows.marks,
                    *static,
                    self._seen,
                    rows.entered - self._entered,
                    from_scratch,
                    len(rows.windows),
                    self.patterns,
                    rows.needed,
                    self.constant_tags,
                    self.constant_bits,
                    self.operations,
                    self.filter_starts,
                    self.filter_needs,
                    self.terms.sorts_by_id,
                    self._places,
                    self._solutions,
                    self._kept,
                    self._tags,
                    self._bits,
                    self._uniform,
                    self.terms.budget.row_visits,
                )
            # The loop has stopped half-way, so its arrays are whole for no window.
            if found == DOUBTFUL:
                self.reset()
                return None
            if found == OVERSPENT:
                self.reset()
                limit = self.terms.budget.row_visits
                raise BudgetExceeded(f"a join looks at more than {limit} rows for a window")
            try:
                self.terms.budget.check(found, "a join")
            except BudgetExceeded:
                self.reset()
                raise
            if found <= self._bits.shape[1]:
                break
            keeps = found <= most_kept
            # The old solutions that stay are in place: the next try finds the new ones only.
            self._kept = stayed if keeps else 0
            from_scratch |= not keeps
            self._make_room(2 * found, keeps=keeps)
        keeps = found <= most_kept and self._solutions.shape[1] > 0
        relation = Relation(self._columns(found, copied=keeps), found)
        if keeps:
            self._kept, self._seen, self._seen_selection = found, rows.count, rows.selections
            self._entered = rows.entered.copy()
            if self._bits.shape[1] > 8 * max(found, _FIRST_CAPACITY):
                self._make_room(2 * found)
        else:
            # The result owns these arrays now.
            self.reset()
            self._make_room(2 * found, keeps=found <= most_kept)
        return relation

    def _columns(self, found: int, *, copied: bool) -> dict[str, ObjectColumn]:
        columns = {}
        for i, name in enumerate(self._shown):
            tag, words = self._uniform[i], self._bits[i, :found]
            if tag < 0:
                columns[name] = decode_terms(self._tags[i, :found], words, self.terms.dictionary)
            else:
                # The next window writes over kept arrays, but callers keep results.
                column = decode(_KINDS[tag], words)
                # Values that are not of 64 bits have been copied by `decode`.
                if copied and column.values.itemsize == words.itemsize:
                    column = ObjectColumn(column.kind, column.values.copy())
                columns[name] = column
        return columns

    def reset(self) -> None:
        """Drop all kept solutions."""
        self._kept, self._seen, self._seen_selection = 0, 0, _NEVER

    def renumber_rows(self, moved: NDArray[np.int64]) -> None:
        """Replace row numbers in kept solutions after rows have moved."""
        self._seen = int(np.count_nonzero(moved[: self._seen] != LOST))
        solutions = self._solutions[: self._kept]
        if solutions.size and len(moved):
            stays = (solutions < 0) | (solutions >= len(moved))
            solutions[:] = np.where(stays, solutions, moved.take(solutions, mode="clip"))

    def _make_room(self, capacity: int, *, keeps: bool = True) -> None:
        """Allocate space for ``capacity`` solutions; ``keeps``: copy the kept ones."""
        capacity, kept = max(capacity, _FIRST_CAPACITY), self._kept
        before = self._solutions, self._tags, self._bits
        width = len(self.patterns) + 1 if keeps else 0
        self._solutions = np.empty((capacity if keeps else 0, width), np.int32)
        shape = (len(self._shown), capacity)
        self._tags, self._bits = np.empty(shape, np.int8), np.empty(shape, np.int64)
        if kept:
            self._solutions[:kept] = before[0][:kept]
            self._tags[:, :kept], self._bits[:, :kept] = before[1][:, :kept], before[2][:, :kept]


def _compiled(
    expression: Expression, place: Mapping[str, int], constants: dict[Const, int]
) -> Iterable[tuple[int, int]]:
    """Yield the operations of a filter, arguments first."""
    for one in postorder(expression):
        match one:
            case Var(name):
                yield VARIABLE, place[name]
            case Const():
                yield CONSTANT, constants.setdefault(one, len(constants))
            case Call(name):
                yield OPERATIONS[name], 0


class PatternSolver:
    """All parts of a query's plan that the loop evaluates, over the same rows."""

    def __init__(
        self,
        parts: Sequence[tuple[Plan, frozenset[str]]],
        windows: Sequence[str],
        static: StaticSide,
        *,
        distinct: bool,
    ) -> None:
        """``parts``: each with its variables that the rest of the plan uses."""
        self.static = static
        named = (slot_of(leaf) for part, _ in parts for leaf in leaves(part))
        slots = list(dict.fromkeys(named))
        numbered = {slot: number for number, slot in enumerate(slots)}
        self._parts = [
            (part, PatternJoin(part, shown, numbered, static.terms)) for part, shown in parts
        ]
        self._joins = _by_identity(self._parts)
        # Sorts are a set of facts under either semantics.
        once = np.array([distinct or s.predicate == RDF_TYPE for s in slots], np.bool_)
        needed = np.where(once, 1 << BY_TRIPLE, 0)
        for join in self._joins.values():
            for slot, chain in join.chains():
                needed[slot] |= chain
        self.rows = PatternRows(slots, windows, static.terms, once, needed)
        self._static_rows = StaticRows(slots, frozenset(w for w in windows if w), static, needed)
        self._version: int | None = None
        self._expanded: tuple[int, int] | None = None
        self._expansion: tuple[NDArray[np.int64], ...] = ()
        self._expanded_sorts: list[HeldTerms] = []

    def __getstate__(self) -> dict[str, Any]:
        # The keys are identities, which are others in the process that reads the state.
        return {**self.__dict__, "_joins": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _joins=_by_identity(state["_parts"]))

    def select(self, lows: NDArray[np.int64], highs: NDArray[np.int64]) -> None:
        """Move the windows to these bounds: `solve` reads their rows from now on."""
        version = self.static.background.version
        if version != self._version:
            if self._version is not None:
                self.rows.reinsert_rows()
                for join in self._joins.values():
                    join.reset()
            self._version = version
        self._move(self.rows.select(lows, highs, self._sorts(), self._static_rows.arrays))

    def drop(self) -> None:
        """Drop expired rows."""
        if self.rows.is_full:
            self._move(self.rows.compact())

    def _move(self, moved: NDArray[np.int64] | None) -> None:
        if moved is not None:
            for join in self._joins.values():
                join.renumber_rows(moved)

    def solve(self, part: Plan) -> Relation | None:
        """Return the solutions of a part; None if the loop does not evaluate it, or cannot for this
        data."""
        join = self._joins.get(id(part))
        if join is None or self._version is None:
            return None
        return join.solve(self.rows, self._static_rows.arrays)

    def _sorts(self) -> tuple[NDArray[np.int64], ...]:
        """Return the facts that each annotated sort implies: windows, slots and classes."""
        state = (self.static.background.version, len(self.rows.sorts))
        if state != self._expanded:
            self._expanded = state
            starts, facts = [0], []
            self._expanded_sorts = []
            for sort in self.rows.sorts:
                for window, graph in enumerate(self.rows.windows):
                    slot = self.rows.slots.get(Slot(graph, RDF_TYPE))
                    if slot is not None:
                        names = sorted(self.static.supersorts(sort))
                        named = HeldTerms(self.static.terms.dictionary, map(NamedNode, names))
                        self._expanded_sorts.append(named)
                        facts += [(window, slot, int(id)) for id in named.ids]
                starts.append(len(facts))
            table = np.array(facts, np.int64).reshape(-1, 3)
            self._expansion = (
                np.array(starts, np.int64),
                *(np.ascontiguousarray(table[:, i]) for i in range(3)),
            )
        return self._expansion


def _by_identity(parts: Sequence[tuple[Plan, PatternJoin]]) -> dict[int, PatternJoin]:
    """Key parts by identity: hashing a deep plan would cost more than its evaluation."""
    return {id(part): join for part, join in parts}
