"""The normal form of a query with variables instead of its constants (DESIGN §3 "Sharing").

Queries of one form differ in constants only. The common part of several is their least general
generalization [Plotkin70]: the form with the constants on which they agree.
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
    named_variables,
    with_expressions,
    with_inputs,
)

Pattern: TypeAlias = tuple[Term | Var, ...]
"""For each constant of a form the common constant, or a parameter. Constants that are equal to each
other in every query share a parameter."""


@dataclass(frozen=True, slots=True)
class LiftedQuery:
    """``query`` with a variable for each of ``constants``; no text can contain its name.

    An IRI is one constant at all its places, a literal one per place. So patterns about one object
    stay joined, but two limits that happen to be equal stay independent.
    """

    query: Query
    constants: tuple[Term, ...]


def constant_variable(number: int) -> str:
    """Return the variable for the constant with this number."""
    return f"\0constant{number}"


def lift_constants(query: Query) -> LiftedQuery:
    """Replace the constants in patterns (subjects and objects), expressions and head by variables.
    Predicates, sorts, ends of paths and VALUES stay: they decide what is computed.

    Law (tests/laws/continuous/test_alike.py): ``put_constants(form, constants)`` restores
    ``query``. Cost: one pass over the plan.
    """
    lifting = _Lifting()
    plan = lifting.plan(query.plan)
    return LiftedQuery(Query(lifting.head(query.head), plan), tuple(lifting.constants))


def put_constants(query: Query, pattern: Sequence[Term | Var]) -> Query:
    """Put ``pattern`` into the places of a form's constants."""
    put: dict[str, Var | Const] = {
        constant_variable(i): one if isinstance(one, Var) else Const(one)
        for i, one in enumerate(pattern)
    }
    return Query(_with_head(query.head, put), _with_plan(query.plan, put))


def generalize(members: Sequence[tuple[Term, ...]]) -> Pattern:
    """Return the most specific pattern that all ``members`` match; they have one form."""
    parameters: dict[tuple[Term, ...], Var] = {}
    pattern: list[Term | Var] = []
    for column in zip(*members, strict=True):
        if all(term == column[0] for term in column):
            pattern.append(column[0])
        else:
            name = f"\0parameter{len(parameters) + 1}"
            pattern.append(parameters.setdefault(column, Var(name)))
    return tuple(pattern)


def match_constants(pattern: Pattern, constants: Sequence[Term]) -> dict[str, Term] | None:
    """Return the terms of the pattern's parameters for these constants; None if they do not
    match."""
    terms: dict[str, Term] = {}
    for one, term in zip(pattern, constants, strict=True):
        expected = terms.setdefault(one.name, term) if isinstance(one, Var) else one
        if expected != term:
            return None
    return terms


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
            # An implicit group exists without rows; with a key it would not.
            case Aggregate(keys, _, child, implicit) if not implicit:
                # A constant is equal in all rows of a group, so its variable can be a key.
                below = named_variables(child)
                own = (constant_variable(i) for i in range(len(self.constants)))
                return replace(plan, keys=(*keys, *(name for name in own if name in below)))
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
        variable = Var(constant_variable(len(self.constants)))
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
