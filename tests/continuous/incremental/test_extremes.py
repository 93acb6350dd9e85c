"""Sliding extremes and distinct pairs, against recomputation from all panes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow.continuous.incremental import pair_index
from dyknow.continuous.incremental.pair_index import PairIndex
from dyknow.continuous.incremental.sliding_extremes import SlidingExtremes

pane = st.tuples(
    st.integers(1, 4),
    st.dictionaries(st.integers(0, 5), st.integers(-9, 9), max_size=6),
    st.booleans(),
)


@settings(deadline=None, max_examples=200)
@given(st.lists(pane, max_size=40), st.integers(1, 12), st.integers(1, 20))
def test_extremes_are_of_the_panes_in_the_window(panes, length, hint) -> None:
    sliding = SlidingExtremes(np.dtype(np.int64), hint)
    sliding.reserve(6)
    content, end = [], 0
    for gap, values, dense in panes:
        end += gap
        at = np.array(sorted(values), np.int32)
        ends = np.array([[values[g], -values[g]] for g in at.tolist()], np.int64).reshape(-1, 2)
        if dense:
            whole = np.full((6, 2), 2**63 - 1)
            whole[at] = ends
            at, ends = None, whole
        sliding.push(end, at, ends)
        content.append((end, values))
        sliding.evict(end - length)
        content = [(e, v) for e, v in content if e > end - length]
        found = sliding.ends(np.arange(6))
        for group in range(6):
            inside = [v[group] for _, v in content if group in v]
            wanted = [min(inside), -max(inside)] if inside else [2**63 - 1] * 2
            assert found[group].tolist() == wanted


def test_no_step_turns_the_whole_window_around() -> None:
    panes = 60
    sliding = SlidingExtremes(np.dtype(np.float64), panes)
    sliding.reserve(4)
    turned, at = [], np.array([1], np.int32)
    turn = sliding._prepare_front
    sliding._prepare_front = lambda n: (turned.append(min(n, len(sliding._middle))), turn(n))[1]
    for end in range(1, 400):
        sliding.push(end, at, np.array([[float(end), -end]]))
        sliding.evict(end - panes)
        assert sliding.ends(at).tolist() == [[max(1, end - panes + 1), -end]]
    assert max(turned) <= 2


pairs = st.lists(st.tuples(st.integers(0, 3), st.integers(-4, 4)), max_size=12)


@pytest.mark.parametrize("jit", [True, False])
@settings(deadline=None, max_examples=100)
@given(st.lists(st.tuples(st.integers(0, 3), pairs), max_size=30), st.integers(1, 9))
def test_pairs_come_once_and_leave_once(jit, panes, length) -> None:
    before = pair_index.JIT, pair_index._PANES
    # The numbers of panes begin anew after a few.
    pair_index.JIT, pair_index._PANES = jit, 10
    try:
        found, end, last = PairIndex(), 0, {}
        for gap, rows in panes:
            end += gap
            gone = found.leave(end - length)
            left = sorted(pair for pair, at in last.items() if at <= end - length)
            last = {pair: at for pair, at in last.items() if at > end - length}
            listed = [] if gone is None else zip(gone[0].tolist(), gone[1].tolist(), strict=True)
            assert sorted(listed) == left
            skip = [r[1] == 3 for r in rows]
            arrays = np.array([r[0] for r in rows], np.int32), np.array([r[1] for r in rows], int)
            came = [pair for pair, skipped in zip(rows, skip, strict=True) if not skipped]
            new = [
                i for i, pair in enumerate(rows) if not skip[i] and pair not in {*last, *rows[:i]}
            ]
            mask = np.array(skip, np.bool_) if any(skip) else None
            assert found.enter(end, arrays, mask).tolist() == new
            last.update(dict.fromkeys(came, end))
            assert found.holds(arrays).tolist() == [pair in last for pair in rows]
            assert not found.holds((arrays[0], arrays[1] + 100)).any()
    finally:
        pair_index.JIT, pair_index._PANES = before


def history(panes: int, most: int) -> list[object]:
    """What comes new and what leaves, pane by pane: few pairs, then many, then few."""
    found, out = PairIndex(), []
    random = np.random.default_rng(5)
    for end in range(panes):
        count = int(random.integers(0, most)) if panes // 6 < end < panes // 2 else most // 60
        subjects = random.integers(0, 40, count).astype(np.int32)
        bits = np.floor(random.uniform(0, 60, count)).view(np.int64)
        out.append(found.enter(end, (subjects, bits)).tolist())
        gone = found.leave(end - 7)
        listed = () if gone is None else zip(gone[0].tolist(), gone[1].tolist(), strict=True)
        out.append(sorted(listed))
    assert len(found._entries) <= 2 * 4096
    return out


def test_many_pairs_and_long_histories(monkeypatch) -> None:
    compiled = history(120, 2000)
    monkeypatch.setattr(pair_index, "JIT", False)
    assert compiled == history(120, 2000)


def test_the_loops_over_pairs_are_the_same_in_plain_python(monkeypatch) -> None:
    compiled = history(40, 600)
    for name in ("enter", "leave", "hold", "fill"):
        kernel = getattr(pair_index, f"_{name}_kernel")
        monkeypatch.setattr(pair_index, f"_{name}_kernel", kernel.py_func)
    with np.errstate(over="ignore"):
        assert compiled == history(40, 600)
