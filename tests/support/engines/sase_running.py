"""SASE+ patterns at work on events, for tests."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from random import Random
from typing import Any

import numpy as np
from sase_definition import Event, Match
from sase_patterns import rows_of

from dyknow.languages.mtl.checked import Kind
from dyknow.languages.sase import CheckedPattern
from dyknow.reasoning.patterns.compilation.sase_plans import sase_query
from dyknow.reasoning.patterns.plans.plan import NO_VALUE
from dyknow.reasoning.patterns.plans.query import Keys, PatternQuery, with_numbers
from dyknow.reasoning.patterns.plans.rows import Matches
from dyknow.reasoning.patterns.recognition.choice import evaluator_of

Kinds = Mapping[tuple[str, str], Kind]


def run(checked: CheckedPattern, kinds: Kinds, events: list[Event], draw: Random) -> Counter[Any]:
    """The results of a pattern over events, in random batches."""
    query, keys = sase_query(checked, kinds), Keys()
    running = evaluator_of(with_numbers(query.plans[0], keys), capacity=8)
    found: list[tuple[Any, ...]] = []
    cut = draw.choice([1, 2, 5, len(events)])
    for start in range(0, len(events), cut):
        batch = events[start : start + cut]
        found += _results(query, keys, running.push(rows_of(query, keys, batch, draw)))
        if draw.random() < 0.2:
            found += _results(query, keys, running.advance(batch[-1].time))
    return Counter(found + _results(query, keys, running.end()))


def wanted_of(events: list[Event], found: list[Match]) -> list[tuple[Any, ...]]:
    """What `run` gives for the matches of the definition."""
    times = {event.number: event.time for event in events}
    return [
        (times[each.events[0][0]], times[each.events[-1][-1]], *map(_plain, each.results))
        for each in found
    ]


def _results(query: PatternQuery, keys: Keys, found: Matches) -> list[tuple[Any, ...]]:
    columns = [
        [_value(value, result.kind, keys) for value in found.outputs[result.name]]
        for result in query.results
    ]
    starts, ends = (found.outputs[name].tolist() for name in ("start", "end"))
    return list(zip(starts, ends, *columns, strict=True))


def _value(value: Any, kind: Kind, keys: Keys) -> Any:
    if isinstance(value, np.ndarray):
        return tuple(_value(each, kind, keys) for each in value)
    if value == NO_VALUE or (isinstance(value, float) and math.isnan(value)):
        return None
    match kind:
        case Kind.TEXT:
            return keys.key(int(value))[1:]
        case Kind.OBJECT:
            return keys.key(int(value))
        case _:
            return float(value)


def _plain(value: Any) -> Any:
    return float(value) if isinstance(value, int | float) else value
