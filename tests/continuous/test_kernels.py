"""Kernels: compiled code, its Python twin and the numpy route give the same bits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow.continuous import kernels
from dyknow.continuous.kernels import Groups, ascending, fold_sums

rows = st.lists(
    st.tuples(
        st.integers(0, 400),
        st.floats(allow_nan=False, allow_infinity=False, width=32),
        st.booleans(),
    ),
    max_size=80,
)


def folded(rows, dtype, masked: bool, jit: bool, cut: int):
    groups = Groups()
    groups.reach(512)
    state = np.zeros((0, 2), dtype)
    before, kernels.JIT = kernels.JIT, jit
    try:
        for part in (rows[:cut], rows[cut:]):
            subjects = np.array([r[0] for r in part], np.int32)
            with np.errstate(invalid="ignore"):
                values = np.array([r[1] for r in part], np.float64).clip(-1e9, 1e9).astype(dtype)
            skip = np.array([r[2] for r in part], np.bool_) if masked else None
            state = fold_sums(subjects, values, skip, groups, state)
    finally:
        kernels.JIT = before
    used = groups.used
    return groups.members[:used].tolist(), state[:used].tolist()


@settings(deadline=None, max_examples=80)
@given(rows, st.sampled_from([np.float64, np.int64]), st.booleans(), st.integers(0, 80))
def test_the_compiled_kernel_equals_the_numpy_route_however_cut(rows, dtype, masked, cut) -> None:
    assert folded(rows, dtype, masked, True, cut) == folded(rows, dtype, masked, False, 0)


def test_the_twin_equals_the_compiled_kernel_over_many_groups() -> None:
    random = np.random.default_rng(3)
    subjects = random.integers(0, 3000, 10_000).astype(np.int32)
    values, skip = random.normal(size=10_000), random.random(10_000) < 0.5
    states = []
    for kernel in (kernels._fold_float_kernel, kernels._fold_float_kernel.py_func):
        group_of, members = np.full(3000, -1, np.int32), np.zeros(3000, np.int32)
        state = np.zeros((3000, 2))
        row, used = kernel(subjects, values, skip, 0, group_of, members, 0, state)
        assert row == len(subjects)
        states.append((used, members.tolist(), state.tobytes()))
    assert states[0] == states[1]


def test_read_only_and_strided_columns_are_taken() -> None:
    groups = Groups()
    groups.reach(4)
    subjects = np.arange(8, dtype=np.int32)[::2] % 3
    values = np.frombuffer(np.ones(4).tobytes())
    state = fold_sums(subjects[::-1], values, None, groups, np.zeros((0, 2)))
    assert state[: groups.used].sum() == 8


@pytest.mark.parametrize("size", [0, 1, 5000])
def test_ascending(size: int) -> None:
    times = np.arange(size, dtype=np.int64)
    assert ascending(times)
    if size > 1:
        times[-1] = 0
        assert not ascending(times)
