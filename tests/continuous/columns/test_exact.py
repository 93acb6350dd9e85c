"""Exact sums: what is added and taken away leaves nothing, in any order, compiled or not."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow.continuous.columns import exact_sums
from dyknow.continuous.columns.exact_sums import FloatTotals, IntegerTotals

finite = st.one_of(
    st.floats(-1e6, 1e6),
    st.floats(allow_nan=False, allow_infinity=False, max_value=1e300, min_value=-1e300),
    st.sampled_from([0.1, 1e16, -1e16, 3.0, 1e-17, 150.25]),
).map(lambda x: 0.0 if 0 < abs(x) < 1e-280 else x)
rows = st.lists(st.tuples(st.integers(0, 5), finite), max_size=30)


def totals(rows, jit: bool, taken=()) -> FloatTotals:
    before, exact_sums.JIT = exact_sums.JIT, jit
    try:
        made = FloatTotals()
        made.reserve(6)
        for part, sign in ((rows, 1), (taken, 1), (taken, -1)):
            at = np.array([r[0] for r in part], np.int32)
            made.add(at, np.array([r[1] for r in part], np.float64), None, sign)
        return made
    finally:
        exact_sums.JIT = before


def sums(made: FloatTotals, jit: bool = True) -> bytes:
    before, exact_sums.JIT = exact_sums.JIT, jit
    try:
        return made.values(np.arange(6)).tobytes()
    finally:
        exact_sums.JIT = before


@settings(deadline=None, max_examples=200)
@given(rows, rows)
def test_a_sum_is_the_exact_sum_rounded_and_what_left_leaves_no_trace(rows, taken) -> None:
    found = np.frombuffer(sums(totals(rows, True, taken)))
    for group in range(6):
        wanted = sum((Fraction(v) for g, v in rows if g == group), Fraction(0))
        nearest = float(wanted)
        assert abs(found[group] - nearest) <= math.ulp(nearest)


@settings(deadline=None, max_examples=200)
@given(rows, rows, st.randoms())
def test_order_and_history_change_no_bit_and_the_twin_agrees(rows, taken, random) -> None:
    wanted = sums(totals(rows, True))
    shuffled = random.sample(rows, len(rows))
    assert sums(totals(shuffled, True, taken)) == wanted
    assert sums(totals(shuffled, False, taken), False) == wanted


@settings(deadline=None, max_examples=60)
@given(st.lists(finite, min_size=600, max_size=600), st.booleans())
def test_all_groups_at_once_are_as_one_by_one(values, jit) -> None:
    array, numbers = np.array(values), np.arange(600.0)
    found = []
    before, exact_sums.JIT = exact_sums.JIT, jit
    try:
        for at in (None, np.arange(600, dtype=np.int32)):
            made = FloatTotals()
            made.reserve(600)
            made.add(at, array, numbers, 1)
            found.append((made.values(np.arange(600)).tobytes(), made.counts[:600].tolist()))
            made.add(at, array, numbers, -1)
            assert not made.digits.any()
    finally:
        exact_sums.JIT = before
    assert found[0] == found[1]
    assert found[0][0] == (array + 0.0).tobytes()


@pytest.mark.parametrize("jit", [True, False])
def test_infinities_and_nan_are_counted(jit: bool) -> None:
    odd = [(0, math.inf), (1, math.nan), (2, math.inf), (2, -math.inf), (3, -math.inf), (4, 2.5)]
    made = totals([*odd, (0, 1.0)], jit)
    assert str(made.values(np.arange(6)).tolist()) == "[inf, nan, nan, -inf, 2.5, 0.0]"
    made.add(np.array([0], np.int32), np.array([math.inf]), None, -1)
    assert made.values(np.arange(1)).tolist() == [1.0]


def test_carries_are_settled_before_a_digit_overflows(monkeypatch) -> None:
    monkeypatch.setattr(exact_sums, "_TERMS", 4)
    values = [0.1, 1e8, -3.75, 1e15] * 50
    made = FloatTotals()
    made.reserve(1)
    for value in values:
        made.add(np.zeros(3, np.int32), np.full(3, value), None, 1)
    assert made.values(np.arange(1))[0] == float(3 * sum(map(Fraction, values)))
    made.keep(np.arange(1))
    assert made.values(np.arange(1))[0] == float(3 * sum(map(Fraction, values)))


@settings(deadline=None, max_examples=100)
@given(st.lists(st.tuples(st.integers(0, 3), st.integers(-(2**63), 2**63 - 1)), max_size=20))
def test_integers_are_exact_at_any_size(rows) -> None:
    made = IntegerTotals()
    made.reserve(4)
    at = np.array([r[0] for r in rows], np.int32)
    made.add(at, np.array([r[1] for r in rows], np.int64), None, 1)
    wanted = [sum(v for g, v in rows if g == group) for group in range(4)]
    assert [int(x) for x in made.values(np.arange(4))] == wanted
