"""Random plans of runs, and rows for them (`pattern_drawing`)."""

from __future__ import annotations

from dataclasses import replace

from pattern_drawing import COLUMNS, PatternDrawing

from dyknow.reasoning.patterns.plans.plan import (
    ARITHMETIC,
    OPERATORS,
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
    Function,
    Listed,
    Output,
    PatternPlan,
    Point,
    Position,
    Probe,
    Same,
    Selection,
    StateProbe,
    Time,
    Trend,
    Value,
)

RUNS = (
    Selection.NEXT_MATCH,
    Selection.NEXT_MATCH,
    Selection.PARTITION_CONTIGUITY,
    Selection.STRICT_CONTIGUITY,
)


class RunDrawing(PatternDrawing):
    """A plan of a strategy that selects the next row, or of any match with repetition."""

    def __init__(
        self, seed: int, *, selections: tuple[Selection, ...] = RUNS, most_elements: int = 4
    ) -> None:
        super().__init__(seed, most_elements=most_elements)
        draw = self.random
        self.elements = tuple(
            replace(self.element(f"e{i}"), is_kleene=draw.random() < 0.4) for i in range(self.count)
        )
        self.kleene = [i for i, each in enumerate(self.elements) if each.is_kleene]
        selection = draw.choice(selections)
        self.plan = PatternPlan(
            COLUMNS,
            self.elements,
            tuple(self.between() for _ in range(draw.choice([0, 0, 0, 1]))),
            self.keys(),
            tuple(self.repeated() for _ in range(draw.choice([0, 0, 1, 1, 2]))),
            tuple(self.run_probe() for _ in range(draw.choice([0, 0, 0, 1, 1, 2]))),
            selection,
            within=draw.choice([5, 12, 25, 25, 40]),
            has_intervals=self.has_intervals,
            outputs=self.results(),
            partition=(draw.choice("xy"),) if selection is Selection.PARTITION_CONTIGUITY else (),
            max_matches=1_000_000,
        )

    def element(self, name: str) -> Element:
        # Frequent sources, as the next row has to suit.
        return replace(
            super().element(name),
            kinds=tuple(self.random.sample("ABC", self.random.choice([1, 2, 2, 3]))),
        )

    def keys(self) -> tuple[Same, ...]:
        draw = self.random
        if draw.random() < 0.5:
            columns = draw.choice(["xxxx", "xxxx", "xyxy"])
            return tuple(Same(i, columns[i], i + 1, columns[i + 1]) for i in range(self.count - 1))
        return tuple(self.same() for _ in range(draw.choice([0, 0, 1])))

    def between(self) -> Between:
        draw = self.random
        first, second = sorted(draw.choices(range(self.count), k=2))
        least = draw.choice([None, draw.randint(-2, 3)])
        most = draw.choice([None, (least or 0) + draw.randint(0, 15)])
        points = Point(first, draw.random() < 0.4), Point(second, draw.random() < 0.4)
        return Between(*points, least, most)

    def repeated(self) -> Condition:
        """A condition that a plan of runs may have."""
        draw = self.random
        while True:
            depth = draw.choice([0, 0, 1])
            sides = self.side(depth), self.side(depth)
            condition = Condition(draw.choice(OPERATORS), *sides)
            if self.is_allowed(condition):
                return condition

    def side(self, depth: int) -> Expression:
        draw = self.random
        if depth and draw.random() < 0.6:
            return Arithmetic(draw.choice(ARITHMETIC), self.side(depth - 1), self.side(depth - 1))
        drawn = draw.random()
        if drawn < 0.15:
            return Constant(draw.choice([0, 1, 2, 3, 1.5]))
        if drawn < 0.25:
            return Time((self.some(),), draw.random() < 0.5)
        element = self.some()
        if element not in self.kleene:
            return Value(element, draw.choice("mmvvv"))
        if draw.random() < 0.35:
            return self.aggregate(element, is_before=draw.random() < 0.5)
        return Value(element, draw.choice("mmvvv"), draw.choice(list(Position)))

    def aggregate(self, element: int, *, is_before: bool = False) -> Aggregate:
        draw = self.random
        function = draw.choice(list(Function))
        column = draw.choice([None, "m", "v"] if function is Function.COUNT else ["m", "v"])
        return Aggregate(function, element, column, is_before)

    def is_allowed(self, condition: Condition) -> bool:
        before, whole, read = set(), set(), set()
        for leaf in self.leaves(condition.left) + self.leaves(condition.right):
            match leaf:
                case Value(e, _, position):
                    read.add(e)
                    before |= {e} if position is Position.PREVIOUS else set()
                    whole |= {e} if position is Position.LAST else set()
                case Aggregate(_, e, _, is_before):
                    read.add(e)
                    (before if is_before else whole).add(e)
                case Time(elements, is_start):
                    read.update(elements)
                    whole |= set() if is_start else set(elements) & set(self.kleene)
        last = max(read, default=0)
        return not before or (before == {last} and last not in whole)

    def leaves(self, side: Expression) -> list[Expression]:
        if isinstance(side, Arithmetic):
            return self.leaves(side.left) + self.leaves(side.right)
        return [side]

    def settled(self) -> Expression:
        """A value that a match has once."""
        draw = self.random
        element = self.some()
        if draw.random() < 0.15:
            return Time((element, self.some()), draw.random() < 0.5)
        if element not in self.kleene:
            return Value(element, draw.choice("xmv"))
        if draw.random() < 0.5:
            return self.aggregate(element)
        return Value(element, draw.choice("xmv"), draw.choice([Position.FIRST, Position.LAST]))

    def results(self) -> tuple[Output, ...]:
        draw = self.random
        found = [Output(f"o{i}", self.settled()) for i in range(draw.choice([0, 1, 3]))]
        listed = self.kleene if draw.random() < 0.5 else []
        return (*found, *(Output(f"l{e}", Listed(e, draw.choice("xmv"))) for e in listed))

    def run_probe(self) -> Probe:
        """``~`` at the start, in the middle or at the end, or any probe."""
        draw = self.random
        probe = super().probe()
        conditions = (
            (Condition(draw.choice(OPERATORS), Value(OWN, "v"), self.settled()),)
            if draw.random() < 0.3
            else ()
        )
        if isinstance(probe, StateProbe):
            return replace(probe, state=conditions or (self.own(),))
        place = draw.randint(-1, self.count - 1)
        low = Bound(Point(place), 1) if place >= 0 else Bound(Point(self.count - 1), -12)
        high = (
            Bound(Point(place + 1, True), -1)
            if place + 1 < self.count
            else Bound(Point(0, True), 12)
        )
        drawn = replace(probe, conditions=conditions)
        if draw.random() < 0.7:
            drawn = CountProbe(probe.what, low, high, same=probe.same, conditions=conditions)
        return drawn

    def own(self) -> Condition:
        return Condition("<", Value(OWN, "v"), Constant(self.random.choice([1, 2, 3])))


class TrendDrawing(RunDrawing):
    """A plan of aggregates over all matches."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed, selections=(Selection.ANY_MATCH,), most_elements=3)
        draw = self.random
        last = self.count - 1
        place = Position.LAST if last in self.kleene else Position.EACH
        outputs = (
            Output("start", Time(tuple(range(self.count)), True)),
            Output("end", Time((last,))),
            Output("m", Value(last, "m", place)),
        )
        self.plan = replace(
            self.plan,
            between=(),
            same=self.neighbouring_keys(),
            conditions=tuple(self.neighbouring() for _ in range(draw.choice([0, 0, 1, 2]))),
            probes=(),
            outputs=tuple(draw.sample(outputs, draw.randint(0, 3))),
            trends=tuple(self.trend(i) for i in range(draw.randint(1, 3))),
            max_matches=None,
        )

    def neighbouring_keys(self) -> tuple[Same, ...]:
        draw = self.random
        drawn = draw.random()
        if drawn < 0.3 or self.count == 1:
            return ()
        if drawn < 0.7:
            return tuple(Same(i, "x", i + 1, "x") for i in range(self.count - 1))
        first = draw.randrange(self.count - 1)
        return (Same(first, "x", first + 1, draw.choice("xy")),)

    def neighbouring(self) -> Condition:
        """A condition on rows that follow each other."""
        draw = self.random
        operator, e = draw.choice(OPERATORS), self.some()
        right: Expression = Value(e, draw.choice("mv"))
        if e in self.kleene and (e == 0 or draw.random() < 0.5):
            left: Expression = Value(e, draw.choice("mv"), Position.PREVIOUS)
        elif e == 0:
            left = Constant(draw.choice([0, 1, 2]))
        else:
            place = Position.LAST if e - 1 in self.kleene else Position.EACH
            left = Value(e - 1, draw.choice("mv"), place)
            if draw.random() < 0.2:
                left, right = Time((e - 1,)), Time((e,), True)
                left = Arithmetic("+", left, Constant(draw.randint(1, 6)))
            elif e in self.kleene:
                right = Value(e, draw.choice("mv"), Position.FIRST)
        if draw.random() < 0.3 and not isinstance(left, Arithmetic):
            left = Arithmetic("+", left, Constant(draw.choice([1, 0.5])))
        return Condition(operator, right, left)

    def trend(self, number: int) -> Trend:
        draw = self.random
        if draw.random() < 0.3:
            return Trend(f"t{number}", Function.COUNT)
        function = draw.choice(list(Function))
        column = draw.choice([None, "m", "v"]) if function is Function.COUNT else draw.choice("mv")
        return Trend(f"t{number}", function, self.some(), column)
