"""What `publish` takes: times of several kinds, and DataFrames; what is not clear is refused."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import pytest

from dyknow.service.client.client import BadTime, Client
from dyknow.service.client.samples import ndjson

NOON = datetime(2021, 10, 7, 12, 0, 0, 250_001, tzinfo=UTC)
NOON_NS = 1_633_608_000_250_001_000


@pytest.fixture
def speeds(client: Client) -> Client:
    client.put_stream("s", {"id": "string", "v": "float"})
    return client


def row(valid: Any, **more: Any) -> dict[str, Any]:
    return {"valid": valid, "available": valid, "id": "u", "v": 1.0, **more}


@pytest.mark.parametrize(
    ("given", "time"),
    [
        (NOON, NOON_NS),
        (NOON.astimezone(timezone(timedelta(hours=2))), NOON_NS),
        (datetime(1969, 12, 31, 23, 59, 59, 999_999, tzinfo=UTC), -1_000),
        (NOON_NS, NOON_NS),
        ("2021-10-07T12:00:00.250001Z", NOON_NS),
        # The nearest double is 238 ns away: its shortest text counts.
        (1_633_608_000.250001, NOON_NS),
        (0.1, 100_000_000),
        (-0.5, -500_000_000),
        (7, 7),
    ],
)
def test_times(speeds: Client, given: Any, time: int) -> None:
    assert speeds.publish("s", [row(given)]) == 1
    (sample,) = speeds.history("s", start=time, end=time)
    assert (sample["id"], sample["v"]) == ("u", 1.0)


def test_the_caller_keeps_its_rows(speeds: Client) -> None:
    rows = [row(NOON)]
    speeds.publish("s", rows)
    assert rows == [row(NOON)]


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (
            [row(1), row(NOON.replace(tzinfo=None))],
            ("row 2, 'valid'", "no time zone", "tzinfo=UTC"),
        ),
        ([row(1, available=NOON.replace(tzinfo=None))], ("row 1, 'available'",)),
        ([row(1.6336e18)], ("seconds since 1970", "int(")),
        ([row(float("nan"))], ("row 1, 'valid'", "nan")),
        ([row(float("inf"))], ("inf",)),
    ],
)
def test_a_time_that_is_not_clear(
    speeds: Client, rows: list[Mapping[str, Any]], words: tuple[str, ...]
) -> None:
    with pytest.raises(BadTime) as refused:
        speeds.publish("s", rows)
    assert all(word in str(refused.value) for word in words)
    assert speeds.stream("s")["counters"]["accepted"] == 0


def test_a_data_frame(speeds: Client) -> None:
    pandas = pytest.importorskip("pandas")
    texts = ["2021-10-07T12:00:00Z", "2021-10-07T12:00:01.000000001Z"]
    times = pandas.to_datetime(texts, format="ISO8601")
    frame = pandas.DataFrame({"id": ["a", None], "v": [1.5, float("nan")]}, index=times)
    assert speeds.publish("s", frame.assign(available=times)) == 2
    first, second = speeds.history("s")
    assert (first["valid"], first["id"], first["v"]) == ("2021-10-07T12:00:00Z", "a", 1.5)
    assert second["valid"] == second["available"] == "2021-10-07T12:00:01.000000001Z"
    assert (second["id"], second["v"]) == (None, None)


def test_a_data_frame_with_a_column_of_times(speeds: Client) -> None:
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({"valid": [0.5, 1.5], "id": ["a", "b"], "v": [1, 2]})
    assert speeds.publish("s", frame, stamp=True) == 2
    assert [sample["valid"] for sample in speeds.history("s")] == [
        "1970-01-01T00:00:00.5Z",
        "1970-01-01T00:00:01.5Z",
    ]
    assert frame.columns.tolist() == ["valid", "id", "v"]
    whole = pandas.DataFrame({"valid": [1], "n": [2], "b": [True], "t": ["x"]})
    assert ndjson(whole, False) == b'{"valid": 1, "n": 2, "b": true, "t": "x"}'
    assert ndjson(whole[:0], False) == b""


def test_a_data_frame_without_a_time_zone(speeds: Client) -> None:
    pandas = pytest.importorskip("pandas")
    times = pandas.to_datetime(["2021-10-07T12:00:00"])
    frame = pandas.DataFrame({"id": ["a"], "v": [1.0]}, index=times)
    with pytest.raises(BadTime, match=r"row 1, 'valid': .* has no time zone"):
        speeds.publish("s", frame)


@pytest.fixture
def followed(speeds: Client) -> Client:
    speeds.put_stream("t", {"n": "integer"})
    speeds.publish("s", [row(NOON), row(NOON + timedelta(seconds=1), v=2.5, id="w")])
    speeds.publish("t", [{"valid": 7, "available": 8, "n": 3}])
    speeds.end("s")
    speeds.end("t")
    return speeds


def test_events_as_a_data_frame(followed: Client) -> None:
    pandas = pytest.importorskip("pandas")
    frame = followed.events("s", since="start").to_pandas()
    assert frame.columns.tolist() == ["valid", "available", "id", "v"]
    assert frame["v"].tolist() == [1.0, 2.5]
    assert frame["id"].tolist() == ["u", "w"]
    assert frame["valid"].tolist() == [
        pandas.Timestamp(NOON_NS, tz="UTC"),
        pandas.Timestamp(NOON_NS + 10**9, tz="UTC"),
    ]
    both = followed.follow(["s", "t"], since="start").to_pandas()
    assert both.columns.tolist()[:3] == ["stream", "valid", "available"]
    assert sorted(both["stream"]) == ["s", "s", "t"]


def test_a_stream_that_goes_on_is_cut_by_a_limit(speeds: Client) -> None:
    pytest.importorskip("pandas")
    speeds.publish("s", [row(NOON + timedelta(seconds=i), v=float(i)) for i in range(5)])
    events = speeds.events("s", since="start")
    assert events.to_pandas(limit=2)["v"].tolist() == [0.0, 1.0]
    # It goes on where it stopped.
    assert next(events).values["v"] == 2.0
    events.close()
    assert list(events) == []


def test_a_stream_without_samples_is_an_empty_frame(speeds: Client) -> None:
    pytest.importorskip("pandas")
    speeds.end("s")
    assert len(speeds.events("s", since="start").to_pandas()) == 0


def test_without_pandas_it_says_what_to_install(
    followed: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'dyknow\[pandas\]'"):
        followed.events("s", since="start").to_pandas()
    assert followed.history("s")
