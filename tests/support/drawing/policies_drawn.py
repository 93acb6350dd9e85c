"""Random policies, over few times, so that these meet."""

from hypothesis import strategies as st

from dyknow.streams.policies.policy import (
    AnyChange,
    AnyUpdate,
    Approximation,
    ChangeBy,
    Duration,
    Order,
    Policy,
    SampleEvery,
)


@st.composite
def policies(draw: st.DrawFn, base: int = 0) -> Policy:
    change = draw(
        st.sampled_from(
            [
                *(AnyUpdate(), AnyChange(), ChangeBy(1), ChangeBy(1.5), ChangeBy(3)),
                *(SampleEvery(1), SampleEvery(5), SampleEvery(10)),
            ]
        )
    )
    delay = draw(st.sampled_from([None, 0, 1, 3, 8, 50]))
    start = draw(st.sampled_from([None, 0, 5, 10]))
    end = draw(st.sampled_from([None, 15, 30]))
    order = draw(st.sampled_from(list(Order)))
    duration = Duration(
        None if start is None else base + start,
        None if end is None else base + end,
        to_oo=end is None and draw(st.booleans()),
    )
    recent = Approximation.MOST_RECENT
    if isinstance(change, SampleEvery) and duration.is_complete and delay is not None:
        approximation = draw(st.sampled_from([Approximation.NONE, recent, recent]))
    else:
        approximation = Approximation.NONE
    return Policy(change, delay, duration, order, approximation)
