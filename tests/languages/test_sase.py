"""SASE+ texts: printing and parsing, published queries, hostile texts."""

from __future__ import annotations

import pytest
from ending_soon import ends_within
from sase_papers import PRINTED

from dyknow.languages.errors import LanguageError
from dyknow.languages.sase import (
    format_sase,
    is_sase,
    parse_sase,
)
from dyknow.languages.sase.ast import Attribute, Index, Strategy


@pytest.mark.parametrize("text", [each.text for each in PRINTED.values()], ids=PRINTED)
def test_published_queries(text: str) -> None:
    assert is_sase(text)
    pattern = parse_sase(text)
    assert parse_sase(format_sase(pattern)) == pattern


def test_the_parts_of_a_text() -> None:
    pattern = parse_sase("""
        PREFIX shop: <http://shop.example/>  # of the shop
        register stream restocked as from shop:gate
        pattern seq(shop:Shelf a, not Checkout b, Exit+ c[])
        where skip-till-next-match [tag], c[i].x >= c[i-1].x
        within "PT12H"^^xsd:duration return a.tag as t, c[c.len].x limit 10""")
    assert pattern.name == "restocked"
    assert pattern.stream is not None
    assert pattern.stream.text == "<http://shop.example/gate>"
    assert [part.types[0].text for part in pattern.parts] == [
        "<http://shop.example/Shelf>",
        "Checkout",
        "Exit",
    ]
    assert [part.is_negated for part in pattern.parts] == [False, True, False]
    assert pattern.strategy is Strategy.NEXT_MATCH
    assert len(pattern.where) == 2
    assert pattern.within == 12 * 3600 * 10**9
    assert [item.name for item in pattern.items] == ["t", None]
    last = pattern.items[1].term
    assert isinstance(last, Attribute)
    assert last.index is Index.LAST
    assert pattern.limit == 10


SAME = [
    ("PATTERN A a WITHIN 5s", "PATTERN SEQ(A a) WITHIN 5000ms"),
    ("PATTERN SEQ(A a, (~B b), C c)", "PATTERN SEQ(A a, ~(B b), C c)"),
    ("PATTERN A+ a[]", "PATTERN A+ a"),
    (
        "PATTERN A a WHERE a.x > 5 and a.y == 'u', a.z ≠ 1",
        'PATTERN A a WHERE {a.x > 5 ∧ (a.y = "u" and (a.z != 1))}',
    ),
    ("PATTERN A a WHERE a.x > 80%", "PATTERN A a WHERE a.x > 0.8"),
    (
        "PATTERN A a WHERE a.x > 80% and a.y < 5%*a.z",
        "PATTERN A a WHERE a.x > 0.8 and a.y < 0.05 * a.z",
    ),
    ("PATTERN A a WHERE a.x > 80%3", "PATTERN A a WHERE a.x > 80 % 3"),
    ("PATTERN A a WHERE strict_contiguity(a)", "PATTERN A a WHERE strict-contiguity { }"),
    (
        "PATTERN A a WHERE skip_till_next_match (a.x) > 3",
        "PATTERN A a WHERE skip_till_next_match a.x > 3",
    ),
    (
        "PATTERN A a WHERE skip_till_next_match (a) { a.x > 3 }",
        "PATTERN A a WHERE skip_till_next_match a.x > 3",
    ),
    ("PATTERN A a WHERE a.x - 1 - 2 > +3", "PATTERN A a WHERE (a.x - 1) - 2 > 3"),
    ("PATTERN A a WHERE 1.5e3 < a.x", "PATTERN A a WHERE 1500 < a.x"),
]


@pytest.mark.parametrize(("text", "other"), SAME)
def test_texts_that_say_the_same(text: str, other: str) -> None:
    assert parse_sase(text) == parse_sase(other)


IS_SASE = [
    "PATTERN A a",
    "\n # a comment PATTERN\n// another\n  Pattern SEQ(A a)",
    "PREFIX x: <http://x#> prefix : <http://y> PATTERN x:A a",
    "REGISTER STREAM s AS PATTERN A a",
    "register query s as // body\n from x pattern A a",
    "REGISTER TEMPLATE e(?x in Car, ?limit) AS PATTERN A a",
    "FROM <http://x> PATTERN A a",
]
IS_NOT = [
    "",
    "SELECT * WHERE { ?pattern ?p ?o }",
    "REGISTER STREAM pattern AS SELECT * WHERE { ?x ?p ?o }",
    "REGISTER TEMPLATE pattern(?x) AS always [0s, 1s] speed(?x) > 3",
    "monitor pattern = always p",
    "chronicle pattern(?x) { }",
    "patterns A a",
    "pattern:a",
    "FROM PATTERN",
    "# PATTERN A a",
]


def test_is_sase() -> None:
    assert [text for text in IS_SASE if not is_sase(text)] == []
    assert [text for text in IS_NOT if is_sase(text)] == []


_LONG = 40_000
HOSTILE = [
    "PATTERN " + "(" * _LONG,
    "PATTERN " + "(" * 15_000 + "A a" + ")" * 15_001,
    "PATTERN " + "~" * _LONG + "A a",
    "PATTERN A a WHERE " + "(" * _LONG,
    "PATTERN A a WHERE " + "(" * 15_000 + "a.x > 1" + ")" * 15_000,
    "PATTERN A a WHERE " + "- " * 15_000 + "a.x > 1",
    "PATTERN A a WHERE " + "a.x + " * 7_000 + "1 > 1",
    "PATTERN A a WHERE a.x > " + "9" * _LONG,
    "PATTERN A a WHERE a.x > " + "9" * _LONG + "%",
    "PATTERN A a WHERE a.x > 1 WITHIN " + "9" * _LONG + "s",
    "PATTERN A a WHERE a.x > '" + "x" * _LONG,
    "PATTERN A a WHERE " + "a" * _LONG + ".x > 1",
    "PATTERN A a LIMIT " + "9" * _LONG,
    "#" * _LONG,
    " " * _LONG,
    "#\n" * (_LONG // 2),
    "PREFIX a: <b>" * (_LONG // 13),
    "REGISTER TEMPLATE " + "x" * _LONG,
    "PATTERN A a WHERE [" * (_LONG // 19),
    "PATTERN SEQ" + " " * _LONG,
]


@pytest.mark.parametrize("text", HOSTILE, ids=range(len(HOSTILE)))
def test_hostile_texts(text: str) -> None:
    """An error, soon; a stack overflow would end the process."""
    with ends_within(20):
        is_sase(text)
    with ends_within(400), pytest.raises(LanguageError):
        parse_sase(text)
