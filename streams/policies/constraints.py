"""Constraints of a policy that one sample or two consecutive ones break ([DyKnow10 Def. 5.37]).

Plain Python on one sample at a time: for proofs, not for streams.
"""

from __future__ import annotations

from typing import Any

from ..sample import Content
from .policy import AnyChange, ChangeBy, Constraint, Order, Policy


def alone(available: int, valid: int, policy: Policy) -> tuple[Constraint, str] | None:
    """The constraints that a sample breaks by itself."""
    duration = policy.duration
    if not duration.first <= valid <= duration.last:
        return Constraint.DURATION, f"valid at {valid}, outside the duration"
    if policy.max_delay is not None and available - valid > policy.max_delay:
        delay = available - valid
        return Constraint.DELAY, f"delay {delay} of the sample valid at {valid} is too long"
    return None


def after(
    available: int, content: Content, next_available: int, then: Content, policy: Policy
) -> tuple[Constraint, str] | None:
    """The constraints that two consecutive samples break."""
    if next_available < available:
        return Constraint.AVAILABLE, f"available at {next_available}, before {available}"
    step = then[0] - content[0]
    if policy.period is not None and step != policy.period:
        return Constraint.PERIOD, f"valid at {then[0]}, {step} after the one before"
    if policy.order is not Order.ANY and (step < 0 or (step == 0 and policy.order is Order.STRICT)):
        return Constraint.ORDER, f"valid at {then[0]} after one valid at {content[0]}"
    if isinstance(policy.change, AnyChange) and content == then:
        return Constraint.CHANGE, f"the sample valid at {then[0]} repeats the one before"
    if isinstance(policy.change, ChangeBy):
        difference = policy.change.difference
        if not any(differs(*pair, difference) for pair in zip(content[1:], then[1:], strict=True)):
            said = f"no number of the sample valid at {then[0]} differs by {difference:g}"
            return Constraint.CHANGE_BY, f"{said} from the one before"
    return None


def differs(value: Any, then: Any, difference: float) -> bool:
    """Whether two values of a field differ by at least ``difference``: numbers, or a number and
    no_value. Other values do not."""
    numbers = [isinstance(each, int | float) for each in (value, then)]
    if isinstance(value, bool) or isinstance(then, bool):
        return False
    return abs(value - then) >= difference if all(numbers) else any(numbers)
