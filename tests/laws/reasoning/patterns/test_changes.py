"""The values before are those of the definition, however the rows are cut into batches."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow.languages.mtl.checked import Kind
from dyknow.reasoning.patterns.plans.plan import NO_VALUE
from dyknow.reasoning.patterns.plans.query import Argument, Part, Source, SourceColumn
from dyknow.reasoning.patterns.plans.rows import Rows
from dyknow.reasoning.patterns.recognition.changes import Changes

KINDS = ("P", "Q", "R", "E")
OBJECTS = {"P": 1, "Q": 2, "R": 0, "E": 1}
"""P and R have numbers, Q truths; of E there are no changes."""
NAMES = {"P": "number", "Q": "truth", "R": "number", "E": "number"}


def source(kind: str) -> Source:
    of = Kind(NAMES[kind])
    columns = [SourceColumn(f"x{i}", Part.OBJECT, argument=i) for i in range(OBJECTS[kind])]
    columns.append(SourceColumn(of, Part.VALUE, of))
    if kind != "E":
        columns.append(SourceColumn(f"{of} before", Part.BEFORE, of))
    return Source(kind, f"urn:{kind}", (Argument(),) * 2, tuple(columns))


Row = tuple[str, int, tuple[int, ...], float]


def drawn(draw: Random) -> list[Row | int]:
    """Rows, most of them in order, and watermarks."""
    time, steps = 0, []
    for _ in range(draw.choice([5, 40, 200])):
        time += draw.choice([0, 0, 1, 2])
        if draw.random() < 0.05:
            steps.append(time + draw.randint(-2, 2))
            continue
        kind = draw.choice(KINDS)
        objects = tuple(draw.choice([0, 1, 2**40, -(2**62)]) for _ in range(OBJECTS[kind]))
        value = draw.choice([0, 1]) if kind == "Q" else draw.choice([-0.5, 2.5, 1e300])
        steps.append((kind, time - draw.choice([0] * 9 + [2]), objects, value))
    return steps


def definition(steps: list[Row | int]) -> tuple[list[tuple[Row, float | None]], int]:
    """Each row that is not late with the value before, and the number of late ones: look at all
    rows that came before."""
    taken: list[Row] = []
    found, late, watermark = [], 0, None
    for step in steps:
        if isinstance(step, int):
            watermark = step if watermark is None else max(watermark, step)
            continue
        kind, end, objects, _ = step
        if watermark is not None and end < watermark:
            late += 1
            continue
        watermark = end if watermark is None else max(watermark, end)
        same = [each[3] for each in taken if (each[0], each[2]) == (kind, objects)]
        found.append((step, same[-1] if same and kind != "E" else None))
        taken.append(step)
    return found, late


def rows_of(batch: list[Row], kinds: tuple[str, ...]) -> Rows:
    ends = np.array([each[1] for each in batch], np.int64)
    columns = {
        f"x{i}": np.array([(*each[2], NO_VALUE, NO_VALUE)[i] for each in batch], np.int64)
        for i in range(2)
    }
    numbers = [np.nan if each[0] == "Q" else each[3] for each in batch]
    columns["number"] = np.array(numbers, np.float64)
    truths = [each[3] if each[0] == "Q" else NO_VALUE for each in batch]
    columns["truth"] = np.array(truths, np.int64)
    kind = np.array([kinds.index(each[0]) for each in batch], np.int64)
    return Rows(kinds, kind, ends, ends, columns)


def read(rows: Rows) -> list[tuple[Row, float | None]]:
    found = []
    for i in range(len(rows)):
        kind = rows.kinds[rows.kind[i]]
        objects = tuple(int(rows.columns[f"x{k}"][i]) for k in range(OBJECTS[kind]))
        value = rows.columns[NAMES[kind]][i].item()
        before = rows.columns.get(f"{NAMES[kind]} before")
        known = None if before is None else before[i].item()
        is_missing = known is None or known == NO_VALUE or known != known
        row = (kind, int(rows.end[i]), objects, value)
        found.append((row, None if is_missing else known))
    return found


@settings(deadline=None)
@given(st.integers(0, 2**32))
def test_values_before(seed: int) -> None:
    draw = Random(seed)
    steps = drawn(draw)
    wanted, late = definition(steps)
    sources = [source(each) for each in KINDS]
    changes = Changes(sources, capacity=8)
    cut = draw.choice([0.01, 0.2, 1.0])
    found, batch = [], []
    for step in [*steps, 10**6]:
        is_row = not isinstance(step, int)
        if is_row:
            batch.append(step)
        if not is_row or draw.random() < cut:
            found += read(changes.push(rows_of(batch, tuple(draw.sample(KINDS, 4)))))
            batch = []
        if not is_row:
            changes.advance(step)
        if draw.random() < 0.1:
            state = pickle.loads(pickle.dumps(changes.state()))
            changes = Changes(sources, capacity=8)
            changes.restore(state)
    assert found == wanted
    assert changes.late == late
    assert changes.unstored == 0


@settings(deadline=None)
@given(st.integers(0, 2**32))
def test_objects_beyond_the_limit_have_no_value_before(seed: int) -> None:
    draw = Random(seed)
    rows = [("P", 0, (draw.randint(0, 20),), float(i)) for i in range(60)]
    changes = Changes([source("P")], most_keys=5, capacity=8)
    known = list(dict.fromkeys(objects for _, _, objects, _ in rows))[:5]
    wanted = [(row, before if row[2] in known else None) for row, before in definition(rows)[0]]
    assert read(changes.push(rows_of(rows, KINDS))) == wanted
    assert changes.unstored == sum(objects not in known for _, _, objects, _ in rows)


def test_many_objects_take_little_memory() -> None:
    changes = Changes([source("P")])
    count = 100_000
    rows = [("P", 0, (i,), 1.0) for i in range(count)]
    changes.push(rows_of(rows, KINDS))
    assert changes.size <= 4 * 8 * 3 * (count + 4096)


def test_without_sources_of_changes_only_late_rows_are_left_out() -> None:
    changes = Changes([source("E")])
    rows: list[Row] = [("E", 2, (1,), 1.0), ("E", 1, (1,), 2.5), ("P", 3, (1,), 2.5)]
    assert [row for row, _ in read(changes.push(rows_of(rows, KINDS)))] == [rows[0], rows[2]]
    assert changes.late == 1
    assert not len(changes.push(rows_of([], KINDS)))


@pytest.mark.usefixtures("interpreted")
@pytest.mark.parametrize("law", [test_values_before])
def test_loops_that_are_not_compiled(law: Callable[[int], None]) -> None:
    for seed in range(12):
        law.hypothesis.inner_test(seed)  # type: ignore[attr-defined]
