"""Which windows share a pass, and what the pass returns."""

import pytest
from pyoxigraph import Literal, NamedNode, Store

from dyknow.continuous.algebra.options import Options, Semantics
from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.operators.background import Background
from dyknow.continuous.operators.results import ResultBatch
from dyknow.continuous.windows import window_schedule
from dyknow.languages.csparql import parse_query
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.terms_to_columns import from_terms

PLACE = "http://d.example/"
QUERY = f"""REGISTER QUERY q AS SELECT ?o (AVG(?v) AS ?a)
FROM STREAM <{PLACE}s> [RANGE 2ns STEP 1ns] WHERE {{ ?o <{PLACE}v> ?v }} GROUP BY ?o"""


def ends(
    count: int,
    values: list[object],
    query: str = QUERY,
    defers: bool = False,
    semantics: Semantics = "bag",
) -> list:
    """The ends of each result, if ``count`` windows are due at once."""
    dictionary = TermDictionary()
    evaluator = ContinuousEvaluator(
        parse_query(query), dictionary, Background(Store()), [PLACE + "s"], Options(semantics)
    )
    evaluator.splits, evaluator.defers = False, defers
    rows = [
        (time, NamedNode(PLACE + "o"), NamedNode(PLACE + "v"), Literal(values[time % len(values)]))
        for time in range(1, count + 1)
    ]
    evaluator.push(PLACE + "s", from_terms(rows, dictionary))
    results = evaluator.advance(PLACE + "s", count + 1)
    while defers and evaluator.close_next(most=10):
        results += evaluator.take_results()
    assert evaluator.closed == count
    return [tuple(each.ends) for each in results]


@pytest.mark.parametrize(
    "query",
    [
        QUERY,
        QUERY.replace("SELECT ", "SELECT ISTREAM "),
        QUERY.replace("SELECT ", "SELECT DSTREAM "),
        QUERY.replace("?v }", "?v FILTER(?v > 1) }"),
        QUERY.replace("AVG(?v)", "AVG(2 * ?v)"),
        QUERY.replace("?v }", "?v VALUES (?o ?z) {(<http://d.example/o> 1)} }"),
        QUERY.replace("?o ", "", 1).replace("GROUP BY ?o", ""),
    ],
)
@pytest.mark.parametrize("semantics", ["bag", "set"])
def test_windows_that_are_due_at_once_share_a_pass(query: str, semantics: Semantics) -> None:
    assert ends(20, [1.5, 2.0], query, semantics=semantics) == [tuple(range(1, 21))]


def test_windows_that_are_due_at_once_share_passes_of_bounded_size() -> None:
    most = window_schedule.MOST
    assert list(map(len, ends(most + 9, [1.5]))) == [most, 9]


def test_a_pass_must_save_more_than_it_costs() -> None:
    long = QUERY.replace("RANGE 2ns", "RANGE 6000ns")
    assert ends(9, [1.5], long) == [(end,) for end in range(1, 10)]
    assert ends(60, [1.5], long) == [tuple(range(1, 61))]


def test_a_caller_limits_the_windows_of_a_pass() -> None:
    assert list(map(len, ends(24, [1], defers=True))) == [10, 10] + [1] * 4


@pytest.mark.parametrize(
    ("count", "values", "query"),
    [
        (window_schedule.FEWEST - 1, [1.5], QUERY),
        (20, [1.5, "text"], QUERY),
        (20, [1.5], QUERY.replace("AVG(?v)", "COUNT(DISTINCT ?v)")),
        (20, [1.5], QUERY + " LIMIT 1"),
    ],
)
def test_others_are_evaluated_one_by_one(count: int, values: list[object], query: str) -> None:
    assert ends(count, values, query) == [(end,) for end in range(1, count + 1)]


def test_a_batch_has_the_result_of_each_window() -> None:
    dictionary = TermDictionary()
    evaluator = ContinuousEvaluator(
        parse_query(QUERY), dictionary, Background(Store()), [PLACE + "s"]
    )
    evaluator.splits = False
    rows = [
        (time, NamedNode(f"{PLACE}o{time % 2}"), NamedNode(PLACE + "v"), Literal(float(time)))
        for time in range(1, 9)
    ]
    evaluator.push(PLACE + "s", from_terms(rows, dictionary))
    (batch,) = evaluator.advance(PLACE + "s", 9)
    assert isinstance(batch, ResultBatch)
    third = list(batch.windows())[2]
    assert (third.start, third.end) == (1, 3)
    assert third.solutions is not None
    values = {row["o"].value[-1]: float(row["a"].value) for row in third.solutions.rows()}
    assert values == {"0": 2.0, "1": 3.0}
