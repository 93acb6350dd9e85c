"""Patterns have the matches that Esper 9 finds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from esper import ANY, ENDING_WITHOUT_D, NEXT, WITHOUT_D, Esper, NoEsper
from pattern_data import batches, data, sequence

from dyknow.reasoning.patterns.plans.plan import PatternPlan, Selection
from dyknow.reasoning.patterns.plans.rows import Rows
from dyknow.reasoning.patterns.recognition.choice import evaluator_of

COUNT = 20_000
"""Events. What Esper counts among 100,000 is in `pattern_data`."""


@pytest.fixture(scope="module")
def esper(tmp_path_factory: pytest.TempPathFactory) -> Esper:
    try:
        return Esper(tmp_path_factory.mktemp("esper"))
    except NoEsper as error:
        pytest.skip(str(error))


def found(plan: PatternPlan, rows: Rows) -> np.ndarray:
    running = evaluator_of(plan)
    parts = [running.push(part).rows for part in batches(rows, 1000)]
    matches = np.concatenate(parts)
    return matches[np.lexsort(matches.T[::-1])]


@pytest.mark.parametrize("keys", [10, 100, 300])
def test_any_match(esper: Esper, keys: int) -> None:
    rows = data(COUNT, keys)
    theirs = esper.run(ANY, rows, 3).rows
    assert len(theirs) > 100
    assert np.array_equal(found(sequence("ABC"), rows), theirs)


@pytest.mark.parametrize("keys", [10, 100, 300])
def test_next_match(esper: Esper, keys: int) -> None:
    rows = data(COUNT, keys)
    theirs = esper.run(NEXT, rows, 3).rows
    assert len(theirs) > 100
    plan = replace(sequence("ABC"), selection=Selection.NEXT_MATCH)
    assert np.array_equal(found(plan, rows), theirs)


def test_negation(esper: Esper) -> None:
    rows = data(COUNT, 100)
    theirs = esper.run(WITHOUT_D, rows, 2).rows
    assert len(theirs) > 1000
    assert np.array_equal(found(sequence("A~DC"), rows), theirs)


def test_negation_at_the_end(esper: Esper) -> None:
    rows = data(COUNT, 100)
    theirs = esper.run(ENDING_WITHOUT_D, rows, 1).rows
    assert len(theirs) > 500
    assert np.array_equal(found(sequence("A~D"), rows), theirs)
