"""A small pane folded in one compiled call equals the pane folded in several."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dyknow.continuous.columns.exact_sums import FloatTotals
from dyknow.continuous.columns.fold_kernels import Groups, RowFold
from dyknow.streams.jit import JIT

GREAT = 2.0**960
SIZE = 12
values = st.one_of(
    st.sampled_from([0.0, -0.0, 0.1, 2.5, 1e300, -1e300, 5e-324, 2.0**-1000, 1e16, 2.0**959]),
    st.floats(-1e6, 1e6),
    st.floats(allow_nan=True, allow_infinity=True),
)
panes = st.lists(
    st.lists(st.tuples(st.integers(0, SIZE - 1), values), min_size=1, max_size=20), max_size=8
)
masks = st.none() | st.lists(st.booleans(), min_size=SIZE, max_size=SIZE)


def groups() -> Groups:
    found = Groups()
    found.reach(SIZE)
    return found


@given(panes, st.integers(1, 4), masks, st.booleans())
@np.errstate(all="ignore")
def test_a_pane_at_once_is_a_pane_in_several_calls(found, length, mask, extremes) -> None:
    quick, slow, mine, wanted = FloatTotals(), FloatTotals(), groups(), groups()
    kept: list[list] = [[], []]
    of = None if mask is None else np.array(mask, np.bool_)
    for pane in found:
        subjects = np.array([subject for subject, _ in pane], np.int32)
        numbers = np.array([value for _, value in pane])
        fold = RowFold(np.dtype(np.float64), extremes)
        fold.add(subjects, numbers, None, wanted)
        at, columns = fold.take(wanted.used)
        at = np.arange(wanted.used, dtype=np.int32) if at is None else at
        at, columns = at[columns[1] > 0], columns[:, columns[1] > 0]
        slow.reserve(wanted.used)
        slow.add(at, columns[0], columns[1], 1)
        one = quick.fold_pane(subjects, numbers, GREAT, mine, extremes=extremes)
        assert (one is None) == (not JIT or not bool((np.abs(numbers) < GREAT).all()))
        if one is None:
            mine.groups(subjects)
            quick.reserve(mine.used)
            quick.add(at, columns[0], columns[1], 1)
            one = at, columns
        assert np.array_equal(one[0], at)
        assert np.array_equal(one[1], columns, equal_nan=True)
        assert np.array_equal(mine.members[: mine.used], wanted.members[: wanted.used])
        for totals, panes, pane in ((quick, kept[0], one), (slow, kept[1], (at, columns))):
            panes.append(pane)
            if len(panes) > length:
                at, columns = panes.pop(0)
                totals.add(at, columns[0], columns[1], -1)
        some = slow.counts[: wanted.used] > 0
        rows = np.flatnonzero(some if of is None else some & of[: wanted.used])
        present = quick.present(mine.used, None if of is None else of[: mine.used])
        assert np.array_equal(present[0], rows)
        assert present[1].tobytes() == slow.values(rows).tobytes()
        assert np.array_equal(present[2], slow.counts[rows])
