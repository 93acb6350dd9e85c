"""CSRBench: weather observations whose windows RDFox has answered, and an evaluator on rdflib.

`data_NN.ttl` arrives whole at NN s; windows are ``[end - RANGE, end)`` from t0 = 0, which is how
the engines of the benchmark count. An answer file is a sequence of row sets, one a window with
rows (absolute times do not count). It is to be one contiguous run of our non-empty windows; here
more is asked and holds: the sequence of our non-empty windows *is* that sequence, set by set.
"""

from __future__ import annotations

import json
from collections import Counter
from functools import cache
from itertools import groupby

import pyoxigraph
import pytest
import rdflib
import rdflib_definition as definition
from shared_data import DATA, needs

import dyknow

FOLDER = DATA / "csrbench"
pytestmark = needs(FOLDER)

STREAM = "http://knoesis.wright.edu/ssw/stream"
SECOND = 1_000_000_000
PREFIXES = """
PREFIX om-owl: <http://knoesis.wright.edu/ssw/ont/sensor-observation.owl#>
PREFIX weather: <http://knoesis.wright.edu/ssw/ont/weather.owl#>
"""
HOT = """?obs om-owl:observedProperty weather:_AirTemperature ; om-owl:procedure ?sensor ;
    om-owl:result ?res . ?res om-owl:floatValue ?value . FILTER(?value > 80)"""
HUMID = """?obs om-owl:observedProperty weather:_RelativeHumidity ; om-owl:procedure ?sensor ;
    om-owl:result ?res . ?res om-owl:floatValue ?value . FILTER(?value < 49) FILTER(?value > 24)"""


def text(head: str, window: str, where: str, after: str = "") -> str:
    return (
        f"REGISTER QUERY q AS {PREFIXES} SELECT {head} FROM STREAM <{STREAM}> [{window}] "
        f"WHERE {{ {where} }} {after}"
    )


@cache
def observations() -> tuple:
    """Every triple of file NN at NN s."""
    files = sorted((FOLDER / "data").glob("data_*.ttl"))
    assert len(files) == 34
    return tuple(
        (int(file.stem.removeprefix("data_")) * SECOND, t.subject, t.predicate, t.object)
        for file in files
        for t in pyoxigraph.parse(path=str(file))
    )


def reference(number: int) -> list[Counter]:
    """The row sets of an answer file, in order; a relation is one row."""
    answers = json.loads((FOLDER / "answers" / f"rdfox-answer-{number}.json").read_text())
    rows = [row for one in answers["relations"] for row in one["results"]["bindings"]]
    return [
        Counter(
            definition.canonical((n, term(t)) for n, t in row["binding"].items()) for row in group
        )
        for _, group in groupby(rows, key=lambda row: row["timestamp"])
    ]


def term(json_term: dict) -> object:
    if json_term["type"] == "uri":
        return rdflib.URIRef(json_term["value"])
    return rdflib.Literal(json_term["value"], datatype=json_term["datatype"])


def answered(query: str, triples: tuple, bounds: str = "[)") -> dict[int, Counter]:
    found = dyknow.evaluate(query, {STREAM: triples}, bounds=bounds, origin=0)
    return {
        window.end: Counter(definition.canonical(row.items()) for row in window.solutions)
        for window in found
    }


@pytest.mark.parametrize(
    ("number", "query", "windows"),
    [
        (1, text("?sensor ?obs", "RANGE 10s STEP 10s", HOT), 3),
        (3, text("?sensor ?obs ?value", "RANGE 4s STEP 4s", HUMID), 6),
        (5, text("?sensor ?obs", "RANGE 5s STEP 1s", HOT), 26),
    ],
)
def test_the_reference_answers_are_reproduced(number, query, windows) -> None:
    wanted = reference(number)
    assert len(wanted) == windows
    found = [rows for rows in answered(query, observations()).values() if rows]
    assert found == wanted


OTHERS = {
    "two sensors that differ by more than 30 degrees": text(
        "?one ?other ?v1 ?v2",
        "RANGE 2s STEP 2s",
        """?o1 om-owl:observedProperty weather:_AirTemperature ; om-owl:procedure ?one ;
            om-owl:result ?r1 . ?r1 om-owl:floatValue ?v1 .
        ?o2 om-owl:observedProperty weather:_AirTemperature ; om-owl:procedure ?other ;
            om-owl:result ?r2 . ?r2 om-owl:floatValue ?v2 . FILTER(?v1 - ?v2 > 30)""",
    ),
    "warm and humid at one sensor": text(
        "?sensor ?warm ?humid",
        "RANGE 5s STEP 5s",
        """?o1 om-owl:observedProperty weather:_AirTemperature ; om-owl:procedure ?sensor ;
            om-owl:result ?r1 . ?r1 om-owl:floatValue ?warm .
        ?o2 om-owl:observedProperty weather:_RelativeHumidity ; om-owl:procedure ?sensor ;
            om-owl:result ?r2 . ?r2 om-owl:floatValue ?humid .
        FILTER(?warm > 65 && ?humid > 70)""",
    ),
    "one sensor twice, changed": text(
        "?sensor ?o1 ?o2",
        "RANGE 6s STEP 3s",
        """?o1 om-owl:observedProperty weather:_AirTemperature ; om-owl:procedure ?sensor ;
            om-owl:result ?r1 . ?r1 om-owl:floatValue ?v1 .
        ?o2 om-owl:observedProperty weather:_AirTemperature ; om-owl:procedure ?sensor ;
            om-owl:result ?r2 . ?r2 om-owl:floatValue ?v2 . FILTER(?v2 != ?v1)""",
    ),
    "average temperature": text(
        "(AVG(?value) AS ?average)",
        "RANGE 4s STEP 4s",
        """?obs om-owl:observedProperty weather:_AirTemperature ; om-owl:result ?res .
        ?res om-owl:floatValue ?value""",
    ),
    "average humidity of a sensor above 80": text(
        "?sensor (AVG(?value) AS ?average) (COUNT(?value) AS ?n)",
        "RANGE 7s STEP 3s",
        """?obs om-owl:observedProperty weather:_RelativeHumidity ; om-owl:procedure ?sensor ;
            om-owl:result ?res . ?res om-owl:floatValue ?value""",
        "GROUP BY ?sensor HAVING (AVG(?value) > 80)",
    ),
    "temperature without humidity, OPTIONAL": text(
        "?sensor ?obs",
        "RANGE 3s STEP 1s",
        """?obs om-owl:observedProperty weather:_AirTemperature ; om-owl:procedure ?sensor .
        OPTIONAL { ?other om-owl:observedProperty weather:_RelativeHumidity ;
            om-owl:procedure ?sensor } FILTER(!BOUND(?other))""",
    ),
    "temperature without humidity, NOT EXISTS": text(
        "?sensor ?obs",
        "RANGE 3s STEP 1s",
        """?obs om-owl:observedProperty weather:_AirTemperature ; om-owl:procedure ?sensor .
        FILTER NOT EXISTS { ?other om-owl:observedProperty weather:_RelativeHumidity ;
            om-owl:procedure ?sensor }""",
    ),
    "temperature without humidity, MINUS": text(
        "?sensor ?obs",
        "RANGE 3s STEP 1s",
        """?obs om-owl:observedProperty weather:_AirTemperature ; om-owl:procedure ?sensor .
        MINUS { ?other om-owl:observedProperty weather:_RelativeHumidity ;
            om-owl:procedure ?sensor }""",
    ),
}


@pytest.mark.parametrize("bounds", ["[)", "(]"])
@pytest.mark.parametrize("name", OTHERS)
def test_other_queries_equal_the_definition(name, bounds) -> None:
    # rdflib joins by nested loops, so it is given the first quarter of the recording.
    triples = tuple(item for item in observations() if item[0] < 8 * SECOND)
    wanted = dict(
        definition.evaluate(OTHERS[name], {STREAM: triples}, rdflib.Graph(), bounds=bounds)
    )
    assert sum(1 for rows in wanted.values() if rows) * 4 >= len(wanted)
    assert answered(OTHERS[name], triples, bounds) == wanted
