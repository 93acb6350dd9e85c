"""Counts that other systems give for the same events and patterns (`pattern_data`)."""

from __future__ import annotations

import pytest
from pattern_data import ANY_MATCHES, NEXT_MATCHES, WITHOUT_D, batches, data, sequence

from dyknow.reasoning.patterns.evaluation.all_rows import AllRows
from dyknow.reasoning.patterns.plans.plan import Selection
from dyknow.reasoning.patterns.sequences.next_rows import NextRows


@pytest.mark.parametrize("keys", ANY_MATCHES)
def test_any_match(keys: int) -> None:
    running = AllRows(sequence("ABC"))
    found = sum(len(running.push(part)) for part in batches(data(100_000, keys), 1000))
    assert found == ANY_MATCHES[keys]


@pytest.mark.parametrize("keys", NEXT_MATCHES)
def test_next_match(keys: int) -> None:
    running = NextRows(sequence("ABC", selection=Selection.NEXT_MATCH))
    found = sum(len(running.push(part)) for part in batches(data(100_000, keys), 1000))
    assert found == NEXT_MATCHES[keys]


def test_negation() -> None:
    running = AllRows(sequence("A~DC"))
    found = sum(len(running.push(part)) for part in batches(data(100_000, 100), 1000))
    assert found == WITHOUT_D
    assert running.pending == 0
