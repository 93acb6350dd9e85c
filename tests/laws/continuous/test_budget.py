"""A window exceeds its budget whatever way the input came: the law of
`continuous.columns.budget`."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import Literal, NamedNode

from dyknow.continuous.columns.budget import OVERRUNS, Budget
from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.operators.background import Background
from dyknow.languages.csparql import parse_query
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.namespaces import DYKNOW
from dyknow.rdf.terms_to_columns import from_terms
from dyknow.streams.time import SECOND

SPEED = NamedNode(DYKNOW + "speed")
SOURCE = """REGISTER QUERY q COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
SELECT ?a ?c FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf> [RANGE 1s STEP 1s]
WHERE { %s }"""
BODIES = [
    "?a dyknow:speed ?b . ?c dyknow:speed ?d",
    "?a dyknow:speed ?b . ?c dyknow:speed ?d FILTER(?b + ?d < 0)",
    "?a dyknow:speed ?b OPTIONAL { ?c dyknow:speed ?d FILTER(?b < ?d) }",
    "?a dyknow:speed ?b . ?c dyknow:speed ?d FILTER EXISTS { ?x dyknow:speed ?y . ?z dyknow:p ?b }",
    "{ ?a dyknow:speed ?b } UNION { ?c dyknow:speed ?d }",
    "?a (dyknow:speed|dyknow:p)* ?c",
]


def run(body: str, seconds: list[int], cuts: set[int], budget: Budget) -> object:
    """What comes out, told in a form that can be compared; ``cuts``: where rows are pushed and the
    watermark is told."""
    dictionary = TermDictionary()
    evaluator = ContinuousEvaluator(
        parse_query(SOURCE % body), dictionary, Background(), ["s"], budget=budget
    )
    rows = [
        (second * SECOND + 1 + i, NamedNode(f"{DYKNOW}o{i}"), SPEED, Literal(i))
        for second, count in enumerate(seconds)
        for i in range(count)
    ]
    results, overruns = [], []
    start = 0
    for stop in sorted(cuts | {len(rows)}):
        stop = min(stop, len(rows))
        if stop > start:
            evaluator.push("s", from_terms(rows[start:stop], dictionary))
            results += evaluator.advance("s", rows[stop - 1][0])
            start = stop
    results += evaluator.end("s")
    overruns += evaluator.overruns
    told = [
        (r.end, sorted(map(str, r.solutions.rows() if r.solutions is not None else ())))
        for r in results
    ]
    return told, overruns, evaluator.quarantine


@settings(deadline=None)
@given(
    st.sampled_from(BODIES),
    st.lists(st.integers(0, 9), min_size=1, max_size=8),
    st.sets(st.integers(1, 60), max_size=5),
    st.integers(1, 60),
)
def test_cuts_change_nothing(body: str, seconds: list[int], cuts: set[int], rows: int) -> None:
    budget = Budget(rows, 10 * rows)
    assert run(body, seconds, cuts, budget) == run(body, seconds, set(), budget)


@settings(deadline=None)
@given(
    st.sampled_from(BODIES),
    st.lists(st.integers(0, 9), min_size=1, max_size=8),
    st.integers(1, 60),
)
def test_what_fits_is_what_it_is_without_a_budget(body: str, seconds: list[int], rows: int) -> None:
    free, none, never = run(body, seconds, set(), Budget())  # type: ignore[misc]
    kept, overruns, quarantine = run(body, seconds, set(), Budget(rows, rows))  # type: ignore[misc]
    assert (none, never) == ([], "")
    whole = dict(free)
    assert all(whole[end] == solutions for end, solutions in kept)
    if not quarantine:
        assert {end for end, _ in kept} | {each.end for each in overruns} == set(whole)


def test_three_windows_in_a_row() -> None:
    body, budget = BODIES[0], Budget(20)
    good, bad = 2, 9
    told, overruns, quarantine = run(body, [bad, bad, good, bad, bad, good], set(), budget)  # type: ignore[misc]
    assert [end // SECOND for end, _ in told] == [3, 6]
    assert len(overruns) == 4
    assert quarantine == ""
    told, overruns, quarantine = run(body, [good, bad, bad, bad, good], set(), budget)  # type: ignore[misc]
    assert [end // SECOND for end, _ in told] == [1]
    assert len(overruns) == OVERRUNS
    assert "3 windows in a row" in quarantine


def test_texts_that_are_put_together_count_by_their_characters() -> None:
    body = "?a dyknow:speed ?b"
    text = SOURCE.replace("?a ?c", "(GROUP_CONCAT(STR(?a); SEPARATOR=', ') AS ?all)") % body
    dictionary = TermDictionary()
    size = len(f"{DYKNOW}o0, ")
    for least, fits in ((3 * size, True), (3 * size - 1, False)):
        evaluator = ContinuousEvaluator(
            parse_query(text), dictionary, Background(), ["s"], budget=Budget(text=least)
        )
        rows = [(1 + i, NamedNode(f"{DYKNOW}o{i}"), SPEED, Literal(i)) for i in range(3)]
        evaluator.push("s", from_terms(rows, dictionary))
        results = evaluator.end("s")
        assert bool(results) is fits
        told = [each.reason for each in evaluator.overruns]
        assert told == (
            []
            if fits
            else [f"GROUP_CONCAT makes {3 * size} characters of a window, at most {least} may be"]
        )
