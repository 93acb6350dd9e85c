"""The last pane of each distinct pair, which windows in bulk read."""

import numpy as np
import pytest

from dyknow.continuous.incremental import pair_index
from dyknow.continuous.incremental.pair_index import PairIndex


@pytest.mark.parametrize("jit", [pair_index.JIT, False])
def test_a_pair_belongs_to_the_last_pane_in_which_it_came(
    jit: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pair_index, "JIT", jit)
    index = PairIndex()
    assert [len(column) for column in index.last_panes()] == [0, 0, 0]
    for end, subjects in ((10, [1, 2, 1]), (20, [2]), (40, [3])):
        keys = np.array([7 * subject for subject in subjects], np.int64)
        index.enter(end, (np.array(subjects, np.int32), keys))
    found = {(s, k, e) for s, k, e in zip(*map(np.ndarray.tolist, index.last_panes()), strict=True)}
    assert found == {(1, 7, 10), (2, 14, 20), (3, 21, 40)}
    index.leave(10)
    assert sorted(index.last_panes()[2].tolist()) == [20, 40]
