"""Kernels: compiled code, its Python twin and the numpy route give the same bits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow.continuous.columns import fold_kernels
from dyknow.continuous.columns.fold_kernels import Groups, RowFold, ascending

rows = st.lists(
    st.tuples(
        st.integers(0, 400),
        st.floats(allow_nan=False, allow_infinity=False, width=32),
        st.booleans(),
    ),
    max_size=80,
)


def folded(rows, dtype, masked: bool, jit: bool, cut: int, extremes: bool):
    groups = Groups()
    groups.reach(512)
    fold = RowFold(np.dtype(dtype), extremes)
    before, fold_kernels.JIT = fold_kernels.JIT, jit
    try:
        for part in (rows[:cut], rows[cut:]):
            subjects = np.array([r[0] for r in part], np.int32)
            with np.errstate(invalid="ignore"):
                values = np.array([r[1] for r in part], np.float64).clip(-1e9, 1e9).astype(dtype)
            skip = np.array([r[2] for r in part], np.bool_) if masked else None
            fold.add(subjects, values, skip, groups)
    finally:
        fold_kernels.JIT = before
    at, state = fold.take(groups.used)
    _, nothing = fold.take(groups.used)
    assert not nothing[1].any()
    at = np.arange(groups.used) if at is None else at
    return groups.members[: groups.used].tolist(), at.tolist(), state.tobytes()


@settings(deadline=None, max_examples=80)
@given(
    rows,
    st.sampled_from([np.float64, np.int64]),
    st.booleans(),
    st.integers(0, 80),
    st.booleans(),
)
def test_the_compiled_kernel_equals_the_numpy_route_however_cut(
    rows, dtype, masked, cut, extremes
) -> None:
    compiled = folded(rows, dtype, masked, True, cut, extremes)
    assert compiled == folded(rows, dtype, masked, False, 0, extremes)


@pytest.mark.parametrize("width", [2, 4])
def test_the_twin_equals_the_compiled_kernel_over_many_groups(width: int) -> None:
    random = np.random.default_rng(3)
    subjects = random.integers(0, 3000, 10_000).astype(np.int32)
    values, skip = random.normal(size=10_000), random.random(10_000) < 0.5
    values[::100] = np.nan
    compiled = [fold_kernels._folds[np.dtype(np.float64), layout] for layout in ("C", "A")]
    found = []
    for run in (*compiled, compiled[0].py_func):
        group_of, members = np.full(3000, -1, np.int32), np.zeros(3000, np.int32)
        state, touched = np.zeros((3000, width)), np.zeros(3001, np.int32)
        row, used, count = run(
            subjects, values, skip, 0, group_of, members, 0, state, touched, 0, True, -0.0
        )
        assert row == len(subjects)
        found.append((used, members.tolist(), touched[:count].tolist(), state.tobytes()))
    assert found[0] == found[1] == found[2]


def test_few_touched_groups_are_given_alone() -> None:
    groups, fold = Groups(), RowFold(np.dtype(np.int64), True)
    groups.reach(1000)
    fold.add(np.arange(1000, dtype=np.int32), np.arange(1000), None, groups)
    at, columns = fold.take(groups.used)
    assert at is None
    assert columns[:, 7].tolist() == [7, 1, 7, -8]
    fold.add(np.array([9, 3, 9], np.int32), np.array([5, 1, 2]), None, groups)
    at, columns = fold.take(groups.used)
    assert at is not None
    assert at.tolist() == [3, 9]
    assert columns.T.tolist() == [[1, 1, 1, -2], [7, 2, 2, -6]]


def test_read_only_and_strided_columns_are_taken() -> None:
    groups, fold = Groups(), RowFold(np.dtype(np.float64), True)
    groups.reach(4)
    subjects = np.arange(8, dtype=np.int32)[::2] % 3
    values = np.frombuffer(np.ones(4).tobytes())
    fold.add(subjects[::-1], values, None, groups)
    fold.add(subjects, np.broadcast_to(np.float64(1), 4), None, groups)
    _, columns = fold.take(groups.used)
    assert columns[:2].sum() == 16


@pytest.mark.parametrize("size", [0, 1, 5000])
def test_ascending(size: int) -> None:
    times = np.arange(size, dtype=np.int64)
    assert ascending(times)
    if size > 1:
        times[-1] = 0
        assert not ascending(times)
