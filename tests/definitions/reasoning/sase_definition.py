"""The matches of a SASE+ pattern by the meaning of the language, straight from its text.

It reads the tree of a text, and neither plans nor the code that evaluates them. Under any match it
enumerates all tuples of events. Under the other strategies each event that suits the first part
begins a run, which takes events one by one.
"""

from __future__ import annotations

import itertools
import math
import operator
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dyknow.languages.mtl.ast import Number, Symbol, Text, TimePoint, Truth
from dyknow.languages.sase import ast
from dyknow.languages.sase.ast import Index, Strategy

COMPARE = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "=": operator.eq,
    "!=": operator.ne,
}
CALCULATE = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": lambda a, b: a / b if b else None,
    "%": lambda a, b: math.fmod(a, b) if b else None,
}


@dataclass(frozen=True)
class Event:
    """An event; ``number`` counts arrivals, which are in order of ``time``. A value that is missing
    is None; an object is its IRI in angle brackets."""

    number: int
    type: str
    time: int
    values: Mapping[str, Any]


Bound = dict[str, tuple[Event, ...]]
"""The events of each part that happens."""


@dataclass(frozen=True)
class Match:
    """The numbers of the events of each part, and the results."""

    events: tuple[tuple[int, ...], ...]
    results: tuple[Any, ...]


def matches(pattern: ast.Pattern, events: Sequence[Event], keys: Collection[str]) -> list[Match]:
    """All matches, in any order. Names of types are those of events; ``keys`` are the attributes
    that are texts or objects."""
    return list(_Definition(pattern, events, keys).found())


class _Definition:
    def __init__(
        self, pattern: ast.Pattern, events: Sequence[Event], keys: Collection[str]
    ) -> None:
        self.pattern = pattern
        self.keys = keys
        types = {symbol.text for part in pattern.parts for symbol in part.types}
        self.events = [event for event in events if event.type in types]
        self.parts = {part.name: part for part in pattern.parts}
        self.there = [part.name for part in pattern.parts if not part.is_negated]
        self.strategy = pattern.strategy or Strategy.ANY_MATCH
        assert pattern.within is not None
        self.within = pattern.within

    def found(self) -> Iterator[Match]:
        if any(map(is_over_matches, self.pattern.items)):
            yield from self.aggregated_matches()
            return
        any_match = self.strategy is Strategy.ANY_MATCH
        for bound in self.tuples() if any_match else self.runs():
            if self.nothing_absent(bound) and all(
                self.holds(each, bound, {}) for each in self.pattern.having
            ):
                numbers = tuple(tuple(e.number for e in bound[part]) for part in self.there)
                results = tuple(self.value(item.term, bound, {}) for item in self.pattern.items)
                yield Match(numbers, results)

    def suits(self, part: str, event: Event) -> bool:
        return any(symbol.text == event.type for symbol in self.parts[part].types)

    # -- any match -----------------------------------------------------------------------------

    def tuples(self) -> Iterator[Bound]:
        """All tuples of events in order of time that meet the conditions."""
        choices = []
        for part in self.there:
            own = [event for event in self.events if self.suits(part, event)]
            most = len(own) if self.parts[part].is_kleene else 1
            sizes = range(1, most + 1)
            choices.append([c for size in sizes for c in itertools.combinations(own, size)])
        for chosen in itertools.product(*choices):
            times = [event.time for events in chosen for event in events]
            is_sequence = all(a < b for a, b in itertools.pairwise(times))
            if is_sequence and times[-1] - times[0] <= self.within:
                bound = dict(zip(self.there, chosen, strict=True))
                if all(self.holds(each, bound, {}) for each in self.pattern.where):
                    yield bound

    def aggregated_matches(self) -> Iterator[Match]:
        """For each event that ends matches, its results; the first event is that of the earliest
        match."""
        found: dict[int, list[Bound]] = {}
        for bound in self.tuples():
            found.setdefault(bound[self.there[-1]][-1].number, []).append(bound)
        for last, together in found.items():
            first = min((b[self.there[0]][0] for b in together), key=lambda event: event.time)
            results = tuple(self.over_matches(item.term, together) for item in self.pattern.items)
            yield Match(((first.number,), (last,)), results)

    def over_matches(self, term: ast.Term, together: list[Bound]) -> Any:
        match term:
            case ast.CountMatches():
                return len(together)
            case ast.Aggregate(function, part, Index.ONE, name):
                return aggregated(function, [e for bound in together for e in bound[part]], name)
            case _:
                return self.value(term, together[0], {})

    # -- runs ----------------------------------------------------------------------------------

    def runs(self) -> Iterator[Bound]:
        for place, event in enumerate(self.events):
            begun = self.taken({}, self.there[0], event)
            if begun is not None:
                yield from self.run(begun, self.events[place + 1 :])

    def run(self, bound: Bound, rest: list[Event]) -> Iterator[Bound]:
        """The matches of a run that has just taken an event."""
        part = self.there[len(bound) - 1]
        is_last, is_kleene = len(bound) == len(self.there), self.parts[part].is_kleene
        if is_last and self.is_complete(bound, part):
            yield bound
        if is_last and not is_kleene:
            return
        for place, event in enumerate(rest):
            more = [self.taken(bound, part, event) if is_kleene else None]
            if not is_last and self.is_complete(bound, part):
                more.append(self.taken(bound, self.there[len(bound)], event))
            for each in more:
                if each is not None:
                    yield from self.run(each, rest[place + 1 :])
            if any(more) or self.breaks(bound[part][-1], event):
                return

    def breaks(self, last: Event, event: Event) -> bool:
        """Whether an event that a run does not take ends it."""
        match self.strategy:
            case Strategy.STRICT_CONTIGUITY:
                return True
            case Strategy.PARTITION_CONTIGUITY:
                names = [c.name for c in self.pattern.where if isinstance(c, ast.Equivalence)]
                return all(event.values[name] == last.values[name] for name in names)
            case _:
                return False

    def taken(self, bound: Bound, part: str, event: Event) -> Bound | None:
        """The run with one more event, if it may take it."""
        if not self.suits(part, event) or not self.has_keys(part, event):
            return None
        before = [each for events in bound.values() for each in events]
        if before and (event.time <= before[-1].time or event.time - before[0].time > self.within):
            return None
        more = {**bound, part: (*bound.get(part, ()), event)}
        at = {part: len(more[part]) - 1}
        settled = [
            each
            for each in self.pattern.where
            if self.last_of(each) in (part, None) and not self.is_of_whole(each, part)
        ]
        return more if all(self.holds(each, more, at) for each in settled) else None

    def has_keys(self, part: str, event: Event) -> bool:
        """Whether the event has each text and object that must equal one of another part."""
        for each in self.pattern.where:
            match each:
                case ast.Comparison("=", ast.Attribute() as left, ast.Attribute() as right):
                    is_of_two = left.part != right.part
                    happen = left.part in self.there and right.part in self.there
                    are_each = self.is_each(left) and self.is_each(right)
                    if is_of_two and happen and are_each:
                        for side in (left, right):
                            is_key = side.part == part and side.name in self.keys
                            if is_key and event.values[side.name] is None:
                                return False
                case _:
                    pass
        return True

    def is_each(self, node: ast.Attribute) -> bool:
        return not self.parts[node.part].is_kleene or node.index is Index.EACH

    def is_complete(self, bound: Bound, part: str) -> bool:
        """Whether the conditions hold that are known when a part is complete."""
        whole = [
            each
            for each in self.pattern.where
            if self.last_of(each) == part and self.is_of_whole(each, part)
        ]
        return all(self.holds(each, bound, {}) for each in whole)

    def last_of(self, condition: ast.Condition) -> str | None:
        """The last part that a comparison reads: then it is settled. None: each event by itself, as
        it is taken; empty: an absent part, so it selects nothing."""
        if isinstance(condition, ast.Equivalence):
            return None
        read = {leaf.part for leaf in leaves(condition)}
        if any(self.parts[part].is_negated for part in read):
            return ""
        return max(read, key=self.there.index)

    def is_of_whole(self, condition: ast.Condition, part: str) -> bool:
        """Whether a condition reads what is known when a repeated part is complete."""
        return self.parts[part].is_kleene and any(
            leaf.part == part and leaf.index in (Index.LAST, Index.ALL)
            for leaf in leaves(condition)
        )

    # -- conditions ----------------------------------------------------------------------------

    def holds(self, condition: ast.Condition, bound: Bound, at: dict[str, int]) -> bool:
        """Whether a condition holds, for each event of the repeated parts that it reads one by one;
        of a part in ``at`` for that event only."""
        if isinstance(condition, ast.Equivalence):
            values = {event.values[condition.name] for events in bound.values() for event in events}
            if condition.value is not None:
                return values == {self.value(condition.value, bound, {})}
            return len(values) == 1 and None not in values
        read = leaves(condition)
        if any(self.parts[leaf.part].is_negated for leaf in read):
            return True
        each = sorted(
            {leaf.part for leaf in read if self.parts[leaf.part].is_kleene and is_open(leaf)}
        )
        ranges = [[at[part]] if part in at else range(len(bound[part])) for part in each]
        for places in itertools.product(*ranges):
            one = dict(zip(each, places, strict=True))
            is_first = any(
                leaf.index in (Index.PREVIOUS, Index.BEFORE) and one[leaf.part] == 0
                for leaf in read
            )
            if not is_first and not self.compared(condition, bound, one):
                return False
        return True

    def compared(self, node: ast.Comparison, bound: Bound, at: dict[str, int]) -> bool:
        left, right = self.value(node.left, bound, at), self.value(node.right, bound, at)
        return None not in (left, right) and COMPARE[node.operator](left, right)

    def nothing_absent(self, bound: Bound) -> bool:
        """Whether no event of an absent part is there."""
        order = [part.name for part in self.pattern.parts]
        first, last = bound[self.there[0]][0].time, bound[self.there[-1]][-1].time
        for place, part in enumerate(order):
            if not self.parts[part].is_negated:
                continue
            before = [each for each in order[:place] if each in self.there]
            after = [each for each in order[place:] if each in self.there]
            low = bound[before[-1]][-1].time + 1 if before else last - self.within
            high = bound[after[0]][0].time - 1 if after else first + self.within
            for event in self.events:
                if low <= event.time <= high and self.is_meant(part, event, bound):
                    return False
        return True

    def is_meant(self, part: str, event: Event, bound: Bound) -> bool:
        """Whether an event is one that a part says to be absent."""
        if not self.suits(part, event):
            return False
        more = {**bound, part: (event,)}
        for condition in self.pattern.where:
            if isinstance(condition, ast.Equivalence):
                if not self.holds(condition, more, {}):
                    return False
                continue
            is_read = any(leaf.part == part for leaf in leaves(condition))
            if is_read and not self.compared(condition, more, {}):
                return False
        return True

    # -- values --------------------------------------------------------------------------------

    def value(self, term: ast.Term, bound: Bound, at: dict[str, int]) -> Any:
        match term:
            case Number(value) | Truth(value) | TimePoint(value) | ast.Duration(value):
                return value
            case Text(value):
                return value
            case Symbol(text):
                return text
            case ast.Negative(operand):
                value = self.value(operand, bound, at)
                return None if value is None else -value
            case ast.Arithmetic(operator_, left, right):
                sides = self.value(left, bound, at), self.value(right, bound, at)
                return None if None in sides else CALCULATE[operator_](*sides)
            case ast.Aggregate(function, part, index, name):
                events = bound[part][: at[part]] if index is Index.BEFORE else bound[part]
                return aggregated(function, events, name)
            case ast.Attribute(part, index, name):
                events = bound[part]
                if index is Index.ALL and self.parts[part].is_kleene:
                    return tuple(event.values[name] for event in events)
                place = {
                    Index.LAST: -1,
                    Index.EACH: at.get(part, 0),
                    Index.PREVIOUS: at.get(part, 0) - 1,
                }.get(index, 0)
                event = events[place]
                return event.time if name == "valid" else event.values[name]
            case _:
                raise NotImplementedError(term)


def leaves(node: ast.Condition | ast.Term) -> list[ast.Attribute | ast.Aggregate]:
    """The attributes and aggregates that a condition reads."""
    match node:
        case ast.Comparison(_, left, right) | ast.Arithmetic(_, left, right):
            return leaves(left) + leaves(right)
        case ast.Negative(operand):
            return leaves(operand)
        case ast.Attribute() | ast.Aggregate():
            return [node]
        case _:
            return []


def is_over_matches(item: ast.Item) -> bool:
    term = item.term
    is_aggregate = isinstance(term, ast.Aggregate) and term.index is Index.ONE
    return is_aggregate or isinstance(term, ast.CountMatches)


def is_open(leaf: ast.Attribute | ast.Aggregate) -> bool:
    return leaf.index in (Index.EACH, Index.PREVIOUS, Index.BEFORE)


def aggregated(function: str, events: Sequence[Event], name: str | None) -> Any:
    """An aggregate over the values that are there."""
    if name is None:
        return len(events)
    values = [event.values[name] for event in events if event.values[name] is not None]
    if not values:
        return None
    match function:
        case "sum":
            return sum(values)
        case "avg":
            return sum(values) / len(values)
        case "min":
            return min(values)
        case _:
            return max(values)
