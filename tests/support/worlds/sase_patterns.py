"""Random SASE+ patterns that mean something, and random events for them."""

from __future__ import annotations

from random import Random
from typing import Any

import numpy as np
from sase_definition import Event

from dyknow.languages.mtl.checked import Kind
from dyknow.rdf.namespaces import DYKNOW
from dyknow.reasoning.patterns.plans.plan import NO_VALUE
from dyknow.reasoning.patterns.plans.query import (
    Keys,
    Part,
    PatternQuery,
    text_key,
    value_keys,
)
from dyknow.reasoning.patterns.plans.rows import Rows

TYPES = ("A", "B", "C")
FIELDS = {"tag": Kind.TEXT, "n": Kind.NUMBER, "m": Kind.NUMBER, "at": Kind.TIME, "ok": Kind.TRUTH}
KINDS = {(type_, field): kind for type_ in TYPES for field, kind in FIELDS.items()}
KEYS = ("tag", "id")
STRATEGIES = (
    "skip_till_any_match",
    "skip_till_next_match",
    "partition_contiguity",
    "strict_contiguity",
)
MISSING = 0.05


class PatternDrawing:
    """The text of a pattern over the types A, B and C, and events."""

    def __init__(self, seed: int) -> None:
        self.random = draw = Random(seed)
        self.strategy = draw.choice(STRATEGIES)
        self.parts: list[tuple[str, bool, bool]] = []
        """Name, whether absent, whether repeated."""
        for name in "abcd"[: draw.choice([1, 2, 2, 3, 3, 4])]:
            is_absent = draw.random() < 0.25
            is_kleene = not is_absent and draw.random() < (0.4 if self.selects else 0.1)
            self.parts.append((name, is_absent, is_kleene))
        if all(is_absent for _, is_absent, _ in self.parts):
            self.parts[0] = ("a", False, False)
        self.within = draw.choice([2, 6, 12, 30])

    @property
    def selects(self) -> bool:
        return self.strategy != "skip_till_any_match"

    @property
    def is_listed(self) -> bool:
        """Whether each set of events may be a match, so that few events have many."""
        return not self.selects and any(is_kleene for _, _, is_kleene in self.parts)

    def template(self) -> str:
        """A template of objects ``?x`` and a value ``?limit``."""
        draw = self.random
        name, _, is_kleene = draw.choice([part for part in self.parts if not part[1]])
        each = f"{name}[i]" if is_kleene else name
        conditions = [draw.choice([f"{each}.id = ?x", f"?x = {each}.id", "[id = ?x]"])]
        conditions.append(f"{self.attribute('n')} {draw.choice(['>', '<=', '!='])} ?limit")
        if draw.random() < 0.5:
            conditions.append(f"{self.attribute('id')} {draw.choice(['=', '!='])} ?x")
        return f"REGISTER TEMPLATE E(?x, ?limit) AS {self.text(*conditions)}"

    def text(self, *conditions_: str) -> str:
        draw = self.random
        conditions = [
            *conditions_,
            *(self.condition() for _ in range(draw.choice([0, 0, 1, 1, 2, 3]))),
        ]
        if self.strategy == "partition_contiguity" or draw.random() < 0.3:
            conditions.append(draw.choice(["[tag]", "[id]", "[n]", "[ok]", "[at]", "[n = 1]"]))
        elif draw.random() < 0.2:
            conditions.append(draw.choice(["[m]", "[ok]", "[m = 0]", "[tag = 'u']", "[ok = true]"]))
        draw.shuffle(conditions)
        where = f" {{ {' and '.join(conditions)} }}" if conditions else ""
        having = f" HAVING {self.having()}" if draw.random() < 0.2 else ""
        return (
            f"PATTERN SEQ({', '.join(map(self.part, self.parts))}) WHERE {self.strategy}{where} "
            f"WITHIN {self.within}ns{having}{self.returned()}{' LIMIT 100000' * self.is_listed}"
        )

    def part(self, part: tuple[str, bool, bool]) -> str:
        name, is_absent, is_kleene = part
        types = self.random.sample(TYPES, self.random.choice([1, 1, 1, 2]))
        text = types[0] if len(types) == 1 else f"ANY({', '.join(types)})"
        return f"{'~' * is_absent}{text}{'+' * is_kleene} {name}{'[]' * is_kleene}"

    # -- conditions ----------------------------------------------------------------------------

    def condition(self) -> str:
        draw = self.random
        field = draw.choice(["tag", "tag", "tag", "id", "id", "n", "m", "at", "ok", "valid"])
        left, right = self.attribute(field), self.attribute(field)
        if field in ("tag", "id", "ok"):
            operator = draw.choice(["=", "=", "!="])
            if draw.random() < 0.4:
                constants = {"tag": "'u'", "id": "o1", "ok": "true"}
                return f"{left} {operator} {constants[field]}"
            return f"{left} {operator} {right}"
        operator = draw.choice(["<", "<=", ">", ">=", "=", "!="])
        match field:
            case "valid":
                duration = draw.choice(["1ns", "3ns", "8ns"])
                return f"{left} - {right} {operator} {duration}"
            case "at":
                return f"{left} {operator} {right} + {draw.choice(['1ns', '3ns'])}"
        if draw.random() < 0.3:
            return f"{left} {operator} {draw.choice(['1', '2', '-1', '50%'])}"
        if draw.random() < 0.3:
            right = f"{draw.choice(['2 * ', '1 + ', '-', '50% * '])}{right}"
        if draw.random() < 0.2:
            left = f"{left} {draw.choice('+-/%')} {self.attribute('m')}"
        return f"{left} {operator} {right}"

    def attribute(self, field: str) -> str:
        draw = self.random
        name, _, is_kleene = draw.choice(self.parts)
        if not is_kleene:
            return f"{name}.{field}"
        if field in ("n", "m") and draw.random() < 0.3:
            function = draw.choice(["avg", "sum", "min", "max"])
            return f"{function}({name}[{draw.choice(['', '..i-1'])}].{field})"
        if field in ("n", "m") and draw.random() < 0.1:
            return f"count({name}[{draw.choice(['', '..i-1'])}])"
        if field == "valid":
            return f"{name}[{draw.choice(['1', f'{name}.LEN'])}].valid"
        return f"{name}[{draw.choice(['i', 'i', 'i-1', '1', f'{name}.LEN'])}].{field}"

    def settled(self, field: str) -> str:
        draw = self.random
        name, _, is_kleene = draw.choice([part for part in self.parts if not part[1]])
        if not is_kleene:
            return f"{name}.{field}"
        if field in ("n", "m") and draw.random() < 0.3:
            return f"{draw.choice(['avg', 'sum', 'min', 'max'])}({name}[].{field})"
        return f"{name}[{draw.choice(['1', f'{name}.LEN'])}].{field}"

    def having(self) -> str:
        field = self.random.choice(["n", "m", "tag"])
        operator = self.random.choice(["=", "!="] if field == "tag" else ["<", ">=", "!="])
        return f"{self.settled(field)} {operator} {self.settled(field)}"

    def returned(self) -> str:
        draw = self.random
        items = [
            f"{self.settled(draw.choice(['n', 'tag', 'id']))} AS r1",
            f"{self.settled('n')} AS r2",
        ]
        for name, _, is_kleene in self.parts:
            if is_kleene:
                items += [f"count({name}[]) AS k_{name}", f"{name}[].m AS l_{name}"]
        return f" RETURN {', '.join(draw.sample(items, len(items)))}" if draw.random() < 0.8 else ""

    # -- events --------------------------------------------------------------------------------

    def events(self, count: int, span: int) -> list[Event]:
        draw = self.random
        count = min(count, 7) if self.is_listed else count
        times = sorted(draw.randrange(span) for _ in range(count))
        return [Event(i, draw.choice(TYPES), time, self.values()) for i, time in enumerate(times)]

    def values(self) -> dict[str, Any]:
        draw = self.random
        found: dict[str, Any] = {
            "tag": draw.choice("uv"),
            "n": draw.choice([0.0, 1.0, 2.0, 3.0]),
            "m": draw.choice([-1.0, 0.0, -0.0, 0.5, 2.0]),
            "at": draw.randrange(6),
            "ok": draw.random() < 0.5,
        }
        found = {k: None if draw.random() < MISSING else v for k, v in found.items()}
        return {**found, "id": f"<{DYKNOW}{draw.choice(['o1', 'o2'])}>"}


class TrendDrawing(PatternDrawing):
    """A pattern whose results are aggregates over all matches: its conditions are on neighbours."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        draw = self.random
        self.strategy = STRATEGIES[0]
        self.parts = [(name, False, draw.random() < 0.5) for name, _, _ in self.parts[:3]]

    def text(self) -> str:
        draw = self.random
        conditions = [self.condition() for _ in range(draw.choice([0, 1, 1, 2]))]
        if draw.random() < 0.5:
            conditions.append(draw.choice(["[tag]", "[id]", "[m]", "[tag = 'u']", "[n = 1]"]))
        where = f" WHERE {' and '.join(conditions)}" if conditions else ""
        last = f"{self.last(self.parts[-1])}.tag AS t"
        items = ["COUNT(*) AS c", last, *(self.aggregate(i) for i in range(draw.choice([0, 1, 2])))]
        return (
            f"PATTERN SEQ({', '.join(map(self.part, self.parts))}){where} WITHIN {self.within}ns "
            f"RETURN {', '.join(items)}"
        )

    def aggregate(self, number: int) -> str:
        draw = self.random
        name = draw.choice(self.parts)[0]
        function = draw.choice(["sum", "min", "max", "avg"])
        return draw.choice([f"{function}({name}.m) AS r{number}", f"count({name}) AS r{number}"])

    def last(self, part: tuple[str, bool, bool]) -> str:
        return f"{part[0]}[{part[0]}.LEN]" if part[2] else part[0]

    def condition(self) -> str:
        draw = self.random
        place = draw.randrange(len(self.parts))
        name, _, is_kleene = self.parts[place]
        operator, field = draw.choice(["<", "<=", ">", "!="]), draw.choice(["n", "m"])
        each = f"{name}[i]" if is_kleene else name
        if is_kleene and draw.random() < 0.6:
            return f"{each}.{field} {operator} {name}[i-1].{field} + {draw.choice(['0', '1'])}"
        if place and draw.random() < 0.6:
            before, first = self.last(self.parts[place - 1]), f"{name}[1]" if is_kleene else name
            if draw.random() < 0.3:
                return f"{first}.valid - {before}.valid {operator} {draw.choice(['2ns', '5ns'])}"
            return f"{before}.{field} {operator} {first}.{field}"
        return f"{each}.{field} {operator} 1"


class EqualityDrawing(PatternDrawing):
    """A pattern that selects the next event by equalities between its parts."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        draw = self.random
        self.strategy = STRATEGIES[1]
        self.parts = [(name, False, draw.random() < 0.3) for name in "abcd"[: draw.choice([3, 4])]]
        self.within = 30

    def part(self, part: tuple[str, bool, bool]) -> str:
        name, _, is_kleene = part
        types = self.random.choice(["A", "ANY(A, B)", "ANY(A, B, C)"])
        return f"{types}{'+' * is_kleene} {name}{'[]' * is_kleene}"

    def condition(self) -> str:
        draw = self.random
        field = draw.choice(["tag", "id"])
        sides = draw.sample(self.parts, 2)
        left, right = (f"{name}[i]" if is_kleene else name for name, _, is_kleene in sides)
        return f"{left}.{field} = {right}.{field}"


def rows_of(query: PatternQuery, keys: Keys, events: list[Event], draw: Random) -> Rows:
    """The rows of a query's sources, as an engine makes them of samples."""
    sources = {source.kind: source for source in query.sources}
    mine = [
        event
        for event in events
        if event.type in sources
        and sources[event.type].arguments[0].object in (None, event.values["id"][1:-1])
    ]
    columns: dict[str, list[Any]] = {each.name: [] for plan in query.plans for each in plan.columns}
    for event in mine:
        filled = {each.column: each for each in sources[event.type].columns}
        for name, values in columns.items():
            source = filled.get(name)
            if source is None:
                values.append(None)
            elif source.part is Part.OBJECT:
                values.append(keys.number(event.values["id"]))
            elif source.as_key:
                value = event.values[source.field]
                is_number = source.kind is Kind.NUMBER
                found = _column([value], is_number)
                values.append(int(value_keys(found)[0]))
            else:
                value = event.values[source.field]
                is_text = source.kind is Kind.TEXT and value is not None
                values.append(keys.number(text_key(value)) if is_text else value)
    types = {each.name: each.type for plan in query.plans for each in plan.columns}
    ends = np.array([event.time for event in mine], np.int64)
    kinds = tuple(sources)
    return Rows(
        kinds,
        np.array([kinds.index(event.type) for event in mine], np.int64),
        ends - np.array([draw.choice([0, 0, 3]) for _ in mine], np.int64),
        ends,
        {name: _column(values, types[name] == "number") for name, values in columns.items()},
    )


def _column(values: list[Any], is_number: bool) -> Any:
    if is_number:
        return np.array([np.nan if v is None else v for v in values], np.float64)
    return np.array([NO_VALUE if v is None else int(v) for v in values], np.int64)
