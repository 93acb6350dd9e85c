"""Triple patterns joined by a compiled loop, over the rows of all windows as numbers.

It serves a plan's parts that are patterns with constant predicates, their joins, and filters of
numbers on them (`pattern_parts`); what stands above is executed by `relational`. Law (tests/laws):
the same solutions as `relational.execute` gives for that part, in an order that depends on the rows
only.

Cost: a few microseconds a window, then tens of nanoseconds a row of the window and a step of the
join. Memory: 26 bytes a triple of the windows; static triples of the named predicates once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import NamedNode

from ..rdf.namespaces import RDF_TYPE
from ..rdf.timed import Kind, ObjectColumn
from .columns import Relation, TermValues, canonical, decoded, decoded_terms
from .expressions import Call, Const, Expression, Var, variables
from .logical import Plan, Position, TypeScan, outputs
from .pattern_kernels import CONSTANT, DOUBTFUL, VARIABLE, match, select
from .pattern_parts import OPERATIONS, Slot, conditions, leaves, slot_of
from .pattern_rows import PatternRows, StaticRows
from .sources import StaticSide

_FIRST_CAPACITY = 256
_KINDS = tuple(Kind)


class PatternJoin:
    """One part of a plan as tables for the compiled loop."""

    def __init__(
        self, part: Plan, shown: frozenset[str], slots: Mapping[Slot, int], terms: TermValues
    ) -> None:
        self.terms = terms
        self._shown = [(i, name) for i, name in enumerate(sorted(outputs(part))) if name in shown]
        self.variables = tuple(sorted(outputs(part)))
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
        encoded = [terms.encoded(_single(const, terms)) for const in constants]
        self.constant_tags = np.array([tag[0] for tag, _ in encoded], np.int8)
        self.constant_bits = np.array([bit[0] for _, bit in encoded], np.int64)
        self._capacity = _FIRST_CAPACITY

    def solve(
        self,
        rows: tuple[NDArray[Any], ...],
        static: tuple[NDArray[Any], ...],
        once: NDArray[np.bool_],
    ) -> Relation | None:
        """The solutions over these rows; None where a filter has to be judged by `evaluation`."""
        while True:
            shape = (len(self.variables), self._capacity)
            tags, bits = np.empty(shape, np.int8), np.empty(shape, np.int64)
            uniform = np.zeros(len(self.variables), np.int8)
            found = match(
                *rows,
                *static,
                self.patterns,
                self.constant_tags,
                self.constant_bits,
                once,
                self.operations,
                self.filter_starts,
                self.filter_needs,
                self.terms.sorts_by_id,
                tags,
                bits,
                uniform,
            )
            if found == DOUBTFUL:
                return None
            if found <= self._capacity:
                break
            self._capacity = 2 * found
        columns = {}
        for i, name in self._shown:
            tag = uniform[i]
            if tag < 0:
                found_tags, found_bits = tags[i, :found], bits[i, :found]
                columns[name] = decoded_terms(found_tags, found_bits, self.terms.dictionary)
            else:
                columns[name] = decoded(_KINDS[tag], bits[i, :found])
        return Relation(columns, found)


def _single(const: Const, terms: TermValues) -> ObjectColumn:
    # Pinned in the spelling that is compared: the loop has its id for good.
    ids = np.array([terms.dictionary.id(canonical(const.term))], np.int32)
    return ObjectColumn(Kind.TERM, ids)


def _compiled(
    expression: Expression, place: Mapping[str, int], constants: dict[Const, int]
) -> Iterable[tuple[int, int]]:
    """The operations of a filter, arguments first."""
    match expression:
        case Var(name):
            yield VARIABLE, place[name]
        case Const():
            yield CONSTANT, constants.setdefault(expression, len(constants))
        case Call(name, arguments):
            for argument in arguments:
                yield from _compiled(argument, place, constants)
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
        self.rows = PatternRows(slots, windows, static.terms)
        self._static_rows = StaticRows(slots, frozenset(w for w in windows if w), static)
        # Parts are told apart by identity, which hashing a deep plan would cost more than.
        self._joins = {
            id(part): PatternJoin(part, shown, self.rows.slots, static.terms)
            for part, shown in parts
        }
        self._once = np.array([distinct or s.predicate == RDF_TYPE for s in slots], np.bool_)
        self._starts = np.zeros(len(slots) + 1, np.int64)
        self._expanded: tuple[int, int] | None = None
        self._expansion: tuple[NDArray[np.int64], ...] = ()
        self._selected: tuple[NDArray[Any], ...] | None = None

    def turn(self, lows: NDArray[np.int64], highs: NDArray[np.int64]) -> None:
        """The windows whose bounds these are: what `solve` is about from now on."""
        rows = self.rows
        while True:
            first, end = rows.between(int(lows.min()), int(highs.max()))
            *triples, ordered = select(
                *rows.columns, first, end, lows, highs, *self._sorts(), self._starts
            )
            if ordered:
                break
            rows.order()
        self._selected = (self._starts, *triples)
        rows.inside = len(triples[0])

    def solve(self, part: Plan) -> Relation | None:
        """The solutions of a part; None if it is not served, or cannot be with this data."""
        join = self._joins.get(id(part))
        if join is None or self._selected is None:
            return None
        return join.solve(self._selected, self._static_rows.arrays, self._once)

    def _sorts(self) -> tuple[NDArray[np.int64], ...]:
        """For each annotated sort the facts it stands for: windows, slots and classes."""
        state = (self.static.background.version, len(self.rows.sorts))
        if state != self._expanded:
            self._expanded = state
            starts, facts = [0], []
            for sort in self.rows.sorts:
                for window, graph in enumerate(self.rows.windows):
                    slot = self.rows.slots.get(Slot(graph, RDF_TYPE))
                    if slot is not None:
                        names = sorted(self.static.supersorts(sort))
                        ids = self.static.terms.dictionary.ids(map(NamedNode, names))
                        facts += [(window, slot, int(id)) for id in ids]
                starts.append(len(facts))
            table = np.array(facts, np.int64).reshape(-1, 3)
            self._expansion = (
                np.array(starts, np.int64),
                *(np.ascontiguousarray(table[:, i]) for i in range(3)),
            )
        return self._expansion
