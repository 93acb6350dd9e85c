"""EP-SPARQL as pattern queries: the kinds of queries in ETALIS's EP-SPARQL chapter, what is
refused, and what a query asks of streams."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

import pytest
from ending_soon import ends_within
from epsparql_definition import Sample, Value
from epsparql_drawing import vocabulary
from epsparql_running import Running
from vocabularies import vocabulary_of

from dyknow.languages.epsparql import check_epsparql, parse_epsparql
from dyknow.languages.errors import LanguageError
from dyknow.languages.mtl.checked import Constant, Kind, ObjectConstant
from dyknow.ontology.vocabulary import THING
from dyknow.rdf.namespaces import DYKNOW
from dyknow.reasoning.patterns.compilation.epsparql_plans import epsparql_query
from dyknow.reasoning.patterns.plans.printer import print_plan
from dyknow.reasoning.patterns.plans.query import Argument, PatternQuery, Result
from dyknow.streams.time import DAY

STOCKS = """
dyknow:Company a owl:Class . dyknow:Agency a owl:Class . dyknow:Rating a owl:Class .
dyknow:hasStockPrice a dyknow-o:Feature ; rdfs:range xsd:double .
dyknow:downratedby a dyknow-o:Feature ; rdfs:range dyknow:Agency .
dyknow:hasAcquired a dyknow-o:Feature ; rdfs:range dyknow:Company .
dyknow:rater a dyknow-o:Feature ; rdfs:range dyknow:Agency .
dyknow:rated a dyknow-o:Feature ; rdfs:range dyknow:Company .
dyknow:score a dyknow-o:Feature ; rdfs:range xsd:double .
"""


def days(*rows: tuple[int, str, str, str | float]) -> list[Sample]:
    """Samples of (day, object, feature, value); a text is an object."""
    found = []
    for number, (day, owner, feature, value) in enumerate(rows):
        told: Value = ("object", DYKNOW + value) if isinstance(value, str) else ("number", value)
        time = day * DAY
        found.append(Sample(number, DYKNOW + feature, DYKNOW + owner, told, time, time))
    return found


def results(text: str, samples: Sequence[Sample]) -> list[tuple[int, dict[str, object]]]:
    """The day on which each result is decided, and its fields, objects by their local names."""
    running = Running(epsparql_query(check_epsparql(parse_epsparql(text), vocabulary_of(STOCKS))))
    found = []
    for sample in samples:
        found += running.push([sample])
    found += running.advance(10_000 * DAY)
    return [
        (
            -(-decided // DAY),
            {
                name: None if value is None else str(value[1]).removeprefix(DYKNOW)
                for name, value in values
            },
        )
        for _, values, decided in found
    ]


def price(day: int, company: str, value: float) -> tuple[int, str, str, float]:
    return day, company, "hasStockPrice", value


def test_query_1_a_fall_within_a_month() -> None:
    """A sequence, with a condition on values and on the duration of the whole."""
    text = """SELECT ?company ?price2 WHERE { ?company dyknow:hasStockPrice ?price1 }
    SEQ { ?company dyknow:hasStockPrice ?price2 }
    FILTER (?price2 < ?price1 * 0.7 && getDURATION() < "P30D"^^xsd:duration)"""
    samples = days(price(0, "a", 100), price(1, "b", 60), price(10, "a", 65), price(30, "a", 60))
    # At day 30 the first price is 30 days old, and 60 is no fall from 65.
    assert results(text, samples) == [(10, {"company": "a", "price2": "65.0"})]


QUERY_2 = """SELECT ?company ?agency ?price2 WHERE { ?company dyknow:downratedby ?agency }
OPTIONALSEQ { { ?company dyknow:hasStockPrice ?price1 }
  SEQ { ?company dyknow:hasStockPrice ?price2 } }
FILTER (?price2 < ?price1 * 0.7) WITHIN 30d"""


def test_query_2_a_fall_perhaps_after_a_downrating() -> None:
    """The earlier part may be missing: all falls are found, and their downratings where there were
    some."""
    samples = days(
        price(0, "a", 100),
        price(1, "a", 60),
        (2, "b", "downratedby", "moody"),
        (3, "b", "downratedby", "fitch"),
        price(4, "b", 100),
        price(5, "b", 60),
        (6, "a", "downratedby", "moody"),
    )
    assert results(QUERY_2, samples) == [
        (1, {"company": "a", "agency": None, "price2": "60.0"}),
        (5, {"company": "b", "agency": "moody", "price2": "60.0"}),
        (5, {"company": "b", "agency": "fitch", "price2": "60.0"}),
    ]


QUERY_3 = """SELECT ?company WHERE { ?company dyknow:hasStockPrice ?price1 }
SEQ { { ?company dyknow:hasAcquired ?other } OPTIONALSEQ { ?company dyknow:hasStockPrice ?price2 } }
FILTER (!BOUND(?other) && ?price2 < ?price1 * 0.7) WITHIN 30d"""


def test_query_3_a_fall_without_an_acquisition() -> None:
    samples = days(
        price(0, "a", 100),
        price(0, "b", 100),
        (1, "b", "hasAcquired", "c"),
        price(2, "a", 60),
        price(2, "b", 60),
    )
    assert results(QUERY_3, samples) == [(2, {"company": "a"})]


def test_query_3_loses_acquisitions_before_the_first_price() -> None:
    """By the algebra the acquisition and the second price are joined, before the first price is
    looked at: the second price alone is no solution."""
    samples = days((0, "a", "hasAcquired", "c"), price(1, "a", 100), price(2, "a", 60))
    assert results(QUERY_3, samples) == []


def test_query_4_events_with_several_properties() -> None:
    """A rating is an object: its features are of one sample each, joined by it."""
    text = """SELECT ?company ?score1 ?score2 WHERE
    { ?rating1 dyknow:rater ?agency ; dyknow:rated ?company ; dyknow:score ?score1 } SEQ
    { ?rating2 dyknow:rater ?agency ; dyknow:rated ?company ; dyknow:score ?score2 }
    FILTER (?score2 < ?score1) WITHIN 10d"""

    def rating(day: int, name: str, agency: str, company: str, score: float) -> list[object]:
        return [
            (day, name, "rater", agency),
            (day, name, "rated", company),
            (day, name, "score", score),
        ]

    rows = [
        *rating(0, "r1", "moody", "a", 8),
        *rating(1, "r2", "fitch", "a", 5),
        *rating(2, "r3", "moody", "b", 4),
        *rating(3, "r4", "moody", "a", 6),
    ]
    assert results(text, days(*rows)) == [(3, {"company": "a", "score1": "8.0", "score2": "6.0"})]


def test_query_5_that_feeds_itself_is_refused() -> None:
    text = """CONSTRUCT { ?a dyknow:hasAcquired ?c } WHERE { ?a dyknow:hasAcquired ?b }
    SEQ { ?b dyknow:hasAcquired ?c } WITHIN 10d"""
    with pytest.raises(LanguageError, match="feeds itself: it reads dyknow:hasAcquired"):
        check_epsparql(parse_epsparql(text), vocabulary_of(STOCKS))


# -- what is refused -------------------------------------------------------------------------


def compiled(text: str, **arguments: Constant | ObjectConstant) -> PatternQuery:
    return epsparql_query(check_epsparql(parse_epsparql(text), vocabulary()), arguments)


PRICE = "{ ?a dyknow:price ?v }"
ALTERNATIVES = f"{{ {PRICE} UNION {PRICE} }}"


@pytest.mark.parametrize(
    ("text", "at", "message", "hint"),
    [
        (f"ASK {PRICE} SEQ {{ ?b dyknow:price ?w }}", 10, "kept for ever", "WITHIN 10 min"),
        (f"ASK {PRICE} OPTIONALSEQ {PRICE}", 10, "kept for ever", "getDURATION() <"),
        ("ASK { ?a dyknow:price ?v . ?b dyknow:open ?t }", 10, "kept for ever", "WITHIN"),
        (
            'ASK { ?a dyknow:price ?v FILTER (getDURATION() < "PT1S"^^xsd:duration) } SEQ '
            f"{PRICE}",
            10,
            "kept for ever",
            "after the last",
        ),
        (
            f'ASK {{ {PRICE} SEQ {PRICE} FILTER (getDURATION() <= "PT0S"^^xsd:duration) }}',
            12,
            "contradict",
            "no solution",
        ),
        (f"ASK {' SEQ '.join([PRICE] * 17)} WITHIN 5s", 5, "17 events", "divide"),
        (
            f"ASK {' SEQ '.join([ALTERNATIVES] * 5)} WITHIN 5s",
            5,
            "more than 16 alternatives",
            "parts",
        ),
        (f"ASK {' OPTIONALSEQ '.join([PRICE] * 9)} WITHIN 5s", 5, "more than 32 plans", "parts"),
        (f"ASK {PRICE} SEQ {{ }} WITHIN 5s", 32, "no sample in it", "leave it out"),
        (f"ASK {PRICE} UNION {{ ?a <urn:p> ?b }} WITHIN 5s", 34, "no sample in it", ""),
        (f"ASK {PRICE} SEQ {PRICE} FILTER (!BOUND(?v)) WITHIN 5s", 62, "for no solution", "BOUND"),
        (
            f"ASK {{ ?a dyknow:price ?v ; <urn:p> ?k }} OPTIONALSEQ {PRICE} WITHIN 5s",
            5,
            "has static triples",
            "beside it",
        ),
        (
            f"ASK {{ {PRICE} UNION {{ ?b dyknow:price ?w }} ?b <urn:p> ?k }} WITHIN 5s",
            62,
            "in one of the alternatives",
            "into the groups",
        ),
        (
            f"ASK {PRICE} FILTER (1 < {'(1 + ' * 40}?v{')' * 40})",
            5,
            "nested too deeply",
            "32",
        ),
        (
            f'ASK {PRICE} FILTER (getDURATION() < "PT0S"^^xsd:duration)',
            35,
            "less than no time",
            "<=",
        ),
    ],
)
def test_what_is_refused(text: str, at: int, message: str, hint: str) -> None:
    with pytest.raises(LanguageError) as refused:
        compiled(text)
    assert message in refused.value.message
    assert hint in refused.value.hint
    assert refused.value.column == at


def nested(operator: str, depth: int) -> str:
    return PRICE if not depth else f"{{ {PRICE} {operator} {nested(operator, depth - 1)} }}"


@pytest.mark.parametrize(
    "text",
    [
        f"ASK {' SEQ '.join([PRICE] * 120)} WITHIN 5s",
        f"ASK {' EQUALS '.join([PRICE] * 16)} WITHIN 5s",
        f"ASK {' OPTIONALSEQ '.join([PRICE] * 16)} WITHIN 5s",
        f"ASK {nested('EQUALSOPTIONAL', 15)} WITHIN 5s",
        f"ASK {'{ ' * 60}?a dyknow:price ?v{' }' * 60}",
        f"ASK {{ ?a dyknow:price ?v FILTER ({' || '.join(['?v = 1'] * 900)}) }}",
        f"ASK {{ ?a dyknow:price ?v FILTER (?v NOT IN ({', '.join(['1'] * 1900)})) }}",
        f"ASK {{ {'?a dyknow:price ?v . ' * 120} }}",
        "ASK { ?a dyknow:price ?_" + "\u00b7" * 40_000 + " }",
    ],
)
def test_a_large_text_takes_no_long(text: str) -> None:
    with ends_within(2_000), contextlib.suppress(LanguageError):
        compiled(text)


# -- what a query asks of streams ------------------------------------------------------------


def test_the_plan_of_a_sequence() -> None:
    query = compiled(
        "REGISTER STREAM rise AS SELECT ?c ?p1 ?p2 WHERE { ?c dyknow:price ?p1 } SEQ "
        "{ ?c dyknow:price ?p2 } "
        'FILTER (?p2 > ?p1 * 1.1 && getDURATION() < "PT10M"^^xsd:duration)'
    )
    assert query.name == "rise"
    (plan,) = query.plans
    assert print_plan(plan).splitlines() == [
        "columns object 1: key, number: number, integer: integer, key: key",
        "event price: price",
        "event price (2): price",
        "time start of price (2) - price in [1ns, oo)",
        "same price.object 1 = price (2).object 1",
        "where price (2).number > (price.number * 1.1)",
        "select skip_till_any_match",
        "within 599999999999ns",
        "rows are instants",
        "return start(price, price (2)) as start",
        "return end(price, price (2)) as end",
        "return price.object 1 as c",
        "return price.number as p1",
        "return price (2).number as p2",
    ]
    assert query.results == (
        Result("c", Kind.OBJECT, Argument(THING)),
        Result("p1", Kind.NUMBER),
        Result("p2", Kind.NUMBER),
    )


def test_a_source_is_of_a_concept_and_its_objects() -> None:
    query = compiled(
        "ASK { ?c dyknow:price ?p1 ; a dyknow:Company } SEQ { dyknow:c1 dyknow:price ?p2 } "
        "SEQ { ?b dyknow:price ?p2 . ?c dyknow:price ?p3 } WITHIN 5s"
    )
    assert [(each.kind, each.arguments) for each in query.sources] == [
        ("price", (Argument(DYKNOW + "Company"),)),
        ("price 2", (Argument(THING, DYKNOW + "c1"),)),
        ("price 3", (Argument(THING),)),
    ]
    assert [each.kinds for each in query.plans[0].elements] == [
        ("price",),
        ("price 2",),
        ("price 3",),
        ("price",),
    ]


def test_only_events_last() -> None:
    assert not compiled("ASK { ?a dyknow:price ?v }").plans[0].has_intervals
    assert compiled("ASK { ?a dyknow:Crash ?v }").plans[0].has_intervals


TEMPLATE = """REGISTER TEMPLATE Rise(?c, ?limit) AS SELECT ?c ?v WHERE { ?c dyknow:price ?v }
SEQ { ?c dyknow:price ?w FILTER (?w > ?limit) } WITHIN 5s"""


def test_a_request_gives_the_parameters() -> None:
    """What is compiled is the query with the values written into it."""
    limit = Constant(100.0, Kind.NUMBER)
    written = TEMPLATE.replace("TEMPLATE Rise(?c, ?limit)", f"STREAM <{DYKNOW}Rise>")
    assert compiled(TEMPLATE, limit=limit) == compiled(written.replace("?limit", "100"))
    one = compiled(TEMPLATE, limit=limit, c=ObjectConstant(DYKNOW + "c1"))
    assert [each.arguments for each in one.sources] == [(Argument(THING, DYKNOW + "c1"),)]
    assert one.results[0] == Result("c", Kind.OBJECT, Argument(None, DYKNOW + "c1"))
    own = written.replace("?limit", "100").replace("?c dyknow", "dyknow:c1 dyknow")
    assert one.plans[0].elements == compiled(own.replace("SELECT ?c", "SELECT")).plans[0].elements


def test_a_result_of_construct_has_an_id_and_a_field_for_each_predicate() -> None:
    text = """CONSTRUCT { ?a <urn:p#rose> ?v ; <urn:p#kind> dyknow:good } WHERE
    { ?a dyknow:price ?v } SEQ { ?a dyknow:open true } WITHIN 5s"""
    assert compiled(text).results == (
        Result("id", Kind.OBJECT, Argument(THING)),
        Result("rose", Kind.NUMBER, None, "urn:p#rose"),
        Result("kind", Kind.OBJECT, Argument(None, DYKNOW + "good"), "urn:p#kind"),
    )


def test_the_explanation_names_plans_and_their_absences() -> None:
    query = compiled(f"ASK {PRICE} EQUALSOPTIONAL {{ ?a dyknow:open ?t }} WITHIN 5s")
    text = Running(query).rows.explain()
    assert "plan 0\n" in text
    assert "unless plan 0 has the same events (0 = 0), known after until 1" in text
