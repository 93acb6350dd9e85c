"""Random EP-SPARQL queries over a small vocabulary, and random samples for them."""

from __future__ import annotations

from functools import cache
from random import Random

import numpy as np
from epsparql_definition import Fact, Sample, Value
from pyoxigraph import Literal, NamedNode, Quad, Store
from vocabularies import vocabulary_of

from dyknow.continuous.operators.background import Background
from dyknow.languages.mtl.checked import Kind
from dyknow.ontology.vocabulary import Vocabulary
from dyknow.rdf.namespaces import DYKNOW
from dyknow.reasoning.patterns.plans.plan import NO_VALUE, ColumnType
from dyknow.reasoning.patterns.plans.query import (
    Keys,
    Part,
    PatternQuery,
    Source,
    column_type,
    object_key,
    text_key,
)
from dyknow.reasoning.patterns.plans.rows import Rows

ONTOLOGY = """
dyknow:Thing a owl:Class .
dyknow:Company a owl:Class ; rdfs:subClassOf dyknow:Thing .
dyknow:Bank a owl:Class ; rdfs:subClassOf dyknow:Company .
dyknow:price a dyknow-o:Feature ; rdfs:range xsd:double .
dyknow:volume a dyknow-o:Feature ; rdfs:range xsd:integer .
dyknow:owns a dyknow-o:Feature ; rdfs:range dyknow:Company .
dyknow:open a dyknow-o:Feature ; rdfs:range xsd:boolean .
dyknow:rating a dyknow-o:Feature ; rdfs:range xsd:string .
dyknow:founded a dyknow-o:Feature ; rdfs:range xsd:dateTime .
dyknow:level a dyknow-o:Feature .
dyknow:distance a dyknow-o:Feature ; dyknow-o:hasArity 2 ; rdfs:range xsd:double .
dyknow:Crash a dyknow-o:Event .
"""
NUMBERS, OBJECTS, TRUTHS, TEXTS, TIMES = "number", "object", "truth", "text", "time"
FEATURES = {
    "price": NUMBERS,
    "volume": NUMBERS,
    "owns": OBJECTS,
    "open": TRUTHS,
    "rating": TEXTS,
    "founded": TIMES,
    "Crash": NUMBERS,
}
VARIABLES = {
    NUMBERS: ("?v", "?w"),
    OBJECTS: ("?a", "?b"),
    TRUTHS: ("?t",),
    TEXTS: ("?n",),
    TIMES: ("?f",),
}
CONSTANTS = {
    NUMBERS: ("1", "2.0", "0"),
    OBJECTS: ("dyknow:o0", "dyknow:o1"),
    TRUTHS: ("true", "false"),
    TEXTS: ('"x"', '"y"'),
    TIMES: ('"1970-01-01T00:00:00.000000002Z"^^xsd:dateTime',),
}
DRAWN: dict[str, tuple[Value, ...]] = {
    NUMBERS: tuple((NUMBERS, each) for each in (0.0, 1.0, 2.0)),
    OBJECTS: tuple((OBJECTS, f"{DYKNOW}o{i}") for i in range(3)),
    TRUTHS: ((TRUTHS, True), (TRUTHS, False)),
    TEXTS: ((TEXTS, "x"), (TEXTS, "y")),
    TIMES: tuple((TIMES, each) for each in range(1, 4)),
}
STATIC: tuple[Fact, ...] = (
    ((OBJECTS, f"{DYKNOW}o0"), "urn:in", (OBJECTS, "urn:x"), None),
    ((OBJECTS, f"{DYKNOW}o0"), "urn:in", (OBJECTS, "urn:y"), None),
    ((OBJECTS, f"{DYKNOW}o1"), "urn:in", (OBJECTS, "urn:y"), None),
    ((OBJECTS, f"{DYKNOW}o0"), "urn:in", (OBJECTS, f"{DYKNOW}o1"), "urn:g"),
    ((OBJECTS, "urn:p"), "urn:of", (TEXTS, "x"), None),
    ((OBJECTS, "urn:q"), "urn:of", (TEXTS, "y"), None),
    ((OBJECTS, f"{DYKNOW}o0"), "urn:level", (NUMBERS, 1.0), None),
    ((OBJECTS, f"{DYKNOW}o0"), "urn:limit", (NUMBERS, 1.5), None),
    ((OBJECTS, f"{DYKNOW}o0"), "urn:limit", (NUMBERS, 0.0), None),
    ((OBJECTS, f"{DYKNOW}o1"), "urn:limit", (NUMBERS, 2.0), None),
    ((OBJECTS, f"{DYKNOW}o1"), "urn:limit", (TEXTS, "x"), None),
    ((OBJECTS, f"{DYKNOW}o2"), "urn:limit", (TEXTS, "y"), None),
)
STATIC_NAMES = ("?k", "?m", "?q")
"""The variables that only static triples have."""
OPERATORS = ("SEQ", "SEQ", "SEQ", "EQUALS", "OPTIONALSEQ", "EQUALSOPTIONAL", "UNION")


def vocabulary() -> Vocabulary:
    return vocabulary_of(ONTOLOGY)


class QueryDrawing:
    """The text of a query, and samples for it. ``operators`` are those between groups."""

    def __init__(
        self, seed: int, operators: tuple[str, ...] = OPERATORS, *, has_static: bool = False
    ) -> None:
        self.random = draw = Random(seed)
        self.operators = operators
        self.features = draw.sample(sorted(FEATURES), draw.choice([1, 2, 2, 3]))
        self.left = draw.choice([2, 3, 3, 4])
        chain, names = self.chain(2, least=2)
        filters = " ".join(self.filter(names) for _ in range(draw.choice([0, 0, 1, 2])))
        within = f"WITHIN {draw.choice([3, 8, 20, 20, 40])}ns"
        if draw.random() < 0.2:
            sign, most = draw.choice(["<", "<="]), draw.choice([5, 20])
            within = f'FILTER (getDURATION() {sign} "PT{most / 1e9:.9f}S"^^xsd:duration)'
        self.names = names
        items = " ".join(sorted({*names, *VARIABLES[NUMBERS][:1]} & names))
        times = "(getSTARTTIME() AS ?from) (getDURATION() AS ?lasts)"
        if has_static:
            static = self.static_triple()
            chain = f"{{ {chain} {static} }}"
            told = [name for name in STATIC_NAMES if name in static and draw.random() < 0.7]
            items = " ".join([items, *told])
            if draw.random() < 0.7:
                filters += self.static_filter(names, static)
            if "?q" in static and draw.random() < 0.5:
                number = draw.choice([*(name for name in VARIABLES[NUMBERS] if name in names), "2"])
                items += draw.choice([f" ({number} - ?q AS ?over)", f" ({number} / ?q AS ?over)"])
        self.text = f"SELECT {items} {times} WHERE {chain} {filters} {within}"

    # -- the text ------------------------------------------------------------------------------

    def chain(self, depth: int, least: int = 1) -> tuple[str, set[str]]:
        draw = self.random
        text, names = self.group(depth)
        count = draw.choice([least, 2, 2, 3])
        for _ in range(count - 1):
            if self.left <= 0:
                break
            other, more = self.group(depth)
            text, names = f"{text} {draw.choice(self.operators)} {other}", names | more
        return text, names

    def static_triple(self) -> str:
        """A static triple; beside others, not in a side of an optional operator."""
        return self.random.choice(
            [
                "?a <urn:in> ?k .",
                "?a <urn:in> <urn:x> . ?k <urn:of> ?m .",
                "GRAPH <urn:g> { ?a <urn:in> ?b }",
                "?a <urn:level> ?v .",
                "BIND (1 - 0 AS ?l) ?a <urn:level> ?l .",
                "?a dyknow:owns [ <urn:in> ?k ] .",
                *["?a <urn:limit> ?q ."] * 3,
            ]
        )

    def static_filter(self, names: set[str], static: str) -> str:
        """A condition on the values of a static triple."""
        draw = self.random
        if "?q" not in static:
            return ' FILTER (?m = "x")' if "?m" in static else ""
        sign = draw.choice(["<", "<=", ">", ">=", "=", "!="])
        if draw.random() < 0.15:
            return draw.choice([' FILTER (?q = "x")', f" FILTER (getDURATION() {sign} ?q)"])
        number = draw.choice([*(name for name in VARIABLES[NUMBERS] if name in names), "1"])
        left = draw.choice([number, f"{number} - ?q", f"{number} * 2 + ?q", f"1 / (?q - {number})"])
        right = "?q" if left == number else draw.choice(["0", "1", number])
        late = 'getSTARTTIME() > "1970-01-01T00:00:00.00000001Z"^^xsd:dateTime'
        more = draw.choice(["", "", f" || {number} > 1", f" && {number} < 2", f" || {late}"])
        return f" FILTER ({left} {sign} {right}{more})"

    def group(self, depth: int) -> tuple[str, set[str]]:
        draw = self.random
        parts: list[str] = []
        names: set[str] = set()
        for _ in range(draw.choice([1, 1, 1, 2])):
            if parts and self.left <= 0:
                break
            if depth and self.left > 1 and draw.random() < 0.25:
                text, more = self.chain(depth - 1)
            else:
                text, more = self.triple()
            parts.append(text)
            names |= more
        if draw.random() < 0.08 and "?z" not in names and (numbers := self.known(NUMBERS, names)):
            parts.append(f"BIND ({draw.choice(numbers)} + 1 AS ?z)")
            names = {*names, "?z"}
        if draw.random() < 0.25:
            parts.append(self.filter(names))
        return "{ " + " ".join(parts) + " }", names

    def triple(self) -> tuple[str, set[str]]:
        draw = self.random
        self.left -= 1
        feature = draw.choice(self.features)
        subject = draw.choice(("?a", "?a", "?a", "?b", "dyknow:o0"))
        kind = FEATURES[feature]
        drawn = draw.random()
        value = draw.choice(VARIABLES[kind] if drawn < 0.75 else CONSTANTS[kind])
        if drawn > 0.95:
            value = "[]"
        names = {each for each in (subject, value) if each.startswith("?")}
        return f"{subject} dyknow:{feature} {value} .", names

    def filter(self, names: set[str]) -> str:
        return f"FILTER ({self.condition(names, 2)})"

    def condition(self, names: set[str], depth: int) -> str:
        draw = self.random
        drawn = draw.random()
        if depth and drawn < 0.35:
            sides = (self.condition(names, depth - 1) for _ in range(2))
            return "(" + draw.choice([" && ", " || "]).join(sides) + ")"
        if depth and drawn < 0.45:
            return f"!({self.condition(names, depth - 1)})"
        if names and drawn < 0.55:
            return f"BOUND({draw.choice(sorted(names))})"
        if drawn < 0.65:
            sign, most = draw.choice(["<", "<=", ">", ">=", "=", "!="]), draw.choice([0, 3, 8])
            return f'getDURATION() {sign} "PT{most / 1e9:.9f}S"^^xsd:duration'
        kinds = [kind for kind in VARIABLES if self.known(kind, names)]
        kind = draw.choice(kinds or [NUMBERS])
        if kind in (OBJECTS, TEXTS, TRUTHS):
            signs = ["=", "!="]
        else:
            signs = ["=", "!=", "<", "<=", ">", ">="]
        if drawn < 0.7:
            options = ", ".join(CONSTANTS[kind][:2])
            return f"{self.operand(kind, names)} {draw.choice(['IN', 'NOT IN'])} ({options})"
        return f"{self.operand(kind, names)} {draw.choice(signs)} {self.operand(kind, names)}"

    def operand(self, kind: str, names: set[str]) -> str:
        draw = self.random
        if kind == NUMBERS and draw.random() < 0.2:
            sides = [self.operand(kind, names) for _ in range(2)]
            return f"({sides[0]} {draw.choice('+-*/')} {sides[1]})"
        if kind == TIMES and draw.random() < 0.3:
            return draw.choice(["getSTARTTIME()", "getENDTIME()"])
        known = self.known(kind, names)
        return draw.choice(known if known and draw.random() < 0.8 else CONSTANTS[kind])

    def known(self, kind: str, names: set[str]) -> list[str]:
        return [name for name in VARIABLES[kind] if name in names]

    # -- the samples ---------------------------------------------------------------------------

    def samples(self, count: int, span: int) -> list[Sample]:
        """Samples in order of their ends, with ties; events last. Some come late."""
        draw = self.random
        ends = sorted(draw.randrange(span) for _ in range(count))
        if draw.random() < 0.3:
            ends[draw.randrange(count)] -= draw.randint(1, 5)
        found = []
        for number, end in enumerate(ends):
            feature = draw.choice(self.features)
            start = end - (draw.choice([0, 1, 2, 5]) if feature == "Crash" else 0)
            owner = DYKNOW + draw.choice(["o0", "o0", "o1"])
            value = draw.choice(DRAWN[FEATURES[feature]])
            found.append(Sample(number, DYKNOW + feature, owner, value, start, end))
        return found


def rows_of(samples: list[Sample], query: PatternQuery, keys: Keys) -> tuple[Rows, list[int]]:
    """The samples as rows of the sources that they suit, and the number of each row's sample."""
    suited = [
        (sample, place)
        for sample in samples
        for place, source in enumerate(query.sources)
        if suits(sample, source)
    ]
    columns = {}
    for column in query.plans[0].columns:
        values = [cell(sample, query.sources[place], column.name, keys) for sample, place in suited]
        if column.type is ColumnType.NUMBER:
            columns[column.name] = np.array(
                [np.nan if v is None else v for v in values], np.float64
            )
        else:
            filled = [NO_VALUE if v is None else v for v in values]
            columns[column.name] = np.array(filled, np.int64)
    rows = Rows(
        tuple(source.kind for source in query.sources),
        np.array([place for _, place in suited], np.int64),
        np.array([sample.start for sample, _ in suited], np.int64),
        np.array([sample.end for sample, _ in suited], np.int64),
        columns,
    )
    return rows, [sample.number for sample, _ in suited]


def suits(sample: Sample, source: Source) -> bool:
    owner = source.arguments[0].object
    return source.concept == sample.feature and owner in (None, sample.object)


def cell(sample: Sample, source: Source, column: str, keys: Keys) -> int | float | None:
    """What a column of the source has of a sample."""
    for each in source.columns:
        if each.column == column:
            if each.part is Part.OBJECT:
                return keys.number(object_key(sample.object))
            kind, value = sample.value
            assert column_type(Kind(kind)) is column_type(each.kind or Kind.NUMBER)
            if kind == OBJECTS:
                return keys.number(object_key(value))
            return keys.number(text_key(value)) if kind == TEXTS else value
    return None


@cache
def background() -> Background:
    """`STATIC` as the static side of queries."""
    store = Store()
    for subject, predicate, object, graph in STATIC:
        where = NamedNode(graph or "urn:default")
        store.add(Quad(NamedNode(subject[1]), NamedNode(predicate), _term(object), where))
    return Background(store, default=["urn:default"])


def _term(value: Value) -> NamedNode | Literal:
    return NamedNode(value[1]) if value[0] == OBJECTS else Literal(value[1])


def value_of(kind: Kind, number: int | float, keys: Keys) -> Value | None:
    """What a result's field says."""
    if number == NO_VALUE or np.isnan(number):
        return None
    if kind in (Kind.OBJECT, Kind.TEXT):
        key = keys.key(int(number))
        return (OBJECTS, key[1:-1]) if kind is Kind.OBJECT else (TEXTS, key[1:])
    return str(kind), bool(number) if kind is Kind.TRUTH else number
