"""Pattern plans as text, for ``explain`` and for tests."""

from __future__ import annotations

from collections.abc import Iterator
from typing import assert_never

from ....streams.time import format_duration
from .network import INFINITE, Network
from .plan import (
    OWN,
    Aggregate,
    Arithmetic,
    Between,
    Bound,
    Condition,
    Constant,
    CountProbe,
    Element,
    Expression,
    Key,
    Listed,
    PatternPlan,
    Point,
    Position,
    Probe,
    Same,
    StateProbe,
    Time,
    Value,
)


def print_plan(plan: PatternPlan) -> str:
    """Return a plan as text, a line a part."""
    return "\n".join(_lines(plan))


def print_network(network: Network) -> str:
    """Return the minimal network, retention, triggers and join orders of a plan as text."""
    return "\n".join(_network_lines(network))


def _lines(plan: PatternPlan) -> Iterator[str]:
    names = _Names(plan)
    yield "columns " + ", ".join(f"{each.name}: {each.type}" for each in plan.columns)
    for element in plan.elements:
        yield f"event {names.element(element)}"
    yield from (f"time {names.between(each)}" for each in plan.between)
    yield from (f"same {names.same(each)}" for each in plan.same)
    yield from (f"where {names.condition(each)}" for each in plan.conditions)
    for hull in plan.hulls:
        left, right = (", ".join(map(names.of, side)) for side in (hull.left, hull.right))
        yield f"hull({left}) = hull({right})"
    yield from (f"probe {names.probe(each)}" for each in plan.probes)
    partition = f" by {', '.join(plan.partition)}" if plan.partition else ""
    yield f"select {plan.selection}{partition}"
    if plan.within is not None:
        yield f"within {format_duration(plan.within)}"
    yield (
        "rows "
        + ("are intervals" if plan.has_intervals else "are instants")
        + (", distinct" if plan.is_distinct else "")
    )
    if plan.max_matches is not None:
        yield f"at most {plan.max_matches} matches of a row"
    yield from (f"return {names.output(each.value)} as {each.name}" for each in plan.outputs)
    for trend in plan.trends:
        of = "*" if trend.element is None else f"{names.of(trend.element)}[]"
        of += f".{trend.column}" if trend.column is not None else ""
        yield f"return {trend.function}({of}) of all matches as {trend.name}"


def _network_lines(network: Network) -> Iterator[str]:
    names, count = _Names(network.plan), network.count
    size = 2 * count if network.plan.has_intervals else count
    for a in range(size):
        for b in range(a + 1, size):
            most, least = network.greatest[a][b], -network.greatest[b][a]
            if most < INFINITE or least > -INFINITE:
                yield f"{names.variable(b)} - {names.variable(a)} in {_interval(least, most)}"
    for i, kept in enumerate(network.retention):
        yield f"{names.of(i)} is kept for {_duration(kept)}"
    for probe in network.plan.probes:
        yield f"{probe.what.name} is kept for {_duration(network.probe_retention(probe))}"
    for trigger in network.triggers():
        steps = []
        for level in network.join_order(trigger):
            keys = ", ".join(map(names.same, level.keys))
            steps.append(names.of(level.element) + (f" by {keys}" if keys else ""))
        yield f"{names.of(trigger)} comes last: " + ("; ".join(steps) or "alone")


class _Names:
    """Parts of a plan as text, with the names of its elements."""

    def __init__(self, plan: PatternPlan, own: str = "event") -> None:
        self._plan = plan
        self._own = own

    def of(self, element: int) -> str:
        return self._own if element == OWN else self._plan.elements[element].name

    def element(self, element: Element) -> str:
        own = _Names(self._plan, element.name)
        text = f"{element.name}{'+' if element.is_kleene else ''}: {' | '.join(element.kinds)}"
        conditions = " and ".join(map(own.condition, element.conditions))
        return text + (f" where {conditions}" if conditions else "")

    def variable(self, number: int) -> str:
        count = len(self._plan.elements)
        return self.point(Point(number % count, number >= count))

    def point(self, point: Point) -> str:
        return ("start of " if point.is_start else "") + self.of(point.element)

    def between(self, each: Between) -> str:
        least = -INFINITE if each.least is None else each.least
        most = INFINITE if each.most is None else each.most
        difference = f"{self.point(each.second)} - {self.point(each.first)}"
        return f"{difference} in {_interval(least, most)}"

    def same(self, each: Same) -> str:
        first, second = self.of(each.first), self.of(each.second)
        return f"{first}.{each.first_column} = {second}.{each.second_column}"

    def condition(self, each: Condition) -> str:
        return f"{self.expression(each.left)} {each.operator} {self.expression(each.right)}"

    def expression(self, expression: Expression) -> str:
        match expression:
            case Value(element, column, position):
                is_kleene = element != OWN and self._plan.elements[element].is_kleene
                place = f"[{position}]" if is_kleene or position is not Position.EACH else ""
                return f"{self.of(element)}{place}.{column}"
            case Time(elements, is_start):
                return f"{'start' if is_start else 'end'}({', '.join(map(self.of, elements))})"
            case Constant(value):
                return str(value)
            case Key(text):
                return text if text.startswith("<") else f'{text}"'
            case Arithmetic(operator, left, right):
                return f"({self.expression(left)} {operator} {self.expression(right)})"
            case Aggregate(function, element, column, is_before):
                rows = f"{self.of(element)}[{'..i-1' if is_before else ''}]"
                return f"{function}({rows}{f'.{column}' if column else ''})"
            case _:
                assert_never(expression)

    def output(self, value: Expression | Listed) -> str:
        if isinstance(value, Listed):
            return f"{self.of(value.element)}[].{value.column}"
        return self.expression(value)

    def bound(self, bound: Bound) -> str:
        if not bound.offset:
            return self.point(bound.point)
        sign = "+" if bound.offset > 0 else "-"
        return f"{self.point(bound.point)} {sign} {_duration(abs(bound.offset))}"

    def probe(self, probe: Probe) -> str:
        names = _Names(self._plan, probe.what.name)
        what = names.element(probe.what)
        same = "".join(f", {names.same(each)}" for each in probe.same)
        match probe:
            case CountProbe(_, low, high, least, most, _, conditions):
                number = _interval_text(str(least), "oo" if most is None else str(most))
                where = "".join(f", {names.condition(each)}" for each in conditions)
                times = f"[{self.bound(low)}, {self.bound(high)}]"
                return f"number of ({what}) at {times}{same}{where} in {number}"
            case StateProbe(_, at, _, state):
                where = " and ".join(map(names.condition, state)) or "exists"
                return f"last ({what}) up to {self.bound(at)}{same}: {where}"
            case _:
                assert_never(probe)


def _interval(least: int, most: int) -> str:
    return _interval_text(
        "-oo" if least <= -INFINITE else _duration(least),
        "oo" if most >= INFINITE else _duration(most),
    )


def _interval_text(least: str, most: str) -> str:
    opening, closing = "(" if least == "-oo" else "[", ")" if most == "oo" else "]"
    return f"{opening}{least}, {most}{closing}"


def _duration(duration: int) -> str:
    return f"-{format_duration(-duration)}" if duration < 0 else format_duration(duration)
