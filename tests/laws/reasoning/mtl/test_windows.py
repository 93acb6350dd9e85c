"""The least and the greatest in intervals of states, by rows and by queues, are those of Python."""

from __future__ import annotations

import random

import numpy as np
import pytest

from dyknow.reasoning.mtl import windows


@pytest.mark.parametrize("columns", [1, 3, 15, 16, 17, 100, 3000])
@pytest.mark.parametrize("rows", [0, 1, 2, 13, 70])
def test_least_and_greatest(monkeypatch: pytest.MonkeyPatch, columns: int, rows: int) -> None:
    draw = random.Random(columns * 1000 + rows)
    # Some columns at a time, also where the last ones are fewer.
    monkeypatch.setattr(windows, "_CELLS", draw.choice([1, 1000, 1 << 15]))
    values = [-1, 0, 1, 2, 5, 9, int(windows.NEVER)]
    moments = np.array(draw.choices(values, k=rows * columns), np.int64).reshape(rows, columns)
    first = np.array(sorted(draw.randint(0, rows) for _ in range(rows)), np.int64)
    last = np.array(sorted(draw.randint(0, rows) for _ in range(rows)), np.int64)
    least = windows.least(moments, first, last)
    greatest = windows.greatest(moments, first, last)
    for row, (begin, end) in enumerate(zip(first.tolist(), last.tolist(), strict=True)):
        if begin >= end:
            assert (least[row] == windows.NEVER).all()
            assert (greatest[row] < 0).all()
        else:
            assert least[row].tolist() == moments[begin:end].min(axis=0).tolist()
            assert greatest[row].tolist() == moments[begin:end].max(axis=0).tolist()


@pytest.mark.parametrize("columns", [1, 3, 16, 100])
def test_margins(columns: int) -> None:
    draw = random.Random(columns)
    rows = 50
    drawn = [draw.choice([-np.inf, -2.5, 0.0, 1.0, np.inf]) for _ in range(rows * columns)]
    left = np.array(drawn).reshape(rows, columns)
    first = np.array(sorted(draw.randint(0, rows) for _ in range(rows)), np.int64)
    last = np.array(sorted(draw.randint(0, rows) for _ in range(rows)), np.int64)
    least = windows.least(left, first, last)
    greatest = windows.greatest(left, first, last)
    for row, (begin, end) in enumerate(zip(first.tolist(), last.tolist(), strict=True)):
        part = left[begin:end]
        assert least[row].tolist() == part.min(axis=0, initial=np.inf).tolist()
        assert greatest[row].tolist() == part.max(axis=0, initial=-np.inf).tolist()
