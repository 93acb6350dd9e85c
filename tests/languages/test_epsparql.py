"""The checks of EP-SPARQL: what is refused, where, and with which hint; kinds and sorts."""

from __future__ import annotations

import pytest
from epsparql_drawing import vocabulary

from dyknow.languages.epsparql import CheckedPattern, check_epsparql, parse_epsparql
from dyknow.languages.epsparql.binding import horizon
from dyknow.languages.epsparql.checked import Part, Sample
from dyknow.languages.errors import LanguageError
from dyknow.languages.mtl.checked import Kind, ObjectSlot, Parameter
from dyknow.rdf.namespaces import DYKNOW

VOCABULARY = vocabulary()


def checked(text: str) -> CheckedPattern:
    return check_epsparql(parse_epsparql(text), VOCABULARY)


def samples_in(part: Part) -> list[Sample]:
    if isinstance(part, Sample):
        return [part]
    inner = [
        *getattr(part, "parts", ()),
        *(getattr(part, name, None) for name in ("left", "right")),
    ]
    return [found for each in inner if each is not None for found in samples_in(each)]


def kinds_of(text: str) -> list[Kind]:
    return [each.kind for each in samples_in(checked(text).where)]


WHERE = "{ ?a dyknow:price ?v } SEQ { ?a dyknow:owns ?b } WITHIN 5s"


@pytest.mark.parametrize(
    ("text", "at", "message", "hint"),
    [
        (
            "ASK { ?a dyknow:prise ?v } WITHIN 5s",
            10,
            "dyknow:prise is neither",
            "did you mean price?",
        ),
        ("ASK { ?a a dyknow:Compny ; dyknow:price 1 }", 10, "not a known sort", "Company"),
        ("ASK { ?a ?p ?v }", 10, "the predicate ?p may be any", "write the feature"),
        ("ASK { ?a dyknow:price/<urn:p> ?v }", 10, "a path has no samples", "a triple for each"),
        ("ASK { ?a a dyknow:Crash }", 10, "no sort", "?o dyknow:Crash ?value"),
        ("ASK { ?a dyknow:distance ?d }", 10, "is of 2 objects", "rdf:_2 ?b2"),
        ("ASK { ?a <urn:p> ?v }", 5, "reads no feature", "dyknow:price"),
        ("ASK { ?a dyknow:price ?v . ?b a dyknow:Bank }", 31, "?b is in no sample", "leave"),
        ("ASK { ?a dyknow:price 'x' }", 10, "of kind number", "no sample has such a value"),
        ("ASK { ?a dyknow:owns 3 }", 10, "of kind object", "no sample"),
        (
            "ASK { ?a dyknow:price ?v ; dyknow:rating ?v }",
            28,
            "`?v` is of kind text",
            "two variables",
        ),
        ("ASK { ?a dyknow:price ?a }", 10, "`?a` is of kind number", "two variables"),
        ("ASK { ?a dyknow:price ?v FILTER (?v = 'x') }", 33, "a number is compared", "one kind"),
        ("ASK { ?a dyknow:price ?v FILTER (getDURATION() < 5) }", 33, "a duration is", "PT10M"),
        ("ASK { ?a dyknow:rating ?n FILTER (?n < 'x') }", 34, "`<` orders no texts", "`=` and"),
        ("ASK { ?a dyknow:price ?v FILTER (?v) }", 33, "this is a number", "?price > 100"),
        ("ASK { ?a dyknow:rating ?n FILTER (?n + 1 > 2) }", 34, "`+` of a text and", "arithmetic"),
        ("ASK { ?a dyknow:rating ?n FILTER (STRLEN(?n) > 2) }", 34, "STRLEN", "C-SPARQL"),
        ("ASK { ?a dyknow:rating ?n FILTER (?n = 'x'@en) }", 34, "no kind", "without language"),
        (
            'ASK { ?a dyknow:price ?v FILTER (getDURATION() < "P1M"^^xsd:duration) }',
            33,
            "P1M",
            "vary",
        ),
        ("ASK { ?a dyknow:price ?v FILTER (?w > 2) }", 33, "`?w` is not bound", "has ?a, ?v"),
        (
            "ASK { ?a dyknow:price ?v } SEQ { ?a dyknow:price ?w FILTER (?v > ?w) }",
            60,
            "`?v` is not bound in this group",
            "after the `}`",
        ),
        (
            "ASK { ?a dyknow:price ?v ; <urn:p> ?k BIND (?k + 2 AS ?z) }",
            39,
            "static graphs",
            "a condition in the group",
        ),
        (
            "ASK { { ?a dyknow:price ?v FILTER (?k > 2) } { ?a <urn:p> ?k } }",
            35,
            "static graphs",
            "in the group of its triple",
        ),
        (
            "ASK { ?a dyknow:price ?v ; <urn:p> ?k ; <urn:q> ?m FILTER (?k != ?m) }",
            59,
            "two variables of static triples",
            "one variable",
        ),
        (
            "ASK { ?a dyknow:price ?v ; <urn:p> ?k FILTER (?k && ?v > 1) }",
            46,
            "this is a number",
            "`?k = true`",
        ),
        (
            'ASK { ?a dyknow:price ?v ; <urn:p> ?k FILTER (?k > ?v && ?k = "x") }',
            46,
            "a number is compared with a text",
            "of one kind",
        ),
        (
            "ASK { ?a <urn:prise> ?v FILTER (?v > 1) }",
            5,
            "reads no feature",
            "<urn:prise> is no feature; did you mean price?",
        ),
        ("ASK { ?a dyknow:price ?v BIND (1 AS ?v) }", 26, "bound already", "another name"),
        (f"SELECT ?q {WHERE}", 8, "`?q` is not bound", ""),
        (f"SELECT (?v + 1 AS ?a) {WHERE}", 8, "bound already", "another name"),
        (f"SELECT (?v AS ?start) {WHERE}", 8, "a field `start` already", "AS ?start_2"),
        (f"SELECT ?v ?v {WHERE}", 11, "a field `v` already", ""),
        (f"CONSTRUCT {{ ?a <urn:x> ?v . ?b <urn:x> ?v }} {WHERE}", 32, "one subject", "each"),
        (f"CONSTRUCT {{ ?a dyknow:owns ?b }} {WHERE}", 16, "feeds itself", "of its own"),
        (f"CONSTRUCT {{ ?v <urn:x> ?b }} {WHERE}", 16, "is no object", "object first"),
        (f"CONSTRUCT {{ ?a <urn:x> [] }} {WHERE}", 16, "blank node", "variable"),
        ("REGISTER TEMPLATE e(?q) AS ASK { ?a dyknow:price ?v }", 28, "does not use `?q`", "leave"),
        ("ASK { ?a dyknow:price ?v } WITHIN ?w", 1, "`?w` has no value", "only a template"),
    ],
)
def test_what_is_refused(text: str, at: int, message: str, hint: str) -> None:
    with pytest.raises(LanguageError) as refused:
        checked(text)
    assert message in refused.value.message
    assert hint in refused.value.hint
    assert refused.value.column == at
    assert refused.value.line == 1


def test_the_range_decides_the_kind_then_other_places_then_comparisons() -> None:
    assert kinds_of("ASK { ?a dyknow:price ?v }") == [Kind.NUMBER]
    assert kinds_of("ASK { ?a dyknow:level ?v }") == [Kind.NUMBER]
    assert kinds_of("ASK { ?a dyknow:level ?n ; dyknow:rating ?n }") == [Kind.TEXT] * 2
    assert kinds_of("ASK { ?a dyknow:level ?n FILTER (?n != 'x') }") == [Kind.TEXT]
    assert kinds_of("ASK { ?a dyknow:level ?n FILTER (dyknow:b = ?n) }") == [Kind.OBJECT]
    assert kinds_of("ASK { ?a dyknow:level ?t FILTER (?t < getENDTIME()) }") == [Kind.TIME]
    assert kinds_of("ASK { ?a dyknow:level ?n FILTER (?n IN (true)) }") == [Kind.TRUTH]
    assert kinds_of("ASK { ?a dyknow:level 'x' }") == [Kind.TEXT]
    assert kinds_of("ASK { ?a dyknow:level dyknow:b }") == [Kind.OBJECT]


def sorts_of(text: str) -> list[str]:
    return [
        sort.removeprefix(DYKNOW)
        for each in samples_in(checked(text).where)
        for _, sort in each.arguments
    ]


def test_a_sort_is_that_of_all_samples_that_must_be_there() -> None:
    price = "?a dyknow:price ?v"
    company = f"{{ {price} ; a dyknow:Company }}"
    assert sorts_of(f"ASK {company} SEQ {{ {price} }}") == ["Company", "Company"]
    assert sorts_of(f"ASK {company} UNION {{ {price} }}") == ["Company", "Thing"]
    assert sorts_of(f"ASK {company} OPTIONALSEQ {{ {price} }}") == ["Company", "Thing"]
    assert sorts_of(f"ASK {{ {price} }} OPTIONALSEQ {company}") == ["Company", "Company"]
    assert sorts_of(f"ASK {company} EQUALSOPTIONAL {{ {price} }}") == ["Company", "Company"]
    assert sorts_of(f"ASK {{ {price} }} EQUALSOPTIONAL {company}") == ["Thing", "Company"]
    assert sorts_of(f"ASK {{ {company} SEQ {{ {price} . ?a a dyknow:Bank }} }}") == ["Bank", "Bank"]


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("{ ?a dyknow:owns ?b . ?b a dyknow:Bank }", ["Sample", "Static"]),
        ("{ ?a dyknow:owns ?b . ?a a dyknow:Bank }", ["Sample"]),
        ("{ { ?a dyknow:price 1 } SEQ { ?a dyknow:price 2 } ?a a dyknow:Bank }", ["Operation"]),
        (
            "{ { ?a dyknow:price 1 } UNION { ?b dyknow:price 2 } ?a a dyknow:Bank }",
            ["Operation", "Static"],
        ),
    ],
)
def test_the_sort_of_an_object_without_a_sample_in_the_group_is_a_static_triple(
    text: str, parts: list[str]
) -> None:
    assert [type(each).__name__ for each in checked(f"ASK {text}").where.parts] == parts


def test_the_node_of_a_feature_of_several_objects() -> None:
    (found,) = samples_in(checked("ASK { ?a dyknow:distance [ rdf:value ?d ; rdf:_2 ?b ] }").where)
    assert [place.name for place, _ in found.arguments] == ["a", "b"]
    assert found.value.name == "d"
    (found,) = samples_in(checked("ASK { ?a dyknow:distance ?n . ?n rdf:_2 dyknow:b }").where)
    assert found.arguments[1][0].iri == DYKNOW + "b"


def test_parameters_have_kinds() -> None:
    text = """REGISTER TEMPLATE e(?c, ?limit, ?name, ?o) AS SELECT ?v WHERE
    { ?c dyknow:price ?v ; a dyknow:Company FILTER (?v > ?limit) } SEQ { ?c dyknow:rating ?n }
    SEQ { ?c dyknow:owns ?p } FILTER (?n = ?name && ?p != ?o)"""
    assert checked(text).slots == (
        ObjectSlot("c", DYKNOW + "Company"),
        Parameter("limit", Kind.NUMBER),
        Parameter("name", Kind.TEXT),
        Parameter("o", Kind.OBJECT),
    )


def test_within_is_the_least_bound_of_the_whole() -> None:
    text = "ASK { ?a dyknow:price ?v } SEQ { ?a dyknow:price ?w } FILTER (%s) WITHIN 5s"
    assert horizon(checked(text % "?v < ?w")) == 5 * 10**9
    assert (
        horizon(checked(text % '?v < ?w && getDURATION() < "PT2S"^^xsd:duration')) == 2 * 10**9 - 1
    )
    assert horizon(checked(text % '"PT2S"^^xsd:duration >= getDURATION()')) == 2 * 10**9
    assert horizon(checked(text % '!(getDURATION() > "PT2S"^^xsd:duration)')) == 2 * 10**9
    assert horizon(checked(text % '?v < ?w || getDURATION() < "PT2S"^^xsd:duration')) == 5 * 10**9


def test_no_name_of_the_text_is_that_of_a_blank_node() -> None:
    text = "SELECT ?_·1 { ?_·1 dyknow:owns [] . ?_··1 dyknow:price [] } WITHIN 5s"
    names = [
        place.name
        for sample in samples_in(checked(text).where)
        for place in (sample.arguments[0][0], sample.value)
    ]
    assert len(set(names)) == 4
