"""Steps of a law cut into batches, with checkpoints between them."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from random import Random
from typing import Any

import numpy as np
from pattern_definition import Match, Row, Step, Watermark
from pattern_drawing import rows_of

from dyknow.reasoning.patterns.evaluation.evaluator import Evaluator
from dyknow.reasoning.patterns.plans.plan import NO_VALUE
from dyknow.reasoning.patterns.plans.rows import Matches

Found = list[tuple[tuple[int, ...], int, tuple[Any, ...]]]


def check_parts(
    make: Callable[[], Evaluator],
    running: Evaluator,
    wanted: list[Match],
    steps: list[Step],
    draw: Random,
) -> None:
    """Each part decides what is wanted of its steps; nothing is lost. ``make`` gives an evaluator
    for a checkpoint."""
    done = 0
    for until, part in parts_of(steps, draw):
        if draw.random() < 0.1:
            state = pickle.loads(pickle.dumps(running.state()))
            running = make()
            running.restore(state)
        elif draw.random() < 0.05:
            running = pickle.loads(pickle.dumps(running))
        result = running.advance(part) if isinstance(part, int) else running.push(rows_of(part))
        decided = [each for each in wanted if done <= each.step < until]
        assert found_in(result) == wanted_of(decided)
        done = until
        due = running.next_due()
        assert (due is None) == (running.pending == 0)
    counters = running.counters
    assert (counters.unstored, counters.crowded, counters.cut_short) == (0,) * 3
    assert (counters.unawaited, counters.unstarted) == (0, 0)


def found_in(result: Matches) -> Found:
    outputs = [[_value(x) for x in column.tolist()] for column in result.outputs.values()]
    rows = [tuple(row) for row in result.rows.tolist()]
    values = list(zip(*outputs, strict=True)) if outputs else [()] * len(rows)
    return list(zip(rows, result.decided.tolist(), values, strict=True))


def _value(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return tuple(map(_value, value.tolist()))
    is_missing = value == NO_VALUE or (isinstance(value, float) and math.isnan(value))
    return None if is_missing else value


def wanted_of(wanted: list[Match]) -> Found:
    return [(each.rows, each.decided, each.outputs) for each in wanted]


def parts_of(steps: list[Step], draw: Random) -> list[tuple[int, list[Row] | int]]:
    """Batches of rows, and watermarks, each with the number of steps up to its end."""
    parts: list[tuple[int, list[Row] | int]] = []
    batch: list[Row] = []
    cut = draw.choice([0.0, 0.2, 0.5, 1.0])
    for place, step in enumerate(steps):
        if isinstance(step, Watermark):
            parts += [(place, batch)] if batch else []
            parts.append((place + 1, step.time))
            batch = []
        else:
            batch.append(step)
            if draw.random() < cut:
                parts.append((place + 1, batch))
                batch = []
    return [*parts, (len(steps), batch)] if batch else parts
