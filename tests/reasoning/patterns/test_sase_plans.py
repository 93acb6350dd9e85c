"""SASE+ texts over the events whose matches are known from Esper and from SASE's engine."""

from __future__ import annotations

from dataclasses import replace

import pytest
from ending_soon import ends_within
from pattern_data import ANY_MATCHES as ANY
from pattern_data import KINDS, NEXT_MATCHES, WITHOUT_D, data
from vocabularies import vocabulary_of

from dyknow.languages.mtl.checked import Kind
from dyknow.languages.sase import check_sase, parse_sase
from dyknow.ontology.vocabulary import Vocabulary
from dyknow.rdf.namespaces import DYKNOW
from dyknow.reasoning.patterns.compilation.sase_plans import sase_query
from dyknow.reasoning.patterns.compilation.sase_sources import sase_sources
from dyknow.reasoning.patterns.plans.query import Argument, Keys, Part, with_numbers
from dyknow.reasoning.patterns.recognition.choice import evaluator_of

ONTOLOGY = "".join(f"dyknow:{kind} a owl:Class .\n" for kind in KINDS)
NEXT = "skip_till_next_match"


def vocabulary(more: str = "") -> Vocabulary:
    return vocabulary_of(ONTOLOGY + more)


@pytest.mark.parametrize(
    ("sequence", "strategy", "keys", "count"),
    [
        ("A a, B b, C c", "", 100, ANY[100]),
        ("A a, B b, C c", "", 10_000, ANY[10_000]),
        ("A a, B b, C c", NEXT, 10, NEXT_MATCHES[10]),
        ("A a, B b, C c", NEXT, 100, NEXT_MATCHES[100]),
        ("A a, B b, C c", NEXT, 10_000, NEXT_MATCHES[10_000]),
        ("A a, ~D d, C c", "", 100, WITHOUT_D),
    ],
)
def test_known_counts(sequence: str, strategy: str, keys: int, count: int) -> None:
    text = f"PATTERN SEQ({sequence}) WHERE {strategy} [id] WITHIN 1000 seconds"
    query = sase_query(check_sase(parse_sase(text), text, vocabulary()), {})
    plan = with_numbers(query.plans[0], Keys())
    rows = data(100_000, keys)
    rows = replace(rows, columns={"id": rows.columns["x"]})
    running = evaluator_of(plan)
    assert len(running.push(rows)) + len(running.end()) == count


GREATEST = [
    [f"a{i % 16}.x{i} = a{(i + 7) % 16}.x{i}" for i in range(256)],
    ["a0.x" + " + a0.x" * 63 + " > a1.y"] * 256,
    [f"a{i % 15}.id99 = a{i % 15 + 1}.id98" for i in range(256)],
]


@pytest.mark.parametrize("conditions", GREATEST)
@pytest.mark.parametrize("strategy", ["", NEXT])
def test_the_greatest_patterns_compile_soon(conditions: list[str], strategy: str) -> None:
    parts = ", ".join(f"ANY(f{i}, A, B, C) a{i}" for i in range(16))
    text = f"PATTERN SEQ({parts}) WHERE {strategy} {{ {' and '.join(conditions)} }} WITHIN 5s"
    features = "".join(f"dyknow:f{i} a dyknow-o:Feature .\n" for i in range(16))
    text = text.replace("A, B, C", "f0, f1, f2") if "id99" in text else text
    kinds = {
        (kind, field): Kind.NUMBER
        for kind in (*KINDS, *(f"f{i}" for i in range(16)))
        for field in ("x", "y", *(f"x{i}" for i in range(256)))
    }
    with ends_within(3_000):
        checked = check_sase(parse_sase(text), text, vocabulary(features))
        sase_query(checked, kinds)


def test_what_is_read_is_known_before_streams_are() -> None:
    """Sources name each field; its kind comes with the streams."""
    text = (
        "PATTERN SEQ(A a, B b, A c) WHERE a.price > 3 and a.id = b.id and c.gate != 'x' WITHIN 5s"
    )
    checked = check_sase(parse_sase(text), text, vocabulary())
    first, second = sase_sources(checked)
    assert (first.kind, first.concept) == ("A", DYKNOW + "A")
    assert first.arguments == (Argument(DYKNOW + "A"),)
    assert [(c.field, c.part, c.kind) for c in first.columns] == [
        ("", Part.OBJECT, Kind.OBJECT),
        ("price", Part.FIELD, None),
        ("gate", Part.FIELD, None),
    ]
    assert [column.part for column in second.columns] == [Part.OBJECT]
    kinds = {("A", "price"): Kind.NUMBER, ("A", "gate"): Kind.TEXT}
    query = sase_query(checked, kinds)
    assert [replace(c, kind=None) for s in query.sources for c in s.columns if c.field] == [
        c for c in first.columns if c.field
    ]
