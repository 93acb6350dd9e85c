"""Random chronicles that have a meaning, and samples for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from random import Random

import numpy as np
from chronicle_definition import Match, Sample, Value
from vocabularies import vocabulary_of

from dyknow.languages.mtl.checked import Kind
from dyknow.ontology.vocabulary import THING, Vocabulary
from dyknow.rdf.namespaces import DYKNOW
from dyknow.reasoning.patterns.evaluation.all_rows import AllRows
from dyknow.reasoning.patterns.plans.query import (
    Argument,
    Keys,
    Part,
    PatternQuery,
    Source,
    SourceColumn,
    object_key,
    text_key,
    with_numbers,
)
from dyknow.reasoning.patterns.plans.rows import Matches, Rows
from dyknow.reasoning.patterns.recognition.changes import Changes

ONTOLOGY = """
dyknow:Thing a owl:Class .
dyknow:Car a owl:Class ; rdfs:subClassOf dyknow:Thing .
dyknow:Taxi a owl:Class ; rdfs:subClassOf dyknow:Car , dyknow:Thing .
dyknow:stopped a dyknow-o:Feature ; dyknow-o:hasArity 1 ; rdfs:range xsd:boolean .
dyknow:speed a dyknow-o:Feature ; dyknow-o:hasArity 1 ; dyknow-o:hasUnit "m.s-1" .
dyknow:near a dyknow-o:Feature ; dyknow-o:hasArity 2 ; rdfs:range xsd:boolean .
dyknow:owner a dyknow-o:Feature ; dyknow-o:hasArity 1 ; rdfs:range dyknow:Thing .
dyknow:label a dyknow-o:Feature ; dyknow-o:hasArity 1 ; rdfs:range xsd:string .
dyknow:Seen a dyknow-o:Event .
"""
OBJECTS = ("a", "b", "c")
CAR, TAXI = DYKNOW + "Car", DYKNOW + "Taxi"
SORTS = {CAR: {DYKNOW + "a", DYKNOW + "b"}, TAXI: {DYKNOW + "a"}}
ARITIES = {"stopped": 1, "speed": 1, "near": 2, "owner": 1, "label": 1, "Seen": 2}
KINDS = {
    "stopped": Kind.TRUTH,
    "speed": Kind.NUMBER,
    "near": Kind.TRUTH,
    "owner": Kind.OBJECT,
    "label": Kind.TEXT,
}
CONSTANTS = {
    Kind.TRUTH: ("true", "false"),
    Kind.NUMBER: ("1", "3.6 [km.h-1]", "2"),
    Kind.OBJECT: ("a", "dyknow:b"),
    Kind.TEXT: ('"red"', '"blue"'),
}
VALUES: Mapping[str, Sequence[Value]] = {
    "stopped": (True, False),
    "speed": (0.5, 1.0, 2.0, 3.0),
    "near": (True, False),
    "owner": tuple(DYKNOW + each for each in OBJECTS),
    "label": ("red", "blue"),
    "Seen": (1.0,),
}


def vocabulary() -> Vocabulary:
    return vocabulary_of(ONTOLOGY)


class ChronicleWorld:
    """The text of a chronicle, and samples, from one seed."""

    def __init__(self, seed: int) -> None:
        self.random = draw = Random(seed)
        self.concepts = draw.sample(list(ARITIES), draw.randint(1, 3))
        self.objects: list[str] = []
        """The variables that events bind to objects."""
        self.values: dict[str, Kind] = {}
        """The variables that events bind to values."""
        events = []
        self.points: list[str] = []
        for i in range(draw.choice([1, 2, 2, 3])):
            point = draw.choice([f"t{i}", f"t{i}", f"t{i}", "t0"])
            self.points.append(point)
            events.append(f"event({self.message(binds=True)}, {point})")
        clauses = [*events, *self.bounds()]
        clauses += [self.probe() for _ in range(draw.choice([0, 0, 1, 1, 2]))]
        clauses += [each for _ in range(2) if draw.random() < 0.2 and (each := self.comparison())]
        names = dict.fromkeys(self.objects)
        if names and draw.random() < 0.3:
            clauses.append(f"?{draw.choice(list(names))} in {draw.choice(['Car', 'Taxi'])}")
        draw.shuffle(clauses)
        known = [*names, *self.values]
        head = draw.sample(known, draw.randint(0, len(known)))
        self.text = self.written(head, clauses)

    def written(self, head: list[str], clauses: list[str]) -> str:
        slots = f"({', '.join(f'?{name}' for name in head)})" if head else ""
        emitted = ""
        if self.random.random() < 0.5:
            names = f"[{', '.join(f'?{name}' for name in head)}]" if head else ""
            point = self.random.choice(self.points)
            emitted = f" when recognized {{ emit event(N{names}, {point}) }}"
        return f"chronicle N{slots} {{ {'; '.join(clauses)};{emitted} }}"

    def message(self, *, binds: bool = False, is_state: bool = False) -> str:
        """A message; ``binds``: of an event, which may bind new variables."""
        draw = self.random
        concept = draw.choice(self.concepts)
        if is_state:
            concept = draw.choice([each for each in self.concepts if each in KINDS] or ["stopped"])
        arguments = [self.argument(binds=binds, is_state=is_state) for _ in range(ARITIES[concept])]
        shown = f"{concept}[{', '.join(arguments)}]"
        kind = KINDS.get(concept)
        if is_state:
            assert kind is not None
            return f"{shown}:{self.test(kind, binds=False)}"
        if kind is None or draw.random() < 0.3:
            return shown
        before = "?" if draw.random() < 0.4 else self.test(kind, binds=binds)
        return f"{shown}:({before}, {self.test(kind, binds=binds)})"

    def argument(self, *, binds: bool, is_state: bool) -> str:
        draw = self.random
        if binds and draw.random() < 0.8:
            self.objects.append(draw.choice("xyz"))
            return f"?{self.objects[-1]}"
        known = [f"?{each}" for each in self.objects]
        return draw.choice([*known, *known, "a", '"b"', *([] if is_state else ["?"])])

    def test(self, kind: Kind, *, binds: bool) -> str:
        draw = self.random
        if draw.random() < 0.2:
            return "?"
        variables = [each for each, of in self.values.items() if of is kind]
        if kind is Kind.OBJECT:
            variables += self.objects
        if binds and draw.random() < 0.15:
            name = f"{kind[:2]}{draw.randint(1, 2)}"
            self.values[name] = kind
            return f"?{name}"
        operators = ["", "", "!= "]
        if kind is Kind.NUMBER:
            operators += ["< ", "<= ", "> ", ">= ", "= "]
        operand = draw.choice([*CONSTANTS[kind], *(f"?{each}" for each in variables)])
        return draw.choice(operators) + operand

    def bounds(self) -> list[str]:
        """Times that bound each point from the first one, and more."""
        draw = self.random
        first, *others = dict.fromkeys(self.points)
        found = []
        for other in others:
            low = draw.choice([-5, -2, 0, 1])
            found.append(f"{other} - {first} in [{_ns(low)}, {_ns(low + draw.randint(0, 6))}]")
        if others and draw.random() < 0.5:
            left, right = draw.sample([first, *others], 2)
            sign = draw.choice(["<", "<=", ">", ">=", "="])
            found.append(f"{left} {sign} {right} {draw.choice(['', '+ 1ns', '- 2ns'])}")
        return found

    def probe(self) -> str:
        draw = self.random
        times = ", ".join(self.moment() for _ in range(2))
        match draw.randrange(3):
            case 0:
                return f"noevent({self.message()}, ({times}))"
            case 1:
                least = draw.choice([0, 1, 2])
                most = draw.choice(["oo", str(least + draw.randint(0, 1))])
                return f"occurs(({least}, {most}), {self.message()}, ({times}))"
            case _:
                return f"hold({self.message(is_state=True)}, ({times}))"

    def moment(self) -> str:
        return f"{self.random.choice(self.points)} {self.random.choice(['', '', '- 3ns', '+ 2ns'])}"

    def comparison(self) -> str:
        draw = self.random
        numbers = [each for each, of in self.values.items() if of is Kind.NUMBER]
        if numbers and draw.random() < 0.5:
            right = draw.choice([*(f"?{each}" for each in numbers), "1", "7.2 [km.h-1]"])
            return f"?{draw.choice(numbers)} {draw.choice(['<', '>=', '!='])} {right}"
        if not self.objects:
            return ""
        right = draw.choice([*(f"?{each}" for each in self.objects), "a"])
        return f"?{draw.choice(self.objects)} {draw.choice(['!=', '!=', '='])} {right}"

    def samples(self, count: int, *, late: float = 0.05) -> list[Sample]:
        """Samples in order of arrival, with ties; some are late."""
        draw = self.random
        time, found = 0, []
        for number in range(count):
            time += draw.choice([0, 0, 1, 1, 2])
            concept = draw.choice(self.concepts)
            objects = tuple(DYKNOW + draw.choice(OBJECTS) for _ in range(ARITIES[concept]))
            value = draw.choice(VALUES[concept])
            at = time - 2 if draw.random() < late else time
            found.append(Sample(number, DYKNOW + concept, objects, value, at))
        return found


def _ns(time: int) -> str:
    return f"{time}ns" if time else "0"


class Evaluation:
    """A query over samples: what an engine does with it."""

    def __init__(self, query: PatternQuery, sorts: Mapping[str, set[str]] = SORTS) -> None:
        self._query = query
        self._sorts = sorts
        self._keys = Keys()
        self._changes = Changes(query.sources, capacity=8)
        self._plan = with_numbers(query.plans[0], self._keys)
        self._evaluator = AllRows(self._plan, capacity=8)
        self._numbers: list[int] = []
        """The sample of each row that the evaluator has taken."""

    def late(self, samples: Sequence[Sample]) -> set[int]:
        """The numbers of the samples that are behind one that arrived before, of those read."""
        read = [s for s in samples if any(self._suits(s, each) for each in self._query.sources)]
        return {
            s.number for i, s in enumerate(read) if any(each.time > s.time for each in read[:i])
        }

    def push(self, samples: Sequence[Sample]) -> list[Match]:
        own = [(s, each) for s in samples for each in self._query.sources if self._suits(s, each)]
        rows = self._changes.push(self._rows(own))
        self._numbers += rows.columns["arrival"].tolist()
        return self._matches(self._evaluator.push(rows))

    def end(self) -> list[Match]:
        return self._matches(self._evaluator.end())

    def checkpoint(self) -> None:
        """Continue from a checkpoint."""
        states = self._changes.state(), self._evaluator.state()
        self._changes = Changes(self._query.sources, capacity=8)
        self._evaluator = AllRows(self._plan, capacity=8)
        self._changes.restore(states[0])
        self._evaluator.restore(states[1])

    def _suits(self, sample: Sample, source: Source) -> bool:
        return sample.concept == source.concept and all(
            self._is_of(iri, argument)
            for iri, argument in zip(sample.objects, source.arguments, strict=True)
        )

    def _is_of(self, iri: str, argument: Argument) -> bool:
        if argument.object is not None:
            return iri == argument.object
        return argument.sort == THING or iri in self._sorts[argument.sort or ""]

    def _rows(self, own: Sequence[tuple[Sample, Source]]) -> Rows:
        kinds = tuple(each.kind for each in self._query.sources)
        columns = {}
        for column in self._plan.columns:
            values = [self._value(column.name, sample, source) for sample, source in own]
            if column.type == "number":
                columns[column.name] = np.array(values, np.float64)
            else:
                columns[column.name] = np.array([0 if v != v else v for v in values], np.int64)
        columns["arrival"] = np.array([sample.number for sample, _ in own], np.int64)
        kind = np.array([kinds.index(source.kind) for _, source in own], np.int64)
        ends = np.array([sample.time for sample, _ in own], np.int64)
        return Rows(kinds, kind, ends, ends, columns)

    def _value(self, name: str, sample: Sample, source: Source) -> float:
        """The value in a column; NaN where the source does not fill it."""
        column = next((each for each in source.columns if each.column == name), None)
        if column is None or column.part is Part.BEFORE:
            return float("nan")
        if column.part is Part.OBJECT:
            return self._keys.number(object_key(sample.objects[column.argument]))
        return self._number(sample.value, column)

    def _number(self, value: Value, column: SourceColumn) -> float:
        match column.kind:
            case Kind.OBJECT:
                return self._keys.number(object_key(str(value)))
            case Kind.TEXT:
                return self._keys.number(text_key(str(value)))
            case Kind.TRUTH:
                return int(value)
            case _:
                return float(value)

    def _matches(self, found: Matches) -> list[Match]:
        outputs = found.outputs
        heads = [
            [self._read(value, each.kind) for value in outputs[each.name].tolist()]
            for each in self._query.results
        ]
        return [
            Match(
                tuple(self._numbers[row] for row in rows),
                int(outputs["start"][i]),
                int(outputs["end"][i]),
                int(outputs[self._query.valid][i]),
                tuple(column[i] for column in heads),
            )
            for i, rows in enumerate(found.rows.tolist())
        ]

    def _read(self, value: float, kind: Kind) -> Value:
        match kind:
            case Kind.OBJECT:
                return self._keys.key(int(value))[1:-1]
            case Kind.TEXT:
                return self._keys.key(int(value))[1:]
            case Kind.TRUTH:
                return bool(value)
            case _:
                return float(value)
