"""What fails again and again is told once, and that it works when it does for a while."""

from __future__ import annotations

import pytest

from dyknow.service.durability.failure_log import MOST_REASONS, QUIET_PERIOD, FailureLog


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def events(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.msg["event"] for record in caplog.records]  # type: ignore[index]


def test_what_flaps_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    clock = Clock()
    failures = FailureLog(clock)
    for _ in range(5):
        failures.report("journal", "no room")
        failures.report_success("journal")
        clock.now += QUIET_PERIOD / 2
        failures.review()
    assert events(caplog) == ["journal failed"]
    clock.now += QUIET_PERIOD / 2
    failures.review()
    failures.review()
    assert events(caplog) == ["journal failed", "journal works again"]
    failures.report("journal", "no room")
    assert events(caplog)[2:] == ["journal failed"]


def test_what_has_not_worked_since_is_not_said_to(caplog: pytest.LogCaptureFixture) -> None:
    clock = Clock()
    failures = FailureLog(clock)
    failures.report_success("journal")
    failures.report("journal", "no room")
    clock.now += 10 * QUIET_PERIOD
    failures.review()
    assert events(caplog) == ["journal failed"]


def test_each_reason_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    failures = FailureLog(Clock())
    for reason in ("no room", "the disk fails", "no room"):
        failures.report("journal", reason)
    failures.report("checkpoint", "no room")
    told = [(r.msg["event"], r.msg["reason"]) for r in caplog.records]  # type: ignore[index]
    assert told == [
        ("journal failed", "no room"),
        ("journal failed", "the disk fails"),
        ("checkpoint failed", "no room"),
    ]


def test_reasons_that_are_never_the_same_are_not_told_without_end(
    caplog: pytest.LogCaptureFixture,
) -> None:
    failures = FailureLog(Clock())
    for number in range(3 * MOST_REASONS):
        failures.report("checkpoint", f"no room for object {number}")
    assert len(caplog.records) == MOST_REASONS
