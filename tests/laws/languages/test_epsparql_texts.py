"""Laws of the EP-SPARQL parser: what is printed is read back, and no text is hostile."""

from __future__ import annotations

from random import Random

import pytest
from ending_soon import ends_within
from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow.languages.csparql import parse_query
from dyknow.languages.epsparql import EpSparqlQuery, format_epsparql, is_epsparql, parse_epsparql
from dyknow.languages.errors import LanguageError

SEEDS = st.integers(0, 2**32)
OPERATORS = ("SEQ", "EQUALS", "OPTIONALSEQ", "EQUALSOPTIONAL", "UNION", "seq")
TERMS = ("?a", "?b", "$c", "dyknow:uav1", "<http://e/x>")
VERBS = ("dyknow:speed", "<urn:p>", "a", "dyknow:p/dyknow:q", "^dyknow:p")
OBJECTS = (*TERMS, "3", "-2.5", '"SEQ { WITHIN"', "true", "[ dyknow:p ?n ]", "_:b")
OPERANDS = (
    "?a",
    "1",
    "1.5",
    "'x'",
    "getDURATION()",
    "GETSTARTTIME()",
    "dyknow:uav1",
    "getEndTime()",
)
DURATIONS = ("5s", "90 seconds", "PT1H", '"P1DT2H"^^xsd:duration', "3 min")


class Texts:
    """Random EP-SPARQL texts."""

    def __init__(self, seed: int) -> None:
        self.draw = Random(seed)

    def query(self) -> str:
        draw = self.draw
        register = draw.choice(["", "REGISTER STREAM s AS ", "REGISTER TEMPLATE e(?a, ?b) AS "])
        head = draw.choice(
            [
                "SELECT *",
                "SELECT ?a $c (getDURATION() + 1 AS ?d)",
                "CONSTRUCT { ?a <urn:r> ?b . ?a a dyknow:Thing }",
                "ASK",
            ]
        )
        graphs = draw.choice(["", " FROM <http://e/g>", " FROM NAMED <http://e/g>"])
        chain = self.chain(2, least=2)
        filters = " ".join(self.filter() for _ in range(draw.choice([0, 0, 1, 2])))
        within = draw.choice(["", f" WITHIN {draw.choice([*DURATIONS, '?w'])}"])
        within += draw.choice(["", "", " WITH MAX DELAY 0s", " with max delay PT5S"])
        where = draw.choice([" ", " WHERE "])
        return f"{register}{head}{graphs}{where}{chain} {filters}{within}"

    def chain(self, depth: int, least: int = 1) -> str:
        text = self.group(depth)
        for _ in range(self.draw.randint(least, 3) - 1):
            text += f" {self.draw.choice(OPERATORS)} {self.group(depth)}"
        return text

    def group(self, depth: int) -> str:
        return "{ " + " ".join(self.part(depth) for _ in range(self.draw.randint(0, 3))) + " }"

    def part(self, depth: int) -> str:
        draw = self.draw
        drawn = draw.random()
        if depth and drawn < 0.3:
            return self.chain(depth - 1)
        if drawn < 0.4:
            return self.filter()
        if drawn < 0.45:
            return f"BIND ({self.expression(2)} AS ?z)"
        if drawn < 0.5:
            return "GRAPH <http://e/g> { ?a <urn:s> ?b }"
        more = draw.choice(["", f" ; {draw.choice(VERBS)} 3", " , 4"])
        objects = [each for each in OBJECTS if each != "_:b"]
        return f"{draw.choice(TERMS)} {draw.choice(VERBS)} {draw.choice(objects)}{more} ."

    def filter(self) -> str:
        return f"FILTER ({self.expression(3)})"

    def expression(self, depth: int) -> str:
        draw = self.draw
        if not depth or draw.random() < 0.2:
            return draw.choice(OPERANDS)
        left, right = self.expression(depth - 1), self.expression(depth - 1)
        form = draw.choice(["{} {} {}"] * 3 + ["!({1} {0} {2})", "({1} IN ({2}, 3))", "bound(?a)"])
        operator = draw.choice(["<", ">=", "=", "!=", "+", "-", "*", "/", "&&", "||"])
        if form == "{} {} {}":
            return f"({left}) {operator} ({right})"
        return form.format(operator, f"({left})", f"({right})")


@settings(deadline=None, max_examples=300)
@given(SEEDS)
def test_what_is_printed_is_read_back(seed: int) -> None:
    text = Texts(seed).query()
    query = parse_epsparql(text)
    printed = format_epsparql(query)
    assert parse_epsparql(printed) == query
    assert format_epsparql(parse_epsparql(printed)) == printed
    assert is_epsparql(text) == is_epsparql(printed)


WORDS = """{ } ( ) [ ] . ; , ?a dyknow:p a <urn:x> 1 -1 'x' < <= = != && || ! + - * / SELECT WHERE
FILTER BIND AS GRAPH UNION SEQ EQUALS OPTIONALSEQ EQUALSOPTIONAL WITHIN 5s PT5S getDURATION()
getENDTIME ASK CONSTRUCT REGISTER STREAM TEMPLATE PREFIX e: OPTIONAL EXISTS NOT COUNT BOUND"""
PIECES = WORDS.split()
BEGINNINGS = ("", "SELECT * {", "ASK { ?a dyknow:p ?b } SEQ {", "SELECT (", "CONSTRUCT {")


@settings(deadline=None, max_examples=500)
@given(st.sampled_from(BEGINNINGS), st.lists(st.sampled_from(PIECES), max_size=30))
def test_an_error_has_a_place(beginning: str, pieces: list[str]) -> None:
    text = " ".join([beginning, *pieces])
    is_epsparql(text)
    found = parsed(text)
    if isinstance(found, LanguageError):
        assert 0 <= found.span.start <= found.span.end <= len(text)
        assert found.message
    else:
        assert parse_epsparql(format_epsparql(found)) == found


def parsed(text: str) -> EpSparqlQuery | LanguageError:
    try:
        return parse_epsparql(text)
    except LanguageError as error:
        return error


@pytest.mark.parametrize(
    "text",
    [
        "SELECT * " + "{" * 20_000,
        "SELECT * " + "{ } SEQ " * 5_000,
        "SELECT * { ?a <urn:p> ?b } " + "SEQ { ?a <urn:p> ?b } " * 2_000,
        "SELECT * { FILTER (" + "(" * 20_000,
        "SELECT * { FILTER (" + "!" * 20_000,
        "SELECT * { FILTER (1" + " + 1" * 10_000,
        "SELECT * { FILTER (1" + " || 1" * 10_000,
        "SELECT * { ?a <urn:p> " + "[ <urn:p> " * 4_000,
        "SELECT * { ?a " + "<urn:p>/" * 5_000,
        "SELECT * {" + "#" * 40_000,
        "SELECT * { '" + "\\'" * 20_000,
        "SELECT * { <" + "a" * 40_000,
        "REGISTER " * 5_000,
        "PREFIX " * 5_000,
        "REGISTER STREAM s " + "( " * 20_000,
        " " * 40_000 + "SELECT",
        "SELECT * {" + "?a " * 13_000,
    ],
)
def test_a_hostile_text_is_refused_at_once(text: str) -> None:
    with ends_within(200):
        is_epsparql(text)
        with pytest.raises(LanguageError):
            parse_epsparql(text)


@pytest.mark.parametrize(
    ("text", "is_own"),
    [
        ("SELECT * { ?a ?b ?c } SEQ { ?d ?e ?f }", True),
        ("# SEQ\nprefix e: <http://e/> select * { ?a ?b ?c } equals { ?d ?e ?f }", True),
        ("REGISTER STREAM select AS SELECT * { ?a ?b ?c } WITHIN 5s", True),
        ("REGISTER TEMPLATE e(?x, ?limit) AS PREFIX e: <u> ASK { } OPTIONALSEQ { }", True),
        ("CONSTRUCT { ?a ?b ?c } WHERE { { } EQUALSOPTIONAL { } }", True),
        ("ASK { ?a <urn:p> ?v FILTER (?v<3&&getDURATION()>?v) }", True),
        ("ASK { ?a <urn:p> ?v FILTER (?v<getSTARTTIME()&&?w>?v) }", True),
        (
            "SELECT ?seq { ?seq dyknow:SEQ 'SEQ', '''WITHIN''' , <urn:EQUALS> } # getDURATION()",
            False,
        ),
        ("REGISTER STREAM SEQ AS SELECT ?a { ?a <urn:p> ?b } WINDOW [RANGE 5s STEP 1s]", False),
        ("DESCRIBE ?a { } SEQ { }", False),
        ("chronicle SEQ { SELECT }", False),
        ("PATTERN SEQ(A a, B b) WITHIN 5s", False),
        ("REGISTER STREAM s AS PATTERN SEQ(A a, B b) WITHIN 5s", False),
        ("REGISTER TEMPLATE e(?x) AS always speed(?x) > 3", False),
        ("REGISTER TEMPLATE e(?x) AS chronicle c(?x) { }", False),
        ("monitor m(?x in Car) = speed(?x) > 3", False),
        ("", False),
    ],
)
def test_the_words_tell_the_language(text: str, is_own: bool) -> None:
    assert is_epsparql(text) is is_own


def test_no_c_sparql_text_is_taken() -> None:
    text = "REGISTER STREAM s AS SELECT ?v { ?a dyknow:speed ?v } WINDOW [RANGE 5s STEP 1s]"
    parse_query(text)
    assert not is_epsparql(text)
