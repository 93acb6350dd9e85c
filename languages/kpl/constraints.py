"""Converts constraints to policies in ns ([DyKnow10 Def. 5.21-5.26, 5.37]).

Several constraints of a kind apply together, as the conjunction of Def. 5.37 states: the least
delay, the intersection of the durations, the strictest order, the change constraint that implies
the other.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, assert_never

from ...streams.policies.policy import (
    AnyChange,
    AnyUpdate,
    Approximation,
    Change,
    ChangeBy,
    Duration,
    Order,
    Policy,
    PolicyError,
    SampleEvery,
    SynchronizationPolicy,
)
from ...streams.time import (
    MICROSECOND,
    MILLISECOND,
    NANOSECOND,
    SECOND,
    TIME_MAX,
    TIME_MIN,
    parse_duration,
    parse_time,
)
from ..errors import LanguageError, Span
from . import ast

UNITS: Final = {"ns": NANOSECOND, "us": MICROSECOND, "ms": MILLISECOND, "s": SECOND}
"""The units of abstract integers (SPEC §1), in ns."""

_MOST_DIGITS: Final = 40
_ORDERS: Final = (Order.ANY, Order.MONOTONE, Order.STRICT)


@dataclass(frozen=True, slots=True)
class _Constraints:
    """The merged constraint of each kind, and the place of the approximation. ``change`` None: none
    was written."""

    change: Change | None
    max_delay: int | None
    duration: Duration
    order: Order
    approximation: Approximation
    approximation_span: Span | None


def to_policy(constraints: Sequence[ast.Constraint], source: str, unit: str) -> Policy:
    """Return the policy of these constraints (Def. 5.21). Raises `LanguageError`."""
    merged = _merge(constraints, source, unit)
    try:
        return Policy(
            merged.change or AnyUpdate(),
            merged.max_delay,
            merged.duration,
            merged.order,
            merged.approximation,
        )
    except PolicyError as error:
        assert merged.approximation_span is not None
        raise LanguageError(error.message, source, merged.approximation_span, error.hint) from None


def to_synchronization(
    constraints: Sequence[ast.Constraint], source: str, unit: str, span: Span
) -> SynchronizationPolicy:
    """Return the policy of a synchronization, which must state the times of the states. Raises
    `LanguageError`; at ``span`` if it does not."""
    merged = _merge(constraints, source, unit)
    if merged.change is None:
        raise LanguageError(
            "a synchronization needs the times of its states",
            source,
            span,
            "write `sync(a, b; sample every 100, max delay 50)` or `sync(a, b; any change)`",
        )
    if isinstance(merged.change, ChangeBy):
        raise LanguageError(
            "`change by` does not determine the times of states",
            source,
            span,
            "write `any change`, and read the states with the policy: `stream s = state with "
            "change by 10`",
        )
    return SynchronizationPolicy(
        merged.change, merged.max_delay, merged.duration, merged.order, merged.approximation
    )


def _merge(constraints: Sequence[ast.Constraint], source: str, unit: str) -> _Constraints:
    change: Change | None = None
    delays: list[int] = []
    durations: list[Duration] = []
    order = Order.ANY
    approximations: dict[Approximation, Span] = {}
    for constraint in constraints:
        match constraint:
            case ast.Change():
                change = _stronger(change, constraint, source, unit)
            case ast.Delay(time):
                delays += [] if time is None else [_delay(time, source, unit)]
            case ast.Duration(start, end, to_oo):
                first = None if start is None else time_point(start, source, unit)
                last = None if end is None else time_point(end, source, unit)
                durations.append(Duration(first, last, to_oo))
            case ast.Ordering():
                order = max(order, constraint.order, key=_ORDERS.index)
            case ast.Approximating():
                approximations.setdefault(constraint.approximation, constraint.span)
                if len(approximations) > 1:
                    raise LanguageError(
                        "the approximation constraints exclude each other",
                        source,
                        constraint.span,
                        "keep one of `no approximation` and `use most recent`",
                    )
            case _:
                assert_never(constraint)
    chosen = next(iter(approximations), Approximation.NONE)
    least = min(delays, default=None)
    span = approximations.get(chosen)
    return _Constraints(change, least, _intersection(durations), order, chosen, span)


def _stronger(change: Change | None, constraint: ast.Change, source: str, unit: str) -> Change:
    if constraint.difference is not None:
        return _larger(change, constraint, source)
    if constraint.period is not None:
        if isinstance(change, ChangeBy):
            raise _two_changes(constraint, source)
        period = duration(constraint.period, source, unit)
        if period <= 0:
            raise LanguageError(
                f"a sample period must be greater than 0, not {constraint.period.text}",
                source,
                constraint.period.span,
                "write for example `sample every 100`",
            )
        if isinstance(change, SampleEvery) and change.period != period:
            raise LanguageError(
                "two sample periods in one policy",
                source,
                constraint.span,
                "keep one: a policy has one period",
            )
        return SampleEvery(period)
    if constraint.kind == "any change":
        return change if isinstance(change, SampleEvery | ChangeBy) else AnyChange()
    return AnyUpdate() if change is None else change


def _larger(change: Change | None, constraint: ast.Change, source: str) -> ChangeBy:
    """Merge ``change by`` with the earlier change constraint; it implies ``any change``."""
    if isinstance(change, SampleEvery):
        raise _two_changes(constraint, source)
    try:
        wanted = ChangeBy(float(constraint.difference or ""))
    except ValueError as error:
        raise LanguageError(
            f"`change by {constraint.difference}` needs a difference greater than 0",
            source,
            constraint.span,
            error.hint
            if isinstance(error, PolicyError)
            else "write a number without a unit, it is in the unit of the feature: `change by 10`",
        ) from None
    if isinstance(change, ChangeBy):
        return max(change, wanted, key=lambda each: each.difference)
    return wanted


def _two_changes(constraint: ast.Change, source: str) -> LanguageError:
    return LanguageError(
        "`sample every` and `change by` in one policy",
        source,
        constraint.span,
        "keep one: `sample every` sends a sample each period, whether it differs or not",
    )


def _delay(time: ast.Time, source: str, unit: str) -> int:
    delay = duration(time, source, unit)
    if delay < 0:
        raise LanguageError(
            f"a delay is not negative, got {time.text}",
            source,
            time.span,
            "a sample may be available at its valid time at the earliest: `max delay 0`",
        )
    return delay


def _intersection(durations: Sequence[Duration]) -> Duration:
    starts = [d.start for d in durations if d.start is not None]
    ends = [d.end for d in durations if d.end is not None]
    to_oo = not ends and any(d.to_oo for d in durations)
    return Duration(max(starts, default=None), min(ends, default=None), to_oo)


# -- times -------------------------------------------------------------------------------------

_ABSTRACT = re.compile(r"[+-]?\d+\Z")
_TIME_POINT = re.compile(r"\d{4}-")


def duration(time: ast.Time, source: str, unit: str) -> int:
    """Return a duration in ns: an integer in ``unit``, or a number with its own unit."""
    if _TIME_POINT.match(time.text):
        raise LanguageError(
            "expected a duration, found a point in time",
            source,
            time.span,
            "write an integer, or a number with a unit: `200`, `1.5s`",
        )
    return _nanoseconds(time, source, unit)


def time_point(time: ast.Time, source: str, unit: str) -> int:
    """Return a time in ns since 1970: an integer in ``unit``, a number with its own unit, or
    ISO-8601."""
    if not _TIME_POINT.match(time.text):
        return _nanoseconds(time, source, unit)
    try:
        return parse_time(time.text)
    except ValueError as error:
        raise LanguageError(
            f"`{time.text}` is not a point in time",
            source,
            time.span,
            "times are 64-bit nanoseconds: years 1678 to 2262"
            if "outside" in str(error)
            else "a second has at most nine digits: times are in nanoseconds"
            if "finer" in str(error)
            else "write ISO-8601: 2021-10-07T19:12:53.5Z",
        ) from None


def _nanoseconds(time: ast.Time, source: str, unit: str) -> int:
    def refused(message: str, hint: str) -> LanguageError:
        return LanguageError(message, source, time.span, hint)

    text = time.text
    digits = text.lstrip("+-")
    sign = -1 if text.startswith("-") else 1
    too_long = refused(
        f"`{text}` exceeds 64 bits of nanoseconds"
        if len(text) <= _MOST_DIGITS
        else "this exceeds 64 bits of nanoseconds",
        f"integers are in {unit} here; times reach {TIME_MAX // UNITS[unit]} {unit}",
    )
    if len(text) > _MOST_DIGITS:
        raise too_long
    if _ABSTRACT.match(text):
        total = sign * int(digits) * UNITS[unit]
    elif digits[-1].isdigit():
        raise refused(
            f"`{text}` is not an integer", "a fraction of a time needs a unit of its own: `1.5s`"
        )
    else:
        try:
            total = sign * parse_duration(digits)
        except ValueError as error:
            if "finer" in str(error):
                raise refused(
                    f"`{text}` is finer than a nanosecond", "times are whole nanoseconds"
                ) from None
            if "outside" in str(error):
                # The least time has no positive counterpart in 64 bits.
                if text.startswith("-") and digits == f"{-TIME_MIN}ns":
                    return TIME_MIN
                raise too_long from None
            raise refused(
                f"`{text}` is not a time", "units are ns, us, ms, s, m, h and d: `200ms`, `1.5s`"
            ) from None
    if not TIME_MIN <= total <= TIME_MAX:
        raise too_long
    return total
