"""What a monitor reports over samples."""

from __future__ import annotations

import numpy as np

from dyknow.languages.mtl.ast import Interval, Report, Temporal
from dyknow.languages.mtl.checked import (
    And,
    Atom,
    CheckedMonitor,
    Constant,
    Kind,
    Not,
    ObjectVariable,
    Or,
    Previous,
    Reading,
    Truth,
    Within,
)
from dyknow.reasoning.mtl.monitoring import Monitoring
from dyknow.streams.policies.policy import AnyChange, SynchronizationPolicy

WIDE = "urn:Wide"


def rows_told(formula, report: Report, rows, *, once: bool = False) -> list[tuple]:
    """What is told of samples (time, object, p), each by itself, and their end: (available, object,
    start, value, last)."""
    policy = SynchronizationPolicy(AnyChange(), 0)
    monitor = CheckedMonitor("m", (("x0", WIDE),), formula, policy, report, once, None)
    monitoring = Monitoring(monitor, 1)
    found = []
    (term,) = monitoring.terms
    for time, name, value in rows:
        times, objects = np.array([time]), np.array([[name]], object)
        monitoring.came(0, times, times)
        monitoring.add(0, term, times, times, objects, np.array([value]))
        found.append(monitoring.advance(time))
        if monitoring.is_over:
            break
    else:
        monitoring.ended(0)
        found += [monitoring.advance(rows[-1][0] + 1), monitoring.finish(rows[-1][0] + 1)]
    return [
        told
        for each in found
        for told in zip(
            each.available.tolist(),
            *each.objects,
            each.valid.tolist(),
            each.value.tolist(),
            each.last.tolist(),
            strict=True,
        )
    ]


P = Atom(
    "=",
    Reading("urn:p", (ObjectVariable("x0"),), Kind.TRUTH, None),
    Constant(True, Kind.TRUTH),
)


def test_changes_before_the_first_state() -> None:
    rows = [(1, "a", True), (3, "b", False), (4, "a", False)]
    told = [told[1:] for told in rows_told(P, Report.CHANGES, rows)]
    assert sorted(told) == [("a", 1, 1, 1), ("a", 4, 0, 4), ("b", 3, 0, 3)]


def test_a_run_that_is_open_at_the_end_is_available_then() -> None:
    rows = [(1, "a", True), (1, "b", True), (4, "a", True), (5, "b", False)]
    assert rows_told(P, Report.CHANGES, rows) == [
        (6, "b", 1, 1, 1),
        (6, "a", 1, 1, 4),
        (6, "b", 5, 0, 5),
    ]


def test_a_run_is_known_with_those_before_it() -> None:
    never = Within(Temporal.EVENTUALLY, Interval(0, 9), Truth(False))
    rows = [(1, "a", True), (2, "a", False), (3, "a", False), (12, "a", False)]
    formula = Or(And(P, never), And(Not(P), Previous(P)))
    assert rows_told(formula, Report.CHANGES, rows) == [
        (13, "a", 1, 0, 1),
        (13, "a", 2, 1, 2),
        (13, "a", 3, 0, 12),
    ]


def test_a_single_start_is_a_run() -> None:
    rows = [(1, "a", True), (2, "a", False), (5, "b", False), (6, "b", True)]
    assert rows_told(P, Report.CHANGES, rows, once=True) == [(2, "a", 1, 1, 1), (6, "b", 5, 0, 5)]


def test_each_object_has_a_single_start() -> None:
    rows = [(1, "a", True), (2, "a", False), (5, "b", False), (6, "b", True)]
    assert rows_told(P, Report.VERDICTS, rows, once=True) == [(2, "a", 1, 1, 1), (6, "b", 5, 0, 5)]
