"""Triple patterns joined by a compiled loop, over the rows of all windows as numbers.

It serves a plan's parts that are patterns with constant predicates, their joins, and filters of
numbers on them; what stands above is executed by `relational`. Law (tests/laws): the same solutions
as `relational.execute` gives for that part, in an order that depends on the rows only.

Cost: a few microseconds a window, then tens of nanoseconds a row of the window and a step of the
join. Memory: 26 bytes a triple of the windows; static triples of the named predicates once.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import NamedNode

from ..rdf.namespaces import RDF_TYPE
from ..rdf.timed import Kind, ObjectColumn, TripleRows, make_term
from .columns import Relation, TermValues, bits
from .expressions import Call, Const, Expression, Var, conjuncts, variables
from .kernels import ascending
from .logical import (
    START,
    STOP,
    Aggregate,
    Closure,
    Distinct,
    Filter,
    Join,
    Plan,
    Position,
    Project,
    Scan,
    TypeScan,
    expressions_of,
    inputs,
    outputs,
    walk,
    with_inputs,
)
from .pattern_kernels import (
    ADD,
    AND,
    CONSTANT,
    DIVIDE,
    DOUBTFUL,
    EQUAL,
    GREATER,
    GREATER_EQUAL,
    LESS,
    LESS_EQUAL,
    MULTIPLY,
    NEGATE,
    NOT,
    OR,
    SUBTRACT,
    UNEQUAL,
    VARIABLE,
    chain,
    match,
    select,
)
from .sources import StaticSide

_OPERATIONS = {
    "+": ADD,
    "-": SUBTRACT,
    "*": MULTIPLY,
    "/": DIVIDE,
    "=": EQUAL,
    "!=": UNEQUAL,
    "<": LESS,
    "<=": LESS_EQUAL,
    ">": GREATER,
    ">=": GREATER_EQUAL,
    "&&": AND,
    "||": OR,
    "!": NOT,
    "NEGATE": NEGATE,
}
_DEEPEST = 60
_SORT_SLOT = -1
_FIRST_CAPACITY = 256
_KINDS = tuple(Kind)


@dataclass(frozen=True, slots=True)
class Slot:
    """A predicate in a graph; of classes, `RDF_TYPE`."""

    graph: str
    predicate: NamedNode


def pattern_parts(plan: Plan) -> Plan:
    """``plan`` with the parts of each join that this room serves put together in one join."""
    plan = with_inputs(plan, pattern_parts)
    if isinstance(plan, Join):
        served = tuple(part for part in plan.parts if _is_served(part))
        others = tuple(part for part in plan.parts if not _is_served(part))
        if len(served) > 1 and others:
            return Join((Join(served), *others))
    return plan


def served_parts(plan: Plan) -> Iterator[Plan]:
    """The largest parts of ``plan`` that are served: joins and filters of patterns."""
    if _is_served(plan) and any(True for _ in _leaves(plan)):
        yield plan
        return
    for part in inputs(plan):
        yield from served_parts(part)


def _is_served(plan: Plan) -> bool:
    match plan:
        case Scan():
            return not plan.times.names
        case TypeScan():
            return True
        case Join(parts):
            return bool(parts) and all(_is_served(part) for part in parts)
        case Filter(condition, child):
            # What a filter inside a join does not see there is unbound.
            seen = variables(condition) <= outputs(child)
            return seen and _is_served(child) and _depth(condition) is not None
        case _:
            return False


def _leaves(plan: Plan) -> Iterator[Scan | TypeScan]:
    if isinstance(plan, Scan | TypeScan):
        yield plan
    for part in inputs(plan):
        yield from _leaves(part)


def _conditions(plan: Plan) -> Iterator[Expression]:
    if isinstance(plan, Filter):
        yield from conjuncts(plan.condition)
    for part in inputs(plan):
        yield from _conditions(part)


def _depth(expression: Expression) -> int | None:
    """How high the stack grows; None for what the loop does not know."""
    match expression:
        case Var() | Const():
            return 1
        case Call("!" | "NEGATE", (argument,)):
            return _depth(argument)
        case Call(name, (left, right)) if name in _OPERATIONS:
            a, b = _depth(left), _depth(right)
            return None if a is None or b is None or b >= _DEEPEST else max(a, b + 1)
        case _:
            return None


def needed_outside(plan: Plan, part: Plan) -> frozenset[str]:
    """The variables of ``part`` that the rest of ``plan`` looks at: all, where it compares whole
    solutions."""
    inside = {id(node) for node in walk(part)}
    names: set[str] = set()
    for node in walk(plan):
        if id(node) in inside:
            continue
        if not inputs(node):
            names |= outputs(node)
        for expression in expressions_of(node):
            names |= variables(expression)
        match node:
            case Project(shown):
                names |= set(shown)
            case Aggregate(keys, aggregations):
                names |= set(keys)
                if any(one.distinct and one.argument is None for one in aggregations):
                    return outputs(part)
            case Closure():
                names |= outputs(node) | {START, STOP}
            case Distinct(child) if not isinstance(child, Project):
                return outputs(part)
    return outputs(part) & names


class PatternRows:
    """The triples of all windows that the patterns of a query can touch, in order of arrival.

    ``windows``: the graph of each window, by its number.
    """

    def __init__(self, slots: Sequence[Slot], windows: Sequence[str], terms: TermValues) -> None:
        self.slots = {slot: number for number, slot in enumerate(slots)}
        self.windows = tuple(windows)
        self.terms = terms
        self.sorts: dict[int, int] = {}
        """The sorts of annotations that have been met, numbered."""
        self.count = 0
        self._ordered = True
        """Whether times ascend."""
        self.inside = 0
        """How many were in the windows when they were looked at last."""
        self._columns: tuple[NDArray[Any], ...] = _empty(64)
        self._numbers: list[dict[int, int]] = [{} for _ in windows]
        """By window: the slot of a predicate's id."""
        self._known = 0

    @property
    def columns(self) -> tuple[NDArray[Any], ...]:
        """Window, slot, subject, tag, bits, time of each triple; the first `count` are valid."""
        return self._columns

    def push(self, window: int, tables: Sequence[TripleRows]) -> None:
        """Rows of a window. Cost: a copy of each column that a pattern names."""
        numbers = self._slots_of(window)
        parts: list[tuple[Any, ...]] = []
        for rows in tables:
            for predicate, column in rows.objects.items():
                slot = numbers.get(predicate)
                if slot is None:
                    continue
                subjects, values, times = rows.subject, column.values, rows.time
                if column.null is not None:
                    at = np.flatnonzero(~column.null)
                    subjects, values, times = subjects[at], values[at], times[at]
                parts.append((slot, column.kind, subjects, values, times))
            if rows.sort is not None and len(rows):
                number = self.sorts.setdefault(rows.sort, len(self.sorts))
                numbered = np.full(len(rows), number, np.int64)
                parts.append((_SORT_SLOT, Kind.INTEGER, rows.subject, numbered, rows.time))
        if parts:
            self._append(window, parts)

    def _append(self, window: int, parts: Sequence[tuple[Any, ...]]) -> None:
        """Columns one after the other, in as few calls as there are kinds of arrays."""
        slots, kinds, subjects, values, times = zip(*parts, strict=True)
        lengths = [len(part) for part in subjects]
        start = self.count
        stop = start + sum(lengths)
        if stop > len(self._columns[0]):
            larger = _empty(2 * stop)
            for old, new in zip(self._columns, larger, strict=True):
                new[:start] = old[:start]
            self._columns = larger
        added = tuple(column[start:stop] for column in self._columns)
        added[0][:] = window
        added[1][:] = np.repeat(slots, lengths)
        np.concatenate(subjects, out=added[2])
        added[3][:] = np.repeat(kinds, lengths)
        np.concatenate([bits(part) for part in values], out=added[4])
        np.concatenate(times, out=added[5])
        if Kind.TERM in kinds:
            self.terms.spell(added[3], added[4])
        if self._ordered:
            before = self._columns[5][start - 1] if start else added[5][0]
            self._ordered = bool(before <= added[5][0]) and ascending(added[5])
        self.count = stop

    def _slots_of(self, window: int) -> dict[int, int]:
        """The dictionary may learn a predicate after the query was planned."""
        found = self._numbers[window]
        if len(found) < len(self.slots):
            graph = self.windows[window]
            for slot, number in self.slots.items():
                if slot.graph == graph:
                    found[self.terms.dictionary.id(slot.predicate)] = number
        return found

    @property
    def is_full(self) -> bool:
        """Whether half of the triples may have left their windows."""
        return self.count >= 64 and self.count >= 2 * self.inside

    def drop(self, lows: NDArray[np.int64]) -> None:
        """Forget what is not above ``lows``, by window, when that is half of all."""
        if not self.is_full:
            return
        window, times = self._columns[0][: self.count], self._columns[5][: self.count]
        keep = np.flatnonzero(times > lows[window])
        if 2 * len(keep) <= self.count:
            larger = _empty(max(64, 2 * len(keep)))
            for old, new in zip(self._columns, larger, strict=True):
                new[: len(keep)] = old[keep]
            self._columns, self.count = larger, len(keep)

    def order(self) -> None:
        """Put the triples in order of time and tag, those of one in order of arrival."""
        _, _, _, tags, _, times = (column[: self.count] for column in self._columns)
        by = np.lexsort((tags, times))
        for column in self._columns:
            column[: self.count] = column[: self.count][by]
        self._ordered = True

    def between(self, low: int, high: int) -> tuple[int, int]:
        """Where the triples with ``low < time <= high`` begin and end; others may be among them."""
        if not self._ordered:
            self.order()
        times = self._columns[5][: self.count]
        return int(times.searchsorted(low, "right")), int(times.searchsorted(high, "right"))

    def tables(
        self, lows: NDArray[np.int64], highs: NDArray[np.int64]
    ) -> dict[str, list[TripleRows]]:
        """The triples in the windows as narrow tables, by graph (their valid time is unknown)."""
        window, slot, subject, tag, bits, time = (c[: self.count] for c in self._columns)
        inside = (time > lows[window]) & (time <= highs[window])
        names = {number: one for one, number in self.slots.items()}
        sorts = {number: sort for sort, number in self.sorts.items()}
        found: dict[str, list[TripleRows]] = {}
        shapes = np.stack([window, slot, np.where(slot < 0, bits, tag)], axis=1)
        for w, number, kind in np.unique(shapes[inside], axis=0).tolist():
            at = np.flatnonzero(inside & (shapes == (w, number, kind)).all(axis=1))
            at = at[np.argsort(time[at], kind="stable")]
            tables = found.setdefault(self.windows[w], [])
            if number < 0:
                rows = TripleRows(time[at], time[at], subject[at], {}, sorts[kind])
            else:
                predicate = self.terms.dictionary.id(names[number].predicate)
                column = decoded(Kind(kind), bits[at])
                rows = TripleRows(time[at], time[at], subject[at], {predicate: column})
            tables.append(rows)
        return found


def _empty(capacity: int) -> tuple[NDArray[Any], ...]:
    kinds = (np.int8, np.int32, np.int32, np.int8, np.int64, np.int64)
    return tuple(np.zeros(capacity, kind) for kind in kinds)


def decoded(kind: Kind, bits: NDArray[np.int64]) -> ObjectColumn:
    """A column of objects of one tag."""
    if kind.dtype == np.float64:
        return ObjectColumn(kind, bits.view(np.float64))
    return ObjectColumn(kind, bits.astype(kind.dtype))


class StaticRows:
    """The static triples of the slots, with their chains: made once a version of the background."""

    def __init__(self, slots: Sequence[Slot], windows: frozenset[str], static: StaticSide) -> None:
        self.slots = slots
        self.windows = windows
        self.static = static
        self._version: int | None = None
        self._arrays: tuple[NDArray[Any], ...] = ()

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """Starts by slot, subjects, tags, bits; heads and links by subject, by object."""
        version = self.static.background.version
        if version != self._version:
            self._version = version
            self._arrays = self._read()
        return self._arrays

    def _read(self) -> tuple[NDArray[Any], ...]:
        terms = self.static.terms
        starts = np.zeros(len(self.slots) + 1, np.int64)
        parts: list[tuple[NDArray[Any], ...]] = []
        for number, slot in enumerate(self.slots):
            rows = 0
            if slot.graph not in self.windows:
                if slot.predicate == RDF_TYPE:
                    scan: Scan | TypeScan = TypeScan(Var("s"), Var("o"), slot.graph)
                else:
                    scan = Scan(Var("s"), slot.predicate, Var("o"), slot.graph)
                subjects, objects = self.static.pairs(scan)
                parts.append((subjects.values, *terms.encoded(terms.canonical(objects))))
                rows = len(subjects)
            starts[number + 1] = starts[number] + rows
        if parts:
            subject, tag, bit = (np.concatenate(column) for column in zip(*parts, strict=True))
        else:
            subject, tag, bit = (np.zeros(0, kind) for kind in (np.int32, np.int8, np.int64))
        triples = (starts, subject.astype(np.int32), tag.astype(np.int8), bit)
        return (*triples, *chain(*triples, True), *chain(*triples, False))


class PatternJoin:
    """One part of a plan as tables for the compiled loop."""

    def __init__(
        self, part: Plan, shown: frozenset[str], slots: Mapping[Slot, int], terms: TermValues
    ) -> None:
        self.terms = terms
        self._shown = [(i, name) for i, name in enumerate(sorted(outputs(part))) if name in shown]
        leaves = list(_leaves(part))
        self.variables = tuple(sorted(outputs(part)))
        place = {name: i for i, name in enumerate(self.variables)}
        constants: dict[Const, int] = {}

        def position(one: Position) -> int:
            if isinstance(one, Var):
                return place[one.name]
            return -1 - constants.setdefault(one, len(constants))

        rows = []
        for leaf in leaves:
            object = leaf.sort if isinstance(leaf, TypeScan) else leaf.object
            rows.append([slots[slot_of(leaf)], position(leaf.subject), position(object)])
        self.patterns = np.array(rows, np.int64).reshape(-1, 3)
        operations: list[tuple[int, int]] = []
        starts, needs = [0], []
        for condition in _conditions(part):
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
                columns[name] = self._mixed(tags[i, :found], bits[i, :found])
            else:
                columns[name] = decoded(_KINDS[tag], bits[i, :found])
        return Relation(columns, found)

    def _mixed(self, tags: NDArray[np.int8], bits: NDArray[np.int64]) -> ObjectColumn:
        """Objects of several tags, as terms."""
        ids = np.empty(len(tags), np.int32)
        for tag in np.unique(tags).tolist():
            at = np.flatnonzero(tags == tag)
            if tag == Kind.TERM:
                ids[at] = bits[at]
                continue
            values = decoded(Kind(tag), bits[at]).values
            distinct, inverse = np.unique(values, return_inverse=True)
            known = (make_term(Kind(tag), value, self.terms.dictionary) for value in distinct)
            ids[at] = self.terms.dictionary.ids(known)[inverse.reshape(-1)]
        return ObjectColumn(Kind.TERM, ids)


def slot_of(leaf: Scan | TypeScan) -> Slot:
    return Slot(leaf.graph, RDF_TYPE if isinstance(leaf, TypeScan) else leaf.predicate)


def _single(const: Const, terms: TermValues) -> ObjectColumn:
    ids = np.array([terms.dictionary.id(const.term)], np.int32)
    return terms.canonical(ObjectColumn(Kind.TERM, ids))


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
            yield _OPERATIONS[name], 0


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
        self._parts = tuple(parts)
        leaves = (leaf for part, _ in parts for leaf in _leaves(part))
        slots = list(dict.fromkeys(map(slot_of, leaves)))
        self.rows = PatternRows(slots, windows, static.terms)
        self.slots = slots
        self._static_rows = StaticRows(slots, frozenset(w for w in windows if w), static)
        numbers = self.rows.slots
        # Parts are told apart by identity, which hashing a deep plan would cost more than.
        self._joins = {
            id(part): PatternJoin(part, shown, numbers, static.terms) for part, shown in parts
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
