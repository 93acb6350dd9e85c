"""The patterns that the papers on SASE and SASE+ print find what their texts mean."""

from __future__ import annotations

from collections import Counter
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sase_definition import Event, matches
from sase_papers import PRINTED, Printed
from sase_running import run, wanted_of
from vocabularies import vocabulary_of

from dyknow.languages.sase import CheckedPattern, check_sase, parse_sase
from dyknow.rdf.namespaces import DYKNOW
from dyknow.streams.time import MINUTE

SEEDS = st.integers(0, 2**32)
MOST = 9
"""Events: of any match with repetition each set of them may be one."""


def checked(printed: Printed) -> CheckedPattern:
    types = vocabulary_of("".join(f"dyknow:{each} a owl:Class .\n" for each in printed.fields))
    text = printed.text + printed.limit
    return check_sase(parse_sase(text), text, types)


@pytest.mark.parametrize("name", PRINTED)
@settings(deadline=None, max_examples=200)
@given(seed=SEEDS)
def test_it_finds_what_it_means(name: str, seed: int) -> None:
    printed, draw = PRINTED[name], Random(seed)
    pattern, events = checked(printed), printed.events(draw, draw.randint(1, MOST))
    wanted = wanted_of(events, matches(pattern.text, events, printed.texts))
    assert run(pattern, printed.kinds, events, draw) == Counter(wanted)


@pytest.mark.parametrize("name", PRINTED)
def test_random_events_have_matches(name: str) -> None:
    printed, draw = PRINTED[name], Random(1)
    pattern = checked(printed)
    found = [matches(pattern.text, printed.events(draw, MOST), printed.texts) for _ in range(100)]
    assert sum(map(bool, found)) >= 10


def test_a_trend_of_volume_whose_last_event_may_end_or_prolong_it() -> None:
    """An event that suits both parts is taken as either: the run of the first events ends with the
    sixth, and goes on with it to the eighth."""
    prices = [100, 120, 120, 121, 120, 125, 120, 120]
    volumes = [1010, 990, 1005, 999, 999, 750, 950, 700]
    events = [
        Event(
            i,
            "Stock",
            i * MINUTE,
            {"symbol": "goog", "price": float(p), "volume": float(v), "id": f"<{DYKNOW}o1>"},
        )
        for i, (p, v) in enumerate(zip(prices, volumes, strict=True))
    ]
    printed = PRINTED["volume"]
    found = run(checked(printed), printed.kinds, events, Random(1))
    parts = [(first // MINUTE, last // MINUTE, len(rising)) for first, last, rising, _ in found]
    assert sorted(parts) == [(0, 5, 5), (0, 7, 7), (2, 5, 2)]
    assert set(found.values()) == {1}
