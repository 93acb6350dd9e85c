"""The normal form of a query with its constants taken out (DESIGN §3 "Sharing").

Queries of one form differ in constants only. What several of them have in common is their least
general generalization [Plotkin70]: the form with the constants on which they agree put back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

from pyoxigraph import NamedNode

from ...rdf.dictionary import Term
from .expressions import Call, Const, Expression, Var
from .plan import (
    Aggregate,
    AnyScan,
    Blank,
    Construct,
    Head,
    Plan,
    Position,
    Query,
    Scan,
    TemplatePosition,
    TypeScan,
    mentioned,
    with_expressions,
    with_inputs,
)

Pattern: TypeAlias = tuple[Term | Var, ...]
"""What stands for each constant of a form: the one that all agree on, or a parameter. Constants
that are the same in each query are one parameter."""


@dataclass(frozen=True, slots=True)
class Lifted:
    """``query`` with a variable that no text can name, `place`, for each of ``constants``.

    A name (IRI) is one constant wherever it stands, a literal is one wherever it is written: so
    that patterns about one object stay joined, and two limits are two though they be equal.
    """

    query: Query
    constants: tuple[Term, ...]


def place(number: int) -> str:
    """The variable for the constant with this number."""
    return f"\0constant{number}"


def lifted(query: Query) -> Lifted:
    """``query`` with the constants of its patterns (subjects and objects), expressions and head
    taken out. Not predicates, sorts, ends of paths, VALUES: they decide what is computed.

    Law (tests/laws/continuous/test_alike.py): ``lowered(form, constants)`` is ``query`` again.
    Cost: one pass over the plan.
    """
    lifting = _Lifting()
    plan = lifting.plan(query.plan)
    return Lifted(Query(lifting.head(query.head), plan), tuple(lifting.constants))


def lowered(query: Query, pattern: Sequence[Term | Var]) -> Query:
    """A form with ``pattern`` in the places of its constants."""
    put: dict[str, Var | Const] = {
        place(i): one if isinstance(one, Var) else Const(one) for i, one in enumerate(pattern)
    }
    return Query(_with_head(query.head, put), _with_plan(query.plan, put))


def generalized(members: Sequence[tuple[Term, ...]]) -> Pattern:
    """The most special pattern that fits all ``members``, which are of one form."""
    parameters: dict[tuple[Term, ...], Var] = {}
    pattern: list[Term | Var] = []
    for column in zip(*members, strict=True):
        if all(term == column[0] for term in column):
            pattern.append(column[0])
        else:
            name = f"\0parameter{len(parameters) + 1}"
            pattern.append(parameters.setdefault(column, Var(name)))
    return tuple(pattern)


def fitted(pattern: Pattern, constants: Sequence[Term]) -> dict[str, Term] | None:
    """The terms of the pattern's parameters in a query with these constants; None if it does not
    fit."""
    found: dict[str, Term] = {}
    for one, term in zip(pattern, constants, strict=True):
        known = found.setdefault(one.name, term) if isinstance(one, Var) else one
        if known != term:
            return None
    return found


class _Lifting:
    def __init__(self) -> None:
        self.constants: list[Term] = []
        self._names: dict[NamedNode, Var] = {}

    def plan(self, plan: Plan) -> Plan:
        plan = with_expressions(with_inputs(plan, self.plan), self.expression)
        match plan:
            case Scan(subject, _, object) | AnyScan(subject, _, object):
                return replace(plan, subject=self.position(subject), object=self.position(object))
            case TypeScan(subject):
                return replace(plan, subject=self.position(subject))
            case Aggregate(keys, _, child, implicit) if not implicit:
                # A constant is the same in each row of a group.
                known = mentioned(child)
                own = (place(i) for i in range(len(self.constants)))
                return replace(plan, keys=(*keys, *(name for name in own if name in known)))
            case _:
                return plan

    def head(self, head: Head) -> Head:
        if not isinstance(head, Construct):
            return head
        return Construct(
            tuple((self._of_head(s), p, self._of_head(o)) for s, p, o in head.template)
        )

    def _of_head(self, position: TemplatePosition) -> TemplatePosition:
        return position if isinstance(position, Blank) else self.position(position)

    def expression(self, expression: Expression) -> Expression:
        if isinstance(expression, Call):
            return Call(expression.name, tuple(map(self.expression, expression.arguments)))
        return self.position(expression)

    def position(self, position: Position) -> Position:
        if isinstance(position, Var):
            return position
        term = position.term
        if isinstance(term, NamedNode) and term in self._names:
            return self._names[term]
        variable = Var(place(len(self.constants)))
        self.constants.append(term)
        if isinstance(term, NamedNode):
            self._names[term] = variable
        return variable


_Put: TypeAlias = Mapping[str, Var | Const]


def _with_head(head: Head, put: _Put) -> Head:
    if not isinstance(head, Construct):
        return head

    def at(position: TemplatePosition) -> TemplatePosition:
        return position if isinstance(position, Blank) else _at(position, put)

    return Construct(tuple((at(s), at(p), at(o)) for s, p, o in head.template))


def _with_plan(plan: Plan, put: _Put) -> Plan:
    def expression(one: Expression) -> Expression:
        if isinstance(one, Call):
            return Call(one.name, tuple(map(expression, one.arguments)))
        return _at(one, put)

    plan = with_expressions(with_inputs(plan, lambda child: _with_plan(child, put)), expression)
    match plan:
        case Scan(subject, _, object) | AnyScan(subject, _, object):
            return replace(plan, subject=_at(subject, put), object=_at(object, put))
        case TypeScan(subject):
            return replace(plan, subject=_at(subject, put))
        case Aggregate(keys):
            kept = tuple(key for key in keys if key not in put)
            given = (put[key] for key in keys if key in put)
            names = dict.fromkeys(one.name for one in given if isinstance(one, Var))
            return replace(plan, keys=(*kept, *names))
        case _:
            return plan


def _at(position: Position, put: _Put) -> Position:
    return put.get(position.name, position) if isinstance(position, Var) else position
