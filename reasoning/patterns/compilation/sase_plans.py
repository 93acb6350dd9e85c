"""Compiles SASE+ patterns to plans (SPEC §8).

A part that happens is an element, each after the one before it; an absent part is a probe that
counts no event. HAVING filters whole matches: where the strategy selects events, it is a probe, so
that it does not change what is selected.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final

from ....languages.errors import LanguageError, Span
from ....languages.mtl.ast import Symbol, Variable
from ....languages.mtl.checked import Kind
from ....languages.rewriting import rewritten
from ....languages.sase import ast
from ....languages.sase.checked import TIME, CheckedPattern, is_over_matches, leaves_of, terms_of
from ....languages.sase.results import result_name
from ..plans.plan import (
    OWN,
    Arithmetic,
    Between,
    Bound,
    Condition,
    Constant,
    CountProbe,
    Element,
    Expression,
    Function,
    Listed,
    Output,
    PatternPlan,
    PlanError,
    Point,
    Same,
    Selection,
    Time,
    Trend,
)
from ..plans.query import END, START, Argument, Keys, Kinds, PatternQuery, Result, with_numbers
from ..sequences.run_packing import sequence_network
from ..sequences.trend_packing import pack_trends
from .sase_sources import Attributes, is_key, source_kind
from .sase_terms import NS, Terms, Typed

_SECOND: Final = 1e9


def sase_query(checked: CheckedPattern, kinds: Kinds) -> PatternQuery:
    """Return a checked pattern as a query over rows. ``kinds``: those of the fields of the streams
    that matching has found (`sase_sources`).

    Raises `LanguageError` for an attribute that no stream has, and where kinds or units differ.
    """
    return _Compiler(checked, kinds).query()


class _Compiler:
    def __init__(self, checked: CheckedPattern, kinds: Kinds) -> None:
        self._checked = checked
        self._text = checked.text
        self._attributes = Attributes(checked, kinds)
        self._there = [part for part in self._text.parts if not part.is_negated]
        self._numbers = {part.name: i for i, part in enumerate(self._there)}
        self._terms = Terms(
            self._attributes,
            {part.name: (i, part.is_kleene) for i, part in enumerate(self._there)},
        )
        self._parts = {part.name: part for part in self._text.parts}
        self._given = self._object_terms()
        within = checked.text.within
        assert isinstance(within, int), "the check wants one, and binding gives a parameter's"
        self._within = within
        self._own: dict[str, list[Condition]] = {part: [] for part in self._parts}
        self._beside: dict[str, list[Condition]] = {part: [] for part in self._parts}
        """The conditions on an absent part and others."""
        self._same: dict[str | None, list[Same]] = {None: [], **{p: [] for p in self._parts}}
        """Equal keys of each absent part; None: of elements."""
        self._equalities: list[tuple[Same, ast.Comparison]] = []
        """Equal keys of elements, as written."""
        self._conditions: list[Condition] = []

    def query(self) -> PatternQuery:
        text = self._text
        for condition in text.where:
            is_shared = condition != rewritten(condition, self._with_object)
            is_shared = is_shared or isinstance(condition, ast.Equivalence)
            for comparison in self._comparisons(condition):
                self._add(comparison, is_shared=is_shared)
        self._add_equalities()
        partition = self._partition()
        probes = [self._absence(i) for i, part in enumerate(text.parts) if part.is_negated]
        selection = Selection(text.strategy.value) if text.strategy else Selection.ANY_MATCH
        probes += self._having(selection)
        outputs, trends, results = self._results()
        last = len(self._there) - 1
        try:
            plan = PatternPlan(
                self._attributes.columns(),
                tuple(self._element(part.name) for part in self._there),
                tuple(
                    Between(Point(i), self._start(i + 1), least=1)
                    for i in range(len(self._there) - 1)
                ),
                tuple(self._same[None]),
                tuple(self._conditions),
                tuple(probes),
                selection,
                self._within,
                outputs=(Output(START, Time((0,), True)), Output(END, Time((last,))), *outputs),
                trends=trends,
                partition=partition,
                max_matches=text.limit,
            )
            if trends:
                # It refuses what reads events that are no neighbours. Their place is known here.
                pack_trends(with_numbers(plan, Keys()), sequence_network(plan))
        except PlanError as error:
            places = [self._there[i].span for i in error.elements] or [text.span]
            raise self._error(error.message, places[0], error.hint) from None
        return PatternQuery(
            text.name, self._attributes.sources(), (plan,), results, max_delay=text.max_delay
        )

    def _error(self, message: str, span: Span, hint: str) -> LanguageError:
        return self._attributes.error(message, span, hint)

    # -- parts -------------------------------------------------------------------------------

    def _element(self, part: str) -> Element:
        types = self._checked.types[self._text.parts.index(self._parts[part])]
        kinds = tuple(dict.fromkeys(map(source_kind, types)))
        is_kleene = self._parts[part].is_kleene
        return Element(part, kinds, tuple(self._own[part]), is_kleene)

    def _start(self, element: int) -> Point:
        return Point(element, self._there[element].is_kleene)

    def _absence(self, place: int) -> CountProbe:
        """An absent part: between its neighbours; before the first part as far as a match that ends
        with the last one may reach back; after the last one as far as a match may last."""
        parts, within = self._text.parts, self._within
        part = parts[place]
        before = [self._numbers[p.name] for p in parts[:place] if not p.is_negated]
        after = [self._numbers[p.name] for p in parts[place:] if not p.is_negated]
        last = len(self._there) - 1
        low = Bound(Point(before[-1]), 1) if before else Bound(Point(last), -within)
        high = Bound(self._start(after[0]), -1) if after else Bound(self._start(0), within)
        return CountProbe(
            self._element(part.name),
            low,
            high,
            same=tuple(self._same[part.name]),
            conditions=tuple(self._beside[part.name]),
        )

    def _having(self, selection: Selection) -> list[CountProbe]:
        found = [
            self._terms.condition(rewritten(condition, self._with_first))
            for condition in self._text.having
        ]
        if selection is Selection.ANY_MATCH:
            self._conditions += found
            return []
        # The first event itself is counted if the conditions hold.
        first = self._element(self._there[0].name)
        what = Element(f"{first.name} of a match", first.kinds)
        at = Bound(self._start(0))
        return [CountProbe(what, at, at, 1, None, conditions=tuple(found))] if found else []

    def _partition(self) -> tuple[str, ...]:
        if self._text.strategy is not ast.Strategy.PARTITION_CONTIGUITY:
            return ()
        columns = []
        for condition in self._text.where:
            if isinstance(condition, ast.Equivalence):
                first = self._there[0].name
                found = self._attributes.key(first, condition.name, condition.span)
                columns += [] if found is None else [found.column]
        return tuple(dict.fromkeys(columns))

    # -- conditions --------------------------------------------------------------------------

    def _object_terms(self) -> dict[str, ast.Term]:
        """What each parameter for objects stands for: an object, or that of some event."""
        found: dict[str, ast.Term] = {}
        for each in self._checked.objects:
            given = Symbol(f"<{each.object}>", each.defined_by.span)
            found[each.name] = each.defined_by if each.object is None else given
        return found

    def _each(self, part: str, name: str, at: ast.Condition) -> ast.Attribute:
        index = ast.Index.EACH if self._parts[part].is_kleene else ast.Index.ONE
        return ast.Attribute(part, index, name, at.span)

    def _comparisons(self, condition: ast.Condition) -> Iterator[ast.Comparison]:
        """A condition as comparisons; an equivalence is one for each part."""
        bound = rewritten(condition, self._with_object)
        match bound:
            case ast.Comparison():
                yield bound
            case ast.Equivalence(name, value):
                shared = self._each(self._there[0].name, name, bound) if value is None else value
                for part in self._parts:
                    each = self._each(part, name, bound)
                    if each != shared or self._parts[part].is_kleene or len(self._there) == 1:
                        yield ast.Comparison("=", each, shared, bound.span)

    def _is_given(self, node: Any) -> bool:
        return isinstance(node, Variable) and node.name in self._given

    def _with_object(self, node: Any) -> Any:
        return self._given[node.name] if self._is_given(node) else node

    def _with_first(self, node: Any) -> Any:
        return self._settled(self._given[node.name]) if self._is_given(node) else node

    def _settled(self, node: Any) -> Any:
        is_each = isinstance(node, ast.Attribute) and node.index is ast.Index.EACH
        return self._first(node) if is_each else node

    def _add(self, node: ast.Comparison, *, is_shared: bool) -> None:
        """Put a comparison where it belongs. ``is_shared``: an attribute on both sides is not that
        of each event by itself, but one value of all of them."""
        leaves = [leaf for term in terms_of(node) for leaf in leaves_of(term)]
        read = [leaf for leaf in leaves if isinstance(leaf, ast.Attribute | ast.Aggregate)]
        parts = list(dict.fromkeys(leaf.part for leaf in read))
        absent = next((part for part in parts if self._parts[part].is_negated), None)
        is_self = isinstance(node.left, ast.Attribute) and node.left == node.right
        same = None
        if is_shared or not is_self:
            same = self._same_keys(node, absent, is_shared=is_shared)
        if same is not None and absent is None and not is_shared:
            self._equalities.append((same, node))
        elif same is not None:
            self._same[absent].append(same)
        elif absent is not None:
            # Only a parameter for objects reads `a[i]` here, and then all its events have one.
            settled: ast.Comparison = rewritten(node, self._settled)
            beside = self._beside if len(parts) > 1 else self._own
            beside[absent].append(self._terms.condition(settled, absent))
        elif len(parts) == 1 and all(self._is_each(leaf) for leaf in read):
            self._own[parts[0]].append(self._terms.condition(node, parts[0]))
        else:
            self._conditions.append(self._terms.condition(node))

    def _add_equalities(self) -> None:
        """Make keys of the equalities as written, as far as that does not select otherwise.

        Equal keys are transitive: with ``a.x = c.x and b.x = c.x`` they would test b against a.
        Where the strategy selects events, a part is therefore joined to earlier ones by one
        equality, and only to one event or to several that are equal. Any match is the same in both
        ways.
        """
        joined: dict[tuple[int, str], set[tuple[int, str]]] = {}

        def key_of(element: int, column: str) -> set[tuple[int, str]]:
            return joined.setdefault((element, column), {(element, column)})

        def join(same: Same) -> None:
            one = key_of(same.first, same.first_column) | key_of(same.second, same.second_column)
            joined.update(dict.fromkeys(one, one))

        for same in self._same[None]:
            join(same)
        is_any = self._text.strategy in (None, ast.Strategy.ANY_MATCH)
        for same, node in sorted(
            self._equalities, key=lambda each: max(each[0].first, each[0].second)
        ):
            ends = (same.first, same.first_column), (same.second, same.second_column)
            earlier, later = sorted(ends)
            is_one = not self._there[earlier[0]].is_kleene or len(key_of(*earlier)) > 1
            if is_any or (is_one and len(key_of(*later)) == 1):
                join(same)
                self._same[None].append(same)
            else:
                self._conditions.append(self._terms.condition(node))
                self._add_presence(node.left)
                self._add_presence(node.right)

    def _add_presence(self, node: ast.Term) -> None:
        """Demand a key of each event of a part, as an equality that is a key does."""
        assert isinstance(node, ast.Attribute)
        own = self._terms.term(node, node.part).value
        self._own[node.part].append(Condition("=", own, own))

    def _is_each(self, leaf: ast.Attribute | ast.Aggregate) -> bool:
        """Whether an event has the value by itself."""
        is_kleene = self._parts[leaf.part].is_kleene
        return not is_kleene or (isinstance(leaf, ast.Attribute) and leaf.index is ast.Index.EACH)

    def _same_keys(
        self, node: ast.Comparison, absent: str | None, *, is_shared: bool
    ) -> Same | None:
        """An equality of keys that an index can find: of all events of two parts, or of one that is
        repeated or alone."""
        match node:
            case ast.Comparison("=", ast.Attribute() as left, ast.Attribute() as right):
                pass
            case _:
                return None
        is_alone = self._parts[left.part].is_kleene or len(self._there) == 1
        if left.part == right.part and not (left == right and is_alone and absent is None):
            return None
        # The absent one comes first.
        sides = (right, left) if right.part == absent else (left, right)
        found = [self._key(side, absent, is_shared=is_shared) for side in sides]
        first, second = found
        if first is None or second is None or first[0] is not second[0]:
            return None
        return Same(*first[1:], *second[1:])

    def _key(
        self, node: ast.Attribute, absent: str | None, *, is_shared: bool
    ) -> tuple[Kind, int, str] | None:
        """The kind, element and column of an attribute that is a key of each event of a part;
        ``is_shared`` makes it one."""
        if node.name == TIME or not self._is_each(node):
            return None
        found = self._attributes.key(node.part, node.name, node.span)
        if found is None or not (is_shared or is_key(found.kind)):
            return None
        element = OWN if node.part == absent else self._numbers[node.part]
        return found.kind, element, found.column

    # -- results -----------------------------------------------------------------------------

    def _results(self) -> tuple[tuple[Output, ...], tuple[Trend, ...], tuple[Result, ...]]:
        outputs: list[Output] = []
        trends: list[Trend] = []
        results: list[Result] = []
        for each in self._checked.objects:
            # All events of a repeated part have one object. Over all matches the last is known.
            known = self._settled(each.defined_by)
            if self._checked.is_over_matches and known != each.defined_by:
                known = replace(known, index=ast.Index.LAST)
            typed = self._terms.term(known)
            outputs.append(Output(each.name, typed.value))
            argument = Argument(each.sort, each.object)
            results.append(Result(each.name, Kind.OBJECT, argument))
        for item in self._text.items:
            name = result_name(item)
            assert name is not None
            if is_over_matches(item.term):
                trends.append(self._trend(name, item.term))
                results.append(Result(name, Kind.NUMBER))
            else:
                value, kind, argument_ = self._output(item.term)
                outputs.append(Output(name, value))
                results.append(Result(name, kind, argument_))
        return tuple(outputs), tuple(trends), tuple(results)

    def _first(self, node: ast.Attribute) -> ast.Attribute:
        is_kleene = self._parts[node.part].is_kleene
        return replace(node, index=ast.Index.FIRST) if is_kleene else node

    def _output(self, term: ast.Term) -> tuple[Expression | Listed, Kind, Argument | None]:
        bound: ast.Term = rewritten(term, self._with_first)
        typed = self._terms.term(bound)
        value, argument = self._in_seconds(typed), None
        if isinstance(bound, ast.Attribute) and bound.name != TIME:
            found = self._attributes.attribute(bound.part, bound.name, bound.span)
            argument = found.argument
            if bound.index is ast.Index.ALL and self._parts[bound.part].is_kleene:
                return Listed(self._numbers[bound.part], found.column), typed.kind, argument
        return value, typed.kind, argument

    def _in_seconds(self, typed: Typed) -> Expression:
        """A value as a result has it: a duration in seconds."""
        if typed.kind is Kind.NUMBER and typed.unit == NS:
            return Arithmetic("/", typed.value, Constant(_SECOND))
        return typed.value

    def _trend(self, name: str, term: ast.Term) -> Trend:
        if not isinstance(term, ast.Aggregate):
            return Trend(name, Function.COUNT)
        element = self._numbers[term.part]
        if term.name is None:
            return Trend(name, Function.COUNT, element)
        self._terms.numbers(term)
        return Trend(name, Function(term.function), element, self._terms.column(term))
