"""Checks the conditions of SASE+ patterns, and what they read (SPEC §8)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from ..mtl.ast import Measured, Symbol, Variable
from . import ast
from .checked import TIME, condition_leaves, is_over_matches
from .parameters import Parameters, no_value
from .parts import Parts

_OPEN: Final = frozenset({ast.Index.EACH, ast.Index.PREVIOUS, ast.Index.BEFORE})
_READING: Final = (ast.Attribute, ast.Aggregate)
_BEFORE: Final = frozenset({ast.Index.PREVIOUS, ast.Index.BEFORE})


class Conditions:
    """Checks conditions. All methods raise `LanguageError`."""

    def __init__(self, parts: Parts, parameters: Parameters) -> None:
        self._parts = parts
        self._parameters = parameters

    def check(self, condition: ast.Condition, *, is_having: bool) -> None:
        leaves = condition_leaves(condition)
        for leaf in leaves:
            self.check_leaf(leaf)
            self.check_no_list(leaf)
            if is_over_matches(leaf):
                raise self._parts.error(
                    "an aggregate over all matches is no property of one",
                    leaf.span,
                    "aggregate the events of the match: `count(a[])`, `sum(a[].x)`",
                )
        read = [leaf for leaf in leaves if isinstance(leaf, _READING)]
        if isinstance(condition, ast.Equivalence):
            if condition.name == TIME:
                raise self._parts.error(
                    "events of one time never follow each other",
                    condition.span,
                    f"bound the time between two parts: `b.{TIME} - a.{TIME} <= 5s`",
                )
            if is_having:
                raise self._parts.error(
                    f"`[{condition.name}]` selects events, and HAVING filters matches",
                    condition.span,
                    "write it in WHERE",
                )
            if read:
                raise self._parts.error(
                    f"`[{condition.name} = …]` compares all events with a constant",
                    read[0].span,
                    f"write `[{condition.name}]`, or compare two parts",
                )
            return
        if not read:
            # A parameter for objects is one of an event, too.
            if any(
                isinstance(leaf, Variable) and leaf.name in self._parameters.objects
                for leaf in leaves
            ):
                return
            raise self._parts.error(
                "the condition reads no event", condition.span, "read one, as in `a.price > 100`"
            )
        if is_having:
            for each in read:
                self.check_settled(each, "HAVING is about a whole match")
        self._check_absent(condition, read)
        self._check_before(leaves)

    def check_leaf(self, leaf: ast.Term) -> None:
        """Refuse a part, an index or a parameter that is not there."""
        match leaf:
            case Variable(name) | Measured(Variable(name)):
                if name not in self._parameters.slots:
                    raise self._parts.error(*no_value(name, leaf.span))
            case Symbol(text) if text in self._parts.of_name:
                raise self._parts.error(
                    f"`{text}` is an event, not a value", leaf.span, f"write `{text}.id`"
                )
            case ast.Attribute(name, index) | ast.Aggregate(_, name, index):
                part = self._parts.part(name, leaf.span)
                is_one = isinstance(leaf, ast.Attribute) and index is ast.Index.ONE
                if part.is_kleene and is_one:
                    raise self._parts.error(
                        f"`{name}` is several events",
                        leaf.span,
                        f"write `{name}[i]` for each of them, `{name}[1]`, "
                        f"`{name}[{name}.LEN]`, or an aggregate such as `max({name}[].x)`",
                    )
                if not part.is_kleene and index in _BEFORE:
                    raise self._parts.error(
                        f"`{name}` is one event",
                        leaf.span,
                        f"write `+` after its type, or `{name}`",
                    )
            case _:
                pass

    def check_no_list(self, leaf: ast.Term) -> None:
        if isinstance(leaf, ast.Attribute) and leaf.index is ast.Index.ALL:
            raise self._parts.error(
                f"`{leaf.part}[].{leaf.name}` is a list",
                leaf.span,
                f"return it by itself, or write an aggregate: `max({leaf.part}[].{leaf.name})`",
            )

    def check_settled(self, leaf: ast.Attribute | ast.Aggregate, why: str) -> None:
        """Refuse what has another value for each event of a repeated part."""
        part = self._parts.of_name[leaf.part]
        if part.is_negated:
            raise self._parts.error(
                f"{why}, and `{part.name}` is absent from it", leaf.span, "read another part"
            )
        if part.is_kleene and leaf.index in _OPEN:
            raise self._parts.error(
                f"{why}, and `{part.name}{leaf.index}` is each of its events in turn",
                leaf.span,
                f"write `{part.name}[1]`, `{part.name}[{part.name}.LEN]` or an aggregate",
            )

    def _check_absent(
        self, condition: ast.Condition, read: Sequence[ast.Attribute | ast.Aggregate]
    ) -> None:
        absent = {leaf.part for leaf in read if self._parts.of_name[leaf.part].is_negated}
        if len(absent) > 1:
            first, second, *_ = sorted(absent)
            raise self._parts.error(
                f"`{first}` and `{second}` are both absent, each by itself",
                condition.span,
                "compare each with an event that happens",
            )
        for leaf in read:
            if absent and not self._parts.of_name[leaf.part].is_negated:
                self.check_settled(leaf, "an absent event is compared with the whole match")

    def _check_before(self, leaves: Sequence[ast.Term]) -> None:
        """Refuse ``a[i-1]`` where no later event of that part is taken."""
        order = list(self._parts.of_name)
        # A parameter is the object of some part.
        given = (
            self._parameters.defining.get(leaf.name)
            for leaf in leaves
            if isinstance(leaf, Variable)
        )
        read = [leaf for leaf in (*leaves, *given) if isinstance(leaf, _READING)]
        last = max((leaf.part for leaf in read), key=order.index)
        for leaf in read:
            if leaf.index not in _BEFORE:
                continue
            others = {each.index for each in read if each.part == leaf.part}
            if leaf.part != last or not others <= {ast.Index.EACH, ast.Index.FIRST, *_BEFORE}:
                raise self._parts.error(
                    f"`{leaf.part}{leaf.index}` is known while `{leaf.part}[i]` is taken, and "
                    "other parts of the condition later",
                    leaf.span,
                    f"compare it with `{leaf.part}[i]` and with earlier parts",
                )
