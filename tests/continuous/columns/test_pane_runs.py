"""Runs of panes against their definition: a run's values are those of its cells."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow.continuous.columns.pane_runs import PaneRuns


@settings(deadline=None)
@given(st.integers(1, 12), st.integers(1, 3), st.data())
def test_a_run_is_its_panes(panes, groups, data):
    spans = st.tuples(st.integers(0, panes - 1), st.integers(1, panes)).map(
        lambda each: (each[0], min(panes, each[0] + each[1]))
    )
    low, high = (
        np.array(each) for each in zip(*data.draw(st.lists(spans, min_size=1)), strict=True)
    )
    values = data.draw(
        st.lists(st.integers(-9, 9), min_size=panes * groups, max_size=panes * groups)
    )
    cells = np.array(values, np.int64)
    table = cells.reshape(panes, groups)
    runs = PaneRuns(panes, groups, low, high)
    size = len(low) * groups
    chosen = data.draw(st.lists(st.booleans(), min_size=size, max_size=size))
    some = np.array(chosen, np.bool_).reshape(-1, groups)
    rows, at = np.nonzero(some)
    slices = [table[low[row] : high[row], group] for row, group in zip(rows, at, strict=True)]
    sums = [int(each.sum()) for each in slices]
    assert runs.sums(cells)[rows, at].tolist() == sums
    assert runs.differences(cells[np.newaxis], some).tolist() == [sums]
    ends = np.stack([cells, ~cells], axis=1)
    wanted = [[int(each.min()), int((~each).min())] for each in slices]
    assert runs.least(ends, rows, at).tolist() == wanted
