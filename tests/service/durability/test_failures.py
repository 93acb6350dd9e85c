"""What fails again and again is told once, and that it works when it does for a while."""

from __future__ import annotations

import pytest

from dyknow.service.durability.failure_log import CALM, MOST_REASONS, Failures


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def events(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.msg["event"] for record in caplog.records]  # type: ignore[index]


def test_what_flaps_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    clock = Clock()
    failures = Failures(clock)
    for _ in range(5):
        failures.failed("journal", "no room")
        failures.worked("journal")
        clock.now += CALM / 2
        failures.review()
    assert events(caplog) == ["journal failed"]
    clock.now += CALM / 2
    failures.review()
    failures.review()
    assert events(caplog) == ["journal failed", "journal works again"]
    failures.failed("journal", "no room")
    assert events(caplog)[2:] == ["journal failed"]


def test_what_has_not_worked_since_is_not_said_to(caplog: pytest.LogCaptureFixture) -> None:
    clock = Clock()
    failures = Failures(clock)
    failures.worked("journal")
    failures.failed("journal", "no room")
    clock.now += 10 * CALM
    failures.review()
    assert events(caplog) == ["journal failed"]


def test_each_reason_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    failures = Failures(Clock())
    for reason in ("no room", "the disk fails", "no room"):
        failures.failed("journal", reason)
    failures.failed("checkpoint", "no room")
    told = [(r.msg["event"], r.msg["reason"]) for r in caplog.records]  # type: ignore[index]
    assert told == [
        ("journal failed", "no room"),
        ("journal failed", "the disk fails"),
        ("checkpoint failed", "no room"),
    ]


def test_reasons_that_are_never_the_same_are_not_told_without_end(
    caplog: pytest.LogCaptureFixture,
) -> None:
    failures = Failures(Clock())
    for number in range(3 * MOST_REASONS):
        failures.failed("checkpoint", f"no room for object {number}")
    assert len(caplog.records) == MOST_REASONS
