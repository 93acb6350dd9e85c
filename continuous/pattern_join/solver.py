"""Triple patterns joined by a compiled loop, over the rows of all windows as numbers.

It serves a plan's parts that are patterns with constant predicates, their joins, and filters of
numbers on them (`plan_cut`); what stands above is executed by `executor`. Law (tests/laws):
the same solutions as `executor.execute` gives for that part, in an order that depends on the rows
and the evaluations only.

Cost: some ten microseconds a window, then tens of nanoseconds a row that has come and a step of its
joins, and a few a solution that stays. Memory: some 200 bytes a triple of the windows; a solution
takes 4 bytes a pattern and 9 a variable, and where they are many more than the triples they are not
kept, and found anew each time; static triples of the named predicates once.
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
from ..columns.relation import Relation, TermValues, decoded, decoded_terms
from ..operators.sources import StaticSide
from ..values.literals import canonical
from .join_kernel import CONSTANT, DOUBTFUL, OVERSPENT, VARIABLE, match
from .plan_cut import OPERATIONS, Slot, conditions, leaves, slot_of
from .row_kernels import BY_OBJECT, BY_SLOT, BY_SUBJECT, BY_TRIPLE, LOST
from .static_rows import StaticArrays, StaticRows
from .window_rows import PatternRows

_FIRST_CAPACITY = 256
_MOST = 4
"""So many solutions a row are kept."""
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
        # In the spelling that is compared: the loop has their ids as long as there is one.
        self._named = HeldTerms(terms.dictionary, (canonical(one.term) for one in constants))
        encoded = terms.encoded(ObjectColumn(Kind.TERM, self._named.ids))
        self.constant_tags, self.constant_bits = encoded
        self._uniform = np.zeros(len(self._shown), np.int8)
        self._kept, self._seen, self._seen_turn = 0, 0, _NEVER
        """So many solutions are known, of so many rows, as of this turn."""
        self._entered = np.zeros(len(slots), np.int64)
        self._solutions: NDArray[np.int32] = np.empty((0, len(rows) + 1), np.int32)
        self._tags: NDArray[np.int8] = np.empty((len(self._shown), 0), np.int8)
        self._bits: NDArray[np.int64] = np.empty((len(self._shown), 0), np.int64)

    def chains(self) -> Iterable[tuple[int, int]]:
        """The chains that the loop may walk along, as slot and bit."""
        ends = self.patterns[:, 1:].tolist()
        known = [end for pair in ends for end in set(pair)]
        for slot, subject, object in self.patterns.tolist():
            by_subject, by_object = (end < 0 or known.count(end) > 1 for end in (subject, object))
            yield slot, 1 << BY_SLOT
            if by_subject or subject == object:
                yield slot, 1 << BY_SUBJECT
            if by_object:
                yield slot, 1 << BY_OBJECT
            if by_subject and by_object:
                yield slot, 1 << BY_TRIPLE

    def solve(self, rows: PatternRows, static: StaticArrays) -> Relation | None:
        """The solutions over these rows; None where a filter has to be judged by
        `expression_evaluation`."""
        # What came in a turn that it has not seen may have gone: then it is not told what is new.
        whole = self._seen_turn != rows.turns - 1
        if whole:
            self._kept = 0
        most = _FIRST_CAPACITY + _MOST * rows.count
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
                    whole,
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
                    self.terms.budget.looks,
                )
            if found == DOUBTFUL:
                self.forget()
                return None
            if found == OVERSPENT:
                self.forget()
                looks = self.terms.budget.looks
                raise BudgetExceeded(f"a join looks at more than {looks} rows for a window")
            try:
                self.terms.budget.check(found, "a join")
            except BudgetExceeded:
                self.forget()
                raise
            if found <= self._bits.shape[1]:
                break
            keeps = found <= most
            self._kept = stayed if keeps else 0
            whole |= not keeps
            self._make_room(2 * found, keeps=keeps)
        keeps = found <= most and self._solutions.shape[1] > 0
        relation = Relation(self._columns(found, copied=keeps), found)
        if keeps:
            self._kept, self._seen, self._seen_turn = found, rows.count, rows.turns
            self._entered = rows.entered.copy()
            if self._bits.shape[1] > 8 * max(found, _FIRST_CAPACITY):
                self._make_room(2 * found)
        else:
            # The result has these arrays.
            self.forget()
            self._make_room(2 * found, keeps=found <= most)
        return relation

    def _columns(self, found: int, *, copied: bool) -> dict[str, ObjectColumn]:
        columns = {}
        for i, name in enumerate(self._shown):
            tag, words = self._uniform[i], self._bits[i, :found]
            if tag < 0:
                columns[name] = decoded_terms(self._tags[i, :found], words, self.terms.dictionary)
            else:
                column = decoded(_KINDS[tag], words)
                # What is not of 64 bits is another array already.
                if copied and column.values.itemsize == words.itemsize:
                    column = ObjectColumn(column.kind, column.values.copy())
                columns[name] = column
        return columns

    def forget(self) -> None:
        """No solution is known."""
        self._kept, self._seen, self._seen_turn = 0, 0, _NEVER

    def moved(self, moved: NDArray[np.int64]) -> None:
        """Rows have gone to these places."""
        self._seen = int(np.count_nonzero(moved[: self._seen] != LOST))
        known = self._solutions[: self._kept]
        if known.size and len(moved):
            stays = (known < 0) | (known >= len(moved))
            known[:] = np.where(stays, known, moved.take(known, mode="clip"))

    def _make_room(self, capacity: int, *, keeps: bool = True) -> None:
        """Room for so many solutions; ``keeps``: with those that are known."""
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
    """The operations of a filter, arguments first."""
    for one in postorder(expression):
        match one:
            case Var(name):
                yield VARIABLE, place[name]
            case Const():
                yield CONSTANT, constants.setdefault(one, len(constants))
            case Call(name):
                yield OPERATIONS[name], 0


class PatternSolver:
    """All served parts of a query's plan, over the same rows."""

    def __init__(
        self,
        parts: Sequence[tuple[Plan, frozenset[str]]],
        windows: Sequence[str],
        static: StaticSide,
        *,
        distinct: bool,
    ) -> None:
        """``parts``: each with the variables that are looked at outside it."""
        self.static = static
        named = (slot_of(leaf) for part, _ in parts for leaf in leaves(part))
        slots = list(dict.fromkeys(named))
        numbered = {slot: number for number, slot in enumerate(slots)}
        self._parts = [
            (part, PatternJoin(part, shown, numbered, static.terms)) for part, shown in parts
        ]
        self._joins = _by_identity(self._parts)
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
        return {**self.__dict__, "_joins": None}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        self.__dict__.update(kept, _joins=_by_identity(kept["_parts"]))

    def turn(self, lows: NDArray[np.int64], highs: NDArray[np.int64]) -> None:
        """The windows whose bounds these are: what `solve` is about from now on."""
        version = self.static.background.version
        if version != self._version:
            if self._version is not None:
                self.rows.start_anew()
                for join in self._joins.values():
                    join.forget()
            self._version = version
        self._move(self.rows.turn(lows, highs, self._sorts(), self._static_rows.arrays))

    def drop(self) -> None:
        """Forget what has left the windows."""
        if self.rows.is_full:
            self._move(self.rows.compact())

    def _move(self, moved: NDArray[np.int64] | None) -> None:
        if moved is not None:
            for join in self._joins.values():
                join.moved(moved)

    def solve(self, part: Plan) -> Relation | None:
        """The solutions of a part; None if it is not served, or cannot be with this data."""
        join = self._joins.get(id(part))
        if join is None or self._version is None:
            return None
        return join.solve(self.rows, self._static_rows.arrays)

    def _sorts(self) -> tuple[NDArray[np.int64], ...]:
        """For each annotated sort the facts it stands for: windows, slots and classes."""
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
    """Parts are told apart by identity, which hashing a deep plan would cost more than."""
    return {id(part): join for part, join in parts}
