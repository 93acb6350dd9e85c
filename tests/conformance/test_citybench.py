"""CityBench: its six queries as they are, over the recorded sensors of Aarhus.

They are held against a definition on rdflib (`rdflib_definition`) and against Oxigraph a window.
Windows are 3 s every second; records arrive faster than they were recorded, in two schedules, so
that windows hold several records of each stream. A query that joins every observation with every
other gets fewer records: what it costs is its number of solutions.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import citybench
import pytest
import rdflib
import rdflib_definition as definition
from citybench import SECOND, SERVICE, Schedule
from shared_data import needs

import dyknow
from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.operators.background import Background
from dyknow.languages.csparql import parse_query
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.terms_to_columns import from_terms

pytestmark = needs(citybench.FOLDER)

SENSORS = (
    "AarhusTrafficData182955",
    "AarhusTrafficData158505",
    "AarhusWeatherData0",
    "AarhusParkingDataKALKVAERKSVEJ",
    "UserLocationService",
)
SLOW = Schedule(period=SECOND, offset=SECOND // 4)
FAST = Schedule(period=SECOND // 5, offset=SECOND // 15)
# The number of the query, and how many records of each stream it is given.
CASES = [
    pytest.param(number, schedule, records, id=f"Q{number}-{name}")
    for number, name, schedule, records in [
        (1, "slow", SLOW, 40),
        (1, "fast", FAST, 40),
        (2, "slow", SLOW, 3),
        (2, "fast", FAST, 2),
        (3, "slow", SLOW, 40),
        (3, "fast", FAST, 40),
        (4, "slow", SLOW, 9),
        (4, "fast", FAST, 9),
        (5, "slow", SLOW, 6),
        (5, "fast", FAST, 6),
        (6, "slow", SLOW, 40),
        (6, "fast", FAST, 40),
    ]
]


def replayed(text: str, schedule: Schedule, records: int) -> dict[str, list]:
    names = [iri.removeprefix(SERVICE) for iri in definition.read(text).windows]
    assert set(names) <= set(SENSORS)
    return citybench.replayed(names, schedule, records)


@pytest.fixture(scope="module")
def static(tmp_path_factory) -> list[Path]:
    """What the queries name as `http://127.0.0.1:9000/…`."""
    folder = tmp_path_factory.mktemp("citybench")
    return [citybench.sensor_repository(folder), citybench.cultural_events()]


@pytest.fixture(scope="module")
def touched() -> rdflib.Graph:
    return citybench.touched(SENSORS)


@pytest.fixture(scope="module")
def background(static) -> Background:
    return Background.from_files(static)


def test_the_mapping_of_a_record() -> None:
    """The first row of a road of 2065 m: one vehicle, 52 km/h, 141 s."""
    (triples,) = citybench.replayed(["AarhusTrafficData158505"], SLOW, 1).values()
    assert len(triples) == 5 * 4
    values = [o for _, _, p, o in triples if p.value.endswith("hasValue")]
    assert sorted(float(value.value) for value in values) == sorted(
        [1.0, 52.0, 141.0, 2065 / 52, 1 / 2065]
    )


@pytest.mark.parametrize(("number", "schedule", "records"), CASES)
def test_the_queries_equal_the_definition(number, schedule, records, static, touched) -> None:
    text = citybench.query(number)
    streams = replayed(text, schedule, records)
    found = {
        window.end: Counter(definition.canonical(row.items()) for row in window.solutions)
        for window in dyknow.evaluate(text, streams, static=static)
    }
    assert_not_idle(found.values())
    assert found == dict(definition.evaluate(text, streams, touched))


@pytest.mark.parametrize(("number", "schedule", "records"), CASES)
def test_the_queries_equal_oxigraph(number, schedule, records, background) -> None:
    text = citybench.query(number)
    streams = replayed(text, schedule, records)
    columns = solved(text, streams, background)
    assert_not_idle(columns.values())
    assert columns == solved(text, streams, background, oxigraph=True)


@pytest.mark.parametrize("number", [1, 3, 6])
@pytest.mark.parametrize("window", ["range 5s step 2s", "range 1500ms step 500ms"])
def test_streams_with_different_windows(number, window, static, touched) -> None:
    """Not as it is: the second stream has another window than the first."""
    first, found, rest = re.split(r"(\[range[^]]*\])", citybench.query(number), maxsplit=1)
    text = first + found + re.sub(r"\[range[^]]*\]", f"[{window}]", rest)
    assert len(set(definition.read(text).windows.values())) == 2
    streams = replayed(text, SLOW, 20)
    answers = {
        answer.end: Counter(definition.canonical(row.items()) for row in answer.solutions)
        for answer in dyknow.evaluate(text, streams, static=static)
    }
    assert_not_idle(answers.values())
    assert answers == dict(definition.evaluate(text, streams, touched))


def solved(
    text: str, streams: Mapping[str, Sequence], background: Background, oxigraph: bool = False
) -> dict[int, Counter]:
    """The solutions of every window to the last digit; ``oxigraph``: by nothing but Oxigraph."""
    dictionary = TermDictionary()
    evaluator = ContinuousEvaluator(parse_query(text), dictionary, background, tuple(streams))
    assert evaluator._solver.execution is not None, "a query of CityBench is evaluated in columns"
    if oxigraph:
        evaluator._solver.execution = None
    for name, triples in streams.items():
        evaluator.push(name, from_terms(triples, dictionary))
    results = [result for name in streams for result in evaluator.end(name)]
    return {
        result.end: Counter(
            frozenset((name, str(term)) for name, term in row.items())
            for row in result.solutions.rows()
        )
        for result in results
    }


def assert_not_idle(windows: Iterable[Counter]) -> None:
    """A test that compares nothing with nothing would pass."""
    rows = [sum(window.values()) for window in windows]
    assert len(rows) >= 3
    assert sum(1 for count in rows if count) * 4 >= len(rows)
