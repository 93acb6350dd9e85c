"""Times and durations: texts and nanoseconds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow.streams.time import (
    DAY,
    SECOND,
    TIME_MAX,
    TIME_MIN,
    format_duration,
    format_time,
    parse_duration,
    parse_time,
    read_time,
)
from dyknow.streams.time_arithmetic import later

LIMITS = settings(deadline=None, max_examples=200)


@given(st.integers(TIME_MIN, TIME_MAX))
@LIMITS
def test_times_come_back(time):
    assert parse_time(format_time(time)) == time
    assert parse_time(time) == time
    assert read_time(format_time(time)) == read_time(f" {time}") == time


@given(st.integers(TIME_MIN // SECOND + 1, TIME_MAX // SECOND - 1), st.sampled_from([10**3, 10**6]))
@LIMITS
def test_only_the_digits_needed(seconds, part):
    assert "." not in format_time(seconds * SECOND)
    assert not format_time(seconds * SECOND + part).endswith("0Z")


@given(st.integers(0, TIME_MAX))
@LIMITS
def test_durations_come_back(duration):
    assert parse_duration(format_duration(duration)) == duration


@pytest.mark.parametrize(
    ("text", "time"),
    [
        ("1970-01-01T00:00:00Z", 0),
        ("1970-01-01T00:00Z", 0),
        ("1970-01-01 01:00:00+01:00", 0),
        ("1970-01-01T00:00:00-0130", 5400 * SECOND),
        ("1969-12-31T23:59:59.5Z", -SECOND // 2),
        ("2021-10-07T19:12:53,123456789", 1_633_633_973_123_456_789),
        ("1677-09-21T00:12:43.145224192Z", TIME_MIN),
        ("2262-04-11T23:47:16.854775807Z", TIME_MAX),
    ],
)
def test_times(text, time):
    assert parse_time(text) == time


@pytest.mark.parametrize(
    "value",
    [
        "",
        "now",
        "2021-10-07",
        "2021-13-01T00:00:00Z",
        "2021-02-30T00:00:00Z",
        "2021-01-01T25:00:00Z",
        "2262-04-11T23:47:16.854775808Z",
        "0001-01-01T00:00:00+01:00",
        "9999-12-31T23:59:59-01:00",
        2**63,
        True,
    ],
)
def test_what_is_no_time(value):
    with pytest.raises(ValueError, match=r"time|64-bit|range|month|day|hour|second"):
        parse_time(value)


@pytest.mark.parametrize(
    ("text", "duration"),
    [
        ("5s", 5 * SECOND),
        (" 100 ms ", SECOND // 10),
        ("1.5h", 5400 * SECOND),
        ("1min", 60 * SECOND),
        ("PT5S", 5 * SECOND),
        ("P1DT0.5S", DAY + SECOND // 2),
    ],
)
def test_durations(text, duration):
    assert parse_duration(text) == duration


@pytest.mark.parametrize("text", ["", "5", "s", "-5s", "P", "PT", "0.5ns", "5 weeks", "300000d"])
def test_what_is_no_duration(text):
    with pytest.raises(ValueError, match=r"duration|nanosecond"):
        parse_duration(text)


def test_nothing_finer_than_a_nanosecond_is_cut_silently():
    with pytest.raises(ValueError, match="finer than a nanosecond"):
        parse_time("2021-10-07T19:12:53.1234567891Z")
    assert parse_time("2021-10-07T19:12:53.1234567890000Z") == 1_633_633_973_123_456_789
    assert parse_time("2021-10-07T19:12:53.1234567899Z", cut=True) == 1_633_633_973_123_456_789


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("2021-10-07T19:12:53+24:00", "is no time: write ISO-8601"),
        ("2021-10-07T19:12:53+10:60", "is no time: write ISO-8601"),
        ("٢٠٢١-10-07T19:12:53Z", "is no time: write ISO-8601"),
        ("2021-13-07T19:12:53Z", "month"),
        ("9" * 5000, "outside signed 64-bit nanoseconds"),
        ("9999-12-31T00:00:00Z", "outside signed 64-bit nanoseconds"),
    ],
)
def test_what_is_no_time_is_told_in_plain_words(text, said):
    with pytest.raises(ValueError, match=said) as caught:
        read_time(text)
    for word in ("isoformat", "timedelta", "digits) for integer"):
        assert word not in str(caught.value)
    assert len(str(caught.value)) < 300


def test_an_integer_of_thousands_of_digits_is_no_time():
    with pytest.raises(ValueError, match="the number is outside signed 64-bit"):
        parse_time(10**5000)


@given(
    st.lists(st.integers(TIME_MIN, TIME_MAX), max_size=4),
    st.one_of(st.integers(0, 2**66), st.sampled_from([2**63 - 1, 2**63, 2**64 - 1, 2**64])),
)
@LIMITS
def test_sums_stop_at_the_end_of_time(times: list[int], duration: int) -> None:
    found = later(np.array(times, np.int64), duration)
    assert found.tolist() == [min(TIME_MAX, time + duration) for time in times]
