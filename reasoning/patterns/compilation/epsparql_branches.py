"""An EP-SPARQL pattern as a union of branches without UNION and optional parts (SPEC §8).

SEQ, EQUALS and braces distribute over UNION. ``P OPTIONALSEQ Q`` is ``P SEQ Q`` and Q alone, where
Q alone has an *absence*: no solution of ``P SEQ Q`` has the same samples of Q.
``P EQUALSOPTIONAL Q`` is ``P EQUALS Q`` and P alone. In a branch each variable has a value or has
none, so BOUND and conditions without a value are decided here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final, TypeAlias, assert_never

from ....languages.epsparql.ast import Operator
from ....languages.epsparql.checked import (
    And,
    Bind,
    Bound,
    Calculation,
    CheckedPattern,
    Comparison,
    Condition,
    Filter,
    Group,
    Operation,
    Or,
    Part,
    Sample,
    Static,
    StaticVariable,
    TimeOf,
    Truth,
    Value,
    Variable,
)
from ....languages.errors import LanguageError, Span
from ....sparql.ast import variables_of

MOST_BRANCHES: Final = 16
Samples: TypeAlias = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Scoped:
    """A condition or value of a group: ``samples`` are those of the group, whose interval it may
    read."""

    node: Comparison | Or | Value
    samples: Samples


@dataclass(frozen=True, slots=True)
class Alone:
    """The samples ``kept`` are in no solution of a branch. ``is_equal``: by EQUALSOPTIONAL, whose
    other side may come later, up to the same end."""

    branch: Branch
    kept: Samples
    is_equal: bool


@dataclass(frozen=True, slots=True)
class Branch:
    """Samples, by their numbers in reading order, and everything that holds of them.

    ``sequences``: all of the left end before all of the right begin. ``equals``: both sides have
    the same interval. ``names``: the variables that have a value. ``binds``: (name, value).
    """

    samples: Samples = ()
    sequences: tuple[tuple[Samples, Samples], ...] = ()
    equals: tuple[tuple[Samples, Samples], ...] = ()
    conditions: tuple[Scoped, ...] = ()
    binds: tuple[tuple[str, Scoped], ...] = ()
    absences: tuple[Alone, ...] = ()
    static: tuple[Static, ...] = ()
    names: frozenset[str] = frozenset()

    @property
    def static_names(self) -> frozenset[str]:
        """The variables of its static triples."""
        return frozenset(name for each in self.static for name in variables_of(each.triple))

    def joined(self, other: Branch) -> Branch:
        """Return both together."""
        return Branch(
            self.samples + other.samples,
            self.sequences + other.sequences,
            self.equals + other.equals,
            self.conditions + other.conditions,
            self.binds + other.binds,
            self.absences + other.absences,
            self.static + other.static,
            self.names | other.names,
        )


def branches_of(
    pattern: CheckedPattern, given: frozenset[str]
) -> tuple[tuple[Sample, ...], tuple[Branch, ...]]:
    """Return all samples of a pattern, and its branches. ``given``: the parameters that have a
    value. Raises `LanguageError` for more than `MOST_BRANCHES`, for a side of an operator that has
    no sample, thus no time, and for a condition that never holds."""
    reader = _Reader(pattern.source, given)
    branches = tuple(reader.group(pattern.where))
    reader.check_times(list(branches), pattern.where.span)
    names = {
        place.name
        for sample in reader.samples
        for place in places_of(sample)
        if isinstance(place, Variable)
    }
    for branch in branches:
        for name in names:
            reader.is_bound(name, branch)
    return tuple(reader.samples), branches


class _Reader:
    def __init__(self, source: str, given: frozenset[str]) -> None:
        self.samples: list[Sample] = []
        self._source = source
        self._given = given

    def group(self, group: Group) -> list[Branch]:
        found = [Branch()]
        for part in group.parts:
            found = [a.joined(b) for a in found for b in self._part(part)]
            self._check_count(found, group.span)
        for part in group.parts:
            match part:
                case Bind(variable, value):
                    found = [self._bound(each, variable.name, value) for each in found]
                case Filter(condition, span):
                    found = [new for each in found for new in self._filtered(each, condition)]
                    if not found:
                        raise LanguageError(
                            "the condition holds for no solution of its group",
                            self._source,
                            span,
                            "look at BOUND, and at the variables without a value",
                        )
        return found

    def _part(self, part: Part) -> list[Branch]:
        match part:
            case Sample():
                self.samples.append(part)
                names = {place.name for place in places_of(part) if isinstance(place, Variable)}
                return [Branch((len(self.samples) - 1,), names=frozenset(names))]
            case Static():
                return [Branch(static=(part,))]
            case Group():
                return self.group(part)
            case Operation():
                return self._operation(part)
            case Bind() | Filter():
                return [Branch()]
            case _:
                assert_never(part)

    def _operation(self, part: Operation) -> list[Branch]:
        left, right = self._part(part.left), self._part(part.right)
        self.check_times(left, part.left.span)
        self.check_times(right, part.right.span)
        found: list[Branch] = []
        match part.operator:
            case Operator.UNION:
                found = [*left, *right]
            case Operator.SEQ:
                found = [_sequence(a, b) for a in left for b in right]
            case Operator.EQUALS:
                found = [_equal(a, b) for a in left for b in right]
            case Operator.OPTIONALSEQ:
                self._check_static([*left, *right], part.span)
                for kept in right:
                    pairs = [_sequence(each, kept) for each in left]
                    found += [*pairs, _alone(kept, pairs, is_equal=False)]
            case Operator.EQUALSOPTIONAL:
                self._check_static([*left, *right], part.span)
                for kept in left:
                    pairs = [_equal(kept, each) for each in right]
                    found += [*pairs, _alone(kept, pairs, is_equal=True)]
            case _:
                assert_never(part.operator)
        self._check_count(found, part.span)
        return found

    # -- conditions --------------------------------------------------------------------------

    def _bound(self, branch: Branch, name: str, value: Value) -> Branch:
        if not self._has_value(value, branch):
            return branch
        bind = name, Scoped(value, branch.samples)
        return replace(branch, binds=(*branch.binds, bind), names=branch.names | {name})

    def _filtered(self, branch: Branch, condition: Condition) -> Iterator[Branch]:
        """Yield the branch with a condition; nothing if it never holds there."""
        left = self._simplified(condition, branch)
        operands = left.operands if isinstance(left, And) else (left,)
        if Truth(False) not in operands:
            added = tuple(
                Scoped(each, branch.samples)
                for each in operands
                if isinstance(each, Comparison | Or)
            )
            yield replace(branch, conditions=branch.conditions + added)

    def _simplified(self, condition: Condition, branch: Branch) -> Condition:
        """The condition without BOUND, truths, and comparisons that have no value."""
        match condition:
            case Truth():
                return condition
            case Bound(variable, is_bound, is_static):
                if is_static:
                    has_value = self._has_value(StaticVariable(variable), branch)
                else:
                    has_value = self.is_bound(variable, branch)
                return Truth(has_value == is_bound)
            case Comparison(_, left, right):
                has_values = all(self._has_value(side, branch) for side in (left, right))
                return condition if has_values else Truth(False)
            case And(operands) | Or(operands):
                decides = isinstance(condition, Or)
                parts: list[Condition] = []
                for each in operands:
                    part = self._simplified(each, branch)
                    if part == Truth(decides):
                        return part
                    if isinstance(part, And | Or) and type(part) is type(condition):
                        parts += part.operands
                    elif not isinstance(part, Truth):
                        parts.append(part)
                if len(parts) < 2:
                    return parts[0] if parts else Truth(not decides)
                return And(tuple(parts)) if isinstance(condition, And) else Or(tuple(parts))
            case _:
                assert_never(condition)

    def _has_value(self, value: Value, branch: Branch) -> bool:
        match value:
            case Variable(name):
                return self.is_bound(name, branch)
            case Calculation(_, left, right):
                return self._has_value(left, branch) and self._has_value(right, branch)
            case TimeOf():
                return bool(branch.samples)
            case StaticVariable(name):
                return name in branch.static_names
            case _:
                return True

    def is_bound(self, name: str, branch: Branch) -> bool:
        """Whether a variable has a value in a branch. Raises `LanguageError` for one that only
        static triples would give one there."""
        if name in branch.names or name in self._given:
            return True
        for static in branch.static:
            if name in variables_of(static.triple):
                raise LanguageError(
                    f"`?{name}` has no value but a static one in one of the alternatives",
                    self._source,
                    static.span,
                    "write the static triple into the groups that read a sample of it",
                )
        return False

    # -- what is refused ---------------------------------------------------------------------

    def check_times(self, branches: list[Branch], span: Span) -> None:
        """Raise `LanguageError` for a branch without a sample."""
        if not all(branch.samples for branch in branches):
            raise LanguageError(
                "the group has no sample in it, so it has no time",
                self._source,
                span,
                "write a triple of a feature into it, or leave it out",
            )

    def _check_count(self, branches: list[Branch], span: Span) -> None:
        if len(branches) > MOST_BRANCHES:
            raise LanguageError(
                f"UNION and the optional operators make more than {MOST_BRANCHES} alternatives",
                self._source,
                span,
                "register parts of the pattern, and read their results",
            )

    def _check_static(self, branches: list[Branch], span: Span) -> None:
        if any(branch.static for branch in branches):
            raise LanguageError(
                "a side of an optional operator has static triples",
                self._source,
                span,
                "write them beside it: `{ {…} OPTIONALSEQ {…} ?c ex:sector ?s }`",
            )


def places_of(sample: Sample) -> tuple[Value, ...]:
    """Return the arguments and the value of a sample."""
    return (*(place for place, _ in sample.arguments), sample.value)


def _sequence(left: Branch, right: Branch) -> Branch:
    found = left.joined(right)
    return replace(found, sequences=(*found.sequences, (left.samples, right.samples)))


def _equal(left: Branch, right: Branch) -> Branch:
    found = left.joined(right)
    return replace(found, equals=(*found.equals, (left.samples, right.samples)))


def _alone(kept: Branch, pairs: list[Branch], *, is_equal: bool) -> Branch:
    absences = tuple(Alone(pair, kept.samples, is_equal) for pair in pairs)
    return replace(kept, absences=kept.absences + absences)
