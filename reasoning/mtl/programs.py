"""A formula as a flat program over tables of bits (docs/explanation/design/0011-formulas.md).

A node has four tables, a row a state and a bit an object: where it is known to be true (T), where
to be false (F), what of it became known in the last step, and where its left part decided. A
negation swaps T and F of its operand, so `and`, `always`, `historically` and `forall` are `or`,
`eventually`, `once` and `exists` with swapped tables.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, assert_never

import numpy as np
from numpy.typing import NDArray

from ...languages.mtl.ast import Interval, Temporal
from ...languages.mtl.checked import (
    And,
    Atom,
    CheckedMonitor,
    Formula,
    Not,
    ObjectVariable,
    Or,
    Previous,
    Quantified,
    Truth,
    Until,
    Within,
)
from ...streams.time import TIME_MAX
from .formulas import (
    bound_sorts,
    compares_objects,
    is_of_past,
    looks_back,
    readings_of,
    sorts_of,
    subformulas,
)

TRUE, FALSE, NEW, BY_LEFT = range(4)
"""The tables of a node, in order."""
TABLES: Final = 4
NO_END: Final = -1
"""The end of an interval that has none."""
LONGEST: Final = TIME_MAX - 1
"""The greatest bound of an interval, in ns: 292 years."""


TRUTH, ATOM, OR, EVENTUALLY, ONCE, UNTIL, SINCE, PREVIOUS, EXISTS, SPREAD = range(10)
"""What a node is. `SPREAD` is a closed formula, for all objects."""
FIELDS: Final = 11
(
    OPERATION,
    DOMAIN,
    LEFT_T,
    LEFT_F,
    RIGHT_T,
    RIGHT_F,
    START,
    END,
    OVER,
    NUMBER,
    IS_UPPER,
) = range(FIELDS)
"""The columns of a program: what the node is; the domain of its columns; the tables of its
operands; its interval; the domain of a quantifier; which atom it is, in which reading."""


@dataclass(frozen=True, slots=True)
class Reference:
    """A node as it stands in a formula; ``is_negated``: with its tables swapped."""

    node: int
    is_negated: bool = False

    @property
    def true(self) -> int:
        return self.node * TABLES + (FALSE if self.is_negated else TRUE)

    @property
    def false(self) -> int:
        return self.node * TABLES + (TRUE if self.is_negated else FALSE)

    def negated(self) -> Reference:
        return Reference(self.node, not self.is_negated)


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """The nodes of a formula, operands first: shape ``(nodes, fields)``.

    ``lower`` and ``upper``: the formula in each reading of unknown atoms; the same in a program of
    one reading.
    """

    nodes: NDArray[np.int64]
    lower: Reference
    upper: Reference


@dataclass(slots=True, eq=False)
class Compiler:
    """Makes the programs of a monitor. Contract: `is_sliced`, or it is about one object.

    ``domains``: the sorts whose objects are columns; the first is that of a closed formula, which
    has one column.
    """

    monitor: CheckedMonitor
    domains: list[str] = field(init=False)
    atoms: list[Atom] = field(init=False)
    _sorts: Mapping[str, str] = field(init=False)
    _has_two_readings: bool = field(init=False, default=False)
    _nodes: list[list[int]] = field(init=False, default_factory=list)
    _memo: dict[tuple[int, bool], Reference] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self._sorts = sorts_of(self.monitor)
        self.domains = ["", *dict.fromkeys(self._sorts.values())]
        self.atoms = list({id(atom): atom for atom in _atoms(self.monitor.formula)}.values())

    @property
    def root_domain(self) -> int:
        """The number of the domain of verdicts."""
        return self._domain_of({name for name, _ in self.monitor.parameters})

    def domain(self, formula: Formula) -> int:
        """The number of the domain of a formula's columns."""
        return self._domain_of(_free_variables(formula))

    def program(self, *, has_two_readings: bool) -> Program:
        """The nodes of one reading, or of both."""
        self._nodes, self._memo, self._has_two_readings = [], {}, has_two_readings
        formula, domain = self.monitor.formula, self.root_domain
        lower = self._operand(formula, False, domain)
        upper = self._operand(formula, True, domain) if has_two_readings else lower
        return Program(np.array(self._nodes, np.int64), lower, upper)

    def _domain_of(self, variables: set[str]) -> int:
        return self.domains.index(self._sorts[min(variables)]) if variables else 0

    def _operand(self, formula: Formula, is_upper: bool, domain: int) -> Reference:
        """A node with the columns of a domain."""
        found = self._reference(formula, is_upper)
        if self.domain(formula) == domain:
            return found
        spread = self._node(SPREAD, domain, [Reference(found.node)])
        return Reference(spread.node, found.is_negated)

    def _reference(self, formula: Formula, is_upper: bool) -> Reference:
        key = id(formula), is_upper
        if key not in self._memo:
            self._memo[key] = self._compiled(formula, is_upper)
        return self._memo[key]

    def _compiled(self, formula: Formula, is_upper: bool) -> Reference:
        own = self.domain(formula)
        match formula:
            case Truth(value):
                return self._node(TRUTH, own, is_dual=not value)
            case Atom():
                place = next(i for i, atom in enumerate(self.atoms) if atom is formula)
                more = {NUMBER: place, IS_UPPER: is_upper}
                return self._node(ATOM, own, more=more)
            case Not(operand):
                # A negation reads an unknown atom the other way.
                other = self._has_two_readings and not is_upper
                return self._reference(operand, other).negated()
            case And(left, right) | Or(left, right):
                parts = [self._operand(part, is_upper, own) for part in (left, right)]
                return self._node(OR, own, parts, is_dual=isinstance(formula, And))
            case Previous(operand):
                return self._node(PREVIOUS, own, [self._reference(operand, is_upper)])
            case Within(operator, interval, operand):
                operation = ONCE if operator.is_past else EVENTUALLY
                is_dual = operator in (Temporal.ALWAYS, Temporal.HISTORICALLY)
                parts = [self._reference(operand, is_upper)]
                return self._node(operation, own, parts, is_dual=is_dual, interval=interval)
            case Until(is_past, interval, left, right):
                parts = [self._operand(part, is_upper, own) for part in (left, right)]
                operation = SINCE if is_past else UNTIL
                return self._node(operation, own, parts, interval=interval)
            case Quantified(is_universal, _, sort, operand):
                over = self.domains.index(sort)
                parts = [self._operand(operand, is_upper, over)]
                more = {OVER: over}
                return self._node(EXISTS, own, parts, is_dual=is_universal, more=more)
            case _:
                assert_never(formula)

    def _node(
        self,
        operation: int,
        domain: int,
        operands: Sequence[Reference] = (),
        *,
        is_dual: bool = False,
        interval: Interval | None = None,
        more: Mapping[int, int] | None = None,
    ) -> Reference:
        """Add a node; ``is_dual``: the negation of its operation over negated operands."""
        row = [0] * FIELDS
        row[OPERATION], row[DOMAIN] = operation, domain
        places = (LEFT_T, LEFT_F), (RIGHT_T, RIGHT_F)
        for (true, false), operand in zip(places, operands, strict=False):
            read = operand.negated() if is_dual else operand
            row[true], row[false] = read.true, read.false
        if interval is not None:
            row[START] = min(interval.start, LONGEST)
            row[END] = NO_END if interval.end is None else min(interval.end, LONGEST)
        for name, value in (more or {}).items():
            row[name] = value
        self._nodes.append(row)
        return Reference(len(self._nodes) - 1, is_dual)


def is_sliced(monitor: CheckedMonitor) -> bool:
    """Whether a monitor's verdicts can be had from tables of bits, with the same witnesses.

    Not those with margins, with parts over two variables, that compare objects, that look back
    without a bound, or whose witness needs to know when an earlier state was decided.
    """
    formula = monitor.formula
    return not (
        monitor.robustness
        or len(monitor.parameters) > 1
        or compares_objects(formula)
        or not _has_narrow_parts(formula)
        or not _has_bounded_past(formula)
        or not _is_witnessed_by_bits(formula, in_quantifier=False)
    )


def _looks_ahead(formula: Formula) -> bool:
    """Whether the formula has an operator of the future."""
    own = isinstance(formula, Within | Until) and not is_of_past(formula)
    return own or any(map(_looks_ahead, subformulas(formula)))


def _atoms(formula: Formula) -> Iterator[Atom]:
    if isinstance(formula, Atom):
        yield formula
    for part in subformulas(formula):
        yield from _atoms(part)


def _free_variables(formula: Formula) -> set[str]:
    if isinstance(formula, Atom):
        arguments = (a for reading in readings_of(formula) for a in reading.arguments)
        return {each.name for each in arguments if isinstance(each, ObjectVariable)}
    free: set[str] = set().union(*map(_free_variables, subformulas(formula)))
    return free - {formula.variable} if isinstance(formula, Quantified) else free


def _has_narrow_parts(formula: Formula) -> bool:
    """Whether no part is about two objects, and quantified ones about that object alone."""
    free = _free_variables(formula)
    if isinstance(formula, Quantified) and free:
        return False
    return len(free) < 2 and all(map(_has_narrow_parts, subformulas(formula)))


def _has_bounded_past(formula: Formula) -> bool:
    if isinstance(formula, Within | Until) and is_of_past(formula) and formula.interval.end is None:
        return False
    return all(map(_has_bounded_past, subformulas(formula)))


def _is_witnessed_by_bits(formula: Formula, *, in_quantifier: bool) -> bool:
    """Whether the witness follows from what is known when the verdict is decided. `since` and
    `previous` may have been decided by states at different times before."""
    match formula:
        case Not() | And() | Or():
            parts = subformulas(formula)
            return all(_is_witnessed_by_bits(each, in_quantifier=in_quantifier) for each in parts)
        case Previous(operand):
            return not (looks_back(operand) or _looks_ahead(operand) or bound_sorts(operand))
        case Until(True):
            return False
        case Quantified(operand=operand):
            return not in_quantifier and _is_witnessed_by_bits(operand, in_quantifier=True)
        case _:
            return True
