"""The parameters of SASE+ templates: which stand for objects, and of which kind the others are
(SPEC §8)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from ...ontology.vocabulary import THING
from ..errors import Span
from ..mtl.ast import Measured, Slot, Symbol, Text, TimePoint, Truth, Variable
from ..mtl.checked import Kind, ObjectSlot
from . import ast
from .checked import ObjectParameter, ValueSlot, condition_leaves
from .parts import Parts

_KINDS: Final = {
    Text: Kind.TEXT,
    Truth: Kind.TRUTH,
    TimePoint: Kind.TIME,
    Symbol: Kind.OBJECT,
}


class Parameters:
    """The parameters of a template: an ``id`` that equals a parameter for objects defines it. All
    methods raise `LanguageError`."""

    def __init__(self, parts: Parts, slots: Sequence[Slot]) -> None:
        self._parts = parts
        self._pattern = parts.pattern
        self.slots = {slot.variable.name: slot for slot in slots}
        within = self._pattern.within
        if isinstance(within, Variable) and within.name not in self.slots:
            raise parts.error(*no_value(within.name, within.span))
        self.defining = self._defining()
        self.objects = self._object_parameters()

    def slot(self, slot: Slot) -> ObjectSlot | ValueSlot:
        name = slot.variable.name
        if name in self.objects:
            return ObjectSlot(name, self.objects[name].sort)
        kinds: list[Kind | None] = []
        pattern = self._pattern
        if isinstance(pattern.within, Variable) and pattern.within.name == name:
            kinds.append(Kind.DURATION)
        for condition in (*pattern.where, *pattern.having):
            kinds += self._kinds_in(condition, name)
        for item in pattern.items:
            kinds += self._kinds_of_operands(item.term, name)
            kinds += [Kind.NUMBER] * _is_variable(item.term, name)
        if not kinds:
            raise self._parts.error(
                f"the pattern does not use `?{name}`",
                slot.span,
                "use it, as in `a.value > ?limit`, or leave it out",
            )
        known = list(dict.fromkeys(kind for kind in kinds if kind is not None))
        if len(known) > 1:
            raise self._parts.error(
                f"`?{name}` is compared as a {known[0]} and as a {known[1]}",
                slot.span,
                "a parameter is of one kind: use two",
            )
        return ValueSlot(name, known[0] if known else None)

    def _kinds_in(self, condition: ast.Condition, name: str) -> list[Kind | None]:
        """The kinds as which a condition compares a variable; None: it does not say."""
        leaves = condition_leaves(condition)
        if not any(_is_variable(leaf, name) for leaf in leaves):
            return []
        match condition:
            case ast.Equivalence(attribute, Variable()):
                kinds = {self._parts.kind(part, attribute) for part in self._parts.of_name}
                return [kinds.pop() if len(kinds) == 1 else None]
            case ast.Comparison(operator, left, right):
                other = right if _is_variable(left, name) else left
                is_alone = _is_variable(left, name) or _is_variable(right, name)
                kind = _KINDS.get(type(other))
                if isinstance(other, ast.Attribute):
                    kind = self._parts.kind(other.part, other.name)
                if is_alone and isinstance(
                    other, ast.Attribute | Text | Truth | TimePoint | Symbol
                ):
                    is_ordered = operator not in ("=", "!=")
                    return [kind or (Kind.NUMBER if is_ordered else None)]
                if is_alone:
                    return [Kind.DURATION if self._is_duration(other) else Kind.NUMBER]
                sides = (self._kinds_of_operands(side, name) for side in (left, right))
                return [kind for kinds_ in sides for kind in kinds_]
        return [Kind.NUMBER]

    def _kinds_of_operands(self, term: ast.Term, name: str) -> list[Kind | None]:
        """The kinds as which a variable is calculated with: a duration beside times and
        durations."""
        match term:
            case ast.Arithmetic(operator, left, right):
                found: list[Kind | None] = []
                for one, other in ((left, right), (right, left)):
                    if _is_variable(one, name):
                        is_sum = operator in "+-"
                        is_time = is_sum and (self._is_time(other) or self._is_duration(other))
                        found.append(Kind.DURATION if is_time else Kind.NUMBER)
                    else:
                        found += self._kinds_of_operands(one, name)
                return found
            case ast.Negative(operand):
                of = self._kinds_of_operands(operand, name)
                return [*of, *[Kind.NUMBER] * _is_variable(operand, name)]
            case _:
                return []

    def _is_duration(self, term: ast.Term) -> bool:
        match term:
            case ast.Duration():
                return True
            case ast.Arithmetic("-", left, right) if self._is_time(left) and self._is_time(right):
                return True
            case ast.Arithmetic("+" | "-", left, right):
                return not self._is_time(left) and any(map(self._is_duration, (left, right)))
            case _:
                return False

    def _is_time(self, term: ast.Term) -> bool:
        match term:
            case TimePoint():
                return True
            case ast.Attribute(part, _, name):
                return part in self._parts.of_name and self._parts.kind(part, name) is Kind.TIME
            case ast.Arithmetic("+" | "-", left, right):
                return self._is_time(left) and not self._is_time(right)
            case _:
                return False

    def _defining(self) -> dict[str, ast.Attribute]:
        """The variables that an ``id`` of an event that happens equals, and the first such one."""
        found: dict[str, ast.Attribute] = {}
        for condition in self._pattern.where:
            match condition:
                case ast.Equivalence(name, Variable(variable)):
                    if all(self._parts.is_object(part, name) for part in self._parts.of_name):
                        last = self._parts.there[-1]
                        index = ast.Index.EACH if last.is_kleene else ast.Index.ONE
                        each = ast.Attribute(last.name, index, name, condition.span)
                        found.setdefault(variable, each)
                case ast.Comparison("=", left, right):
                    for one, other in ((left, right), (right, left)):
                        match one, other:
                            case ast.Attribute(), Variable(variable) if self._is_defining(one):
                                found.setdefault(variable, one)
                case _:
                    pass
        return found

    def _is_defining(self, node: ast.Attribute) -> bool:
        """Whether this is an object of events that happen: of one, or of each."""
        part = self._parts.of_name.get(node.part)
        is_some = node.index in (ast.Index.ONE, ast.Index.EACH, ast.Index.FIRST)
        is_there = part is not None and not part.is_negated
        return is_some and is_there and self._parts.is_object(node.part, node.name)

    def _object_parameters(self) -> dict[str, ObjectParameter]:
        found = {}
        for name, slot in self.slots.items():
            if slot.sort is None and name not in self.defining:
                continue
            if name not in self.defining:
                raise self._parts.error(
                    f"no event tells the objects of `?{name}`",
                    slot.span,
                    f"write `a.id = ?{name}` for a part `a`, or `[id = ?{name}]` for all parts",
                )
            sort = slot.sort
            iri = THING if sort is None else self._parts.names.sort(sort.text, sort.span)
            found[name] = ObjectParameter(name, iri, self.defining[name])
        return found


def _is_variable(term: ast.Term, name: str) -> bool:
    match term:
        case Variable(found) | Measured(Variable(found)):
            return found == name
        case _:
            return False


def no_value(name: str, span: Span) -> tuple[str, Span, str]:
    """The error for a variable that no request gives."""
    return (
        f"`?{name}` has no value",
        span,
        "only a template has parameters: `REGISTER TEMPLATE e(?x) AS PATTERN …`",
    )
