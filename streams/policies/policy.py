"""Fluent stream policies as frozen data ([DyKnow10 Def. 5.21-5.26], SPEC §1).

A policy constrains a stream; it holds no state and knows no text. `adaptation` makes a stream
satisfy one online, `satisfaction` has the definitions, `languages/kpl` reads and prints policies.
Times and durations are ns; intervals are closed (Def. 5.37).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from math import inf
from typing import Final, TypeAlias

from ..time import TIME_MAX, TIME_MIN

GRID_LIMIT: Final = 10_000_000
"""More of a grid than this at once is refused: a period or a time is mistaken."""


class PolicyError(ValueError):
    """Constraints that make no policy; ``hint`` says how to correct them."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


@dataclass(frozen=True, slots=True)
class AnyUpdate:
    """``any update``: a new sample is update enough (Def. 5.22); the default."""


@dataclass(frozen=True, slots=True)
class AnyChange:
    """``any change``: consecutive samples differ in value or valid time."""


@dataclass(frozen=True, slots=True)
class ChangeBy:
    """``change by d``: some number differs from the last one sent by at least ``difference``, in
    the unit of its field ([DyKnow10 §4.3.1]); a number that comes or goes differs, too."""

    difference: float

    def __post_init__(self) -> None:
        if not 0 < self.difference < inf:
            raise PolicyError(
                f"a change is by more than nothing, not {self.difference}",
                "write for example `change by 10`, or `any change`",
            )


@dataclass(frozen=True, slots=True)
class SampleEvery:
    """``sample every t``: valid times of consecutive samples differ by exactly ``period`` ns."""

    period: int

    def __post_init__(self) -> None:
        if not 0 < self.period <= TIME_MAX:
            raise PolicyError(
                f"a sample period is longer than nothing, not {self.period}",
                "write for example `sample every 100`",
            )


Change: TypeAlias = AnyUpdate | AnyChange | ChangeBy | SampleEvery


@dataclass(frozen=True, slots=True)
class Duration:
    """Def. 5.24 on valid times: ``from start to end``, ``from start``, ``to end``, unrestricted.

    ``start`` None: no ``from`` was given. ``end`` None: no end; ``to_oo`` tells the written
    ``to oo``, which makes the duration complete, from no ``to`` at all.
    """

    start: int | None = None
    end: int | None = None
    to_oo: bool = False

    def __post_init__(self) -> None:
        if self.to_oo and self.end is not None:
            raise PolicyError("a duration ends at a time or at `oo`, not at both")

    @property
    def is_complete(self) -> bool:
        """Whether both ``from`` and ``to`` were given (Def. 5.26 asks for it)."""
        return self.start is not None and (self.end is not None or self.to_oo)

    @property
    def first(self) -> int:
        """The least valid time that is permitted."""
        return TIME_MIN if self.start is None else self.start

    @property
    def last(self) -> int:
        """The greatest valid time that is permitted."""
        return TIME_MAX if self.end is None else self.end


class Order(StrEnum):
    """Def. 5.25: how valid times of consecutive samples relate."""

    ANY = "any order"
    MONOTONE = "monotone order"
    STRICT = "strict order"


class Approximation(StrEnum):
    """Def. 5.26: whether samples may be added that the process did not make."""

    NONE = "no approximation"
    MOST_RECENT = "use most recent"


@dataclass(frozen=True, slots=True)
class Policy:
    """One constraint of each kind (Def. 5.21); what is left out is the default of its kind.

    ``max_delay`` None is ``max delay oo``. Raises `PolicyError` where Def. 5.26 does not allow
    ``use most recent``, which needs ``sample every``, ``from .. to ..`` and ``max delay``.
    """

    change: Change = field(default_factory=AnyUpdate)
    max_delay: int | None = None
    duration: Duration = field(default_factory=Duration)
    order: Order = Order.ANY
    approximation: Approximation = Approximation.NONE

    def __post_init__(self) -> None:
        if self.max_delay is not None and not 0 <= self.max_delay <= TIME_MAX:
            raise PolicyError(f"a delay is not negative, got {self.max_delay}")
        if self.approximation is Approximation.MOST_RECENT:
            missing = [
                text
                for text, given in (
                    ("`sample every t`", isinstance(self.change, SampleEvery)),
                    ("`from a to b`", self.duration.is_complete),
                    ("`max delay t`", self.max_delay is not None),
                )
                if not given
            ]
            if missing:
                raise PolicyError(
                    f"`use most recent` needs {' and '.join(missing)} as well (Def. 5.26)",
                    "it must be known for which valid times a sample is made, and when to stop "
                    "waiting for it",
                )

    @property
    def period(self) -> int | None:
        """The sample period in ns; None without ``sample every``."""
        return self.change.period if isinstance(self.change, SampleEvery) else None

    @property
    def effective_order(self) -> Order:
        """The order that holds: ``sample every`` implies strict order (Def. 5.24)."""
        return Order.STRICT if isinstance(self.change, SampleEvery) else self.order

    @property
    def is_default(self) -> bool:
        """Whether every stream satisfies it as it is."""
        return self == Policy()


@dataclass(frozen=True, slots=True)
class SynchronizationPolicy:
    """Constraints on the states of several streams ([DyKnow10 §5.4, §7.4], SPEC §1).

    ``change``: a state every period, or (anything else) whenever some input has a sample.
    ``max_delay`` None waits for ever; otherwise a state leaves at the latest that long after its
    time. ``order`` other than any says that the inputs are monotone: a later sample then decides.
    Every combination has a meaning, so nothing is refused.
    """

    change: Change = field(default_factory=AnyChange)
    max_delay: int | None = None
    duration: Duration = field(default_factory=Duration)
    order: Order = Order.ANY
    approximation: Approximation = Approximation.NONE

    @property
    def period(self) -> int | None:
        """The time between states in ns; None where the inputs' samples make them."""
        return self.change.period if isinstance(self.change, SampleEvery) else None


class Constraint(StrEnum):
    """The constraint that a sample or a stream breaks."""

    CHANGE = "any change"
    PERIOD = "sample every"
    DELAY = "max delay"
    DURATION = "duration"
    ORDER = "order"
    AVAILABLE = "available time"
    """No available time is left at which the sample could be sent: they are unique (Def. 4.1)."""
    CHANGE_BY = "change by"


@dataclass(slots=True)
class PolicyCounters:
    """Counts of the samples of one subscription.

    Law: received = kept + the sum of ``dropped`` + pending, where without approximation ``kept``
    samples are those sent, and ``delayed`` of them were sent later than they came. With ``use most
    recent`` ``kept`` samples came into use or were passed by (a newer one was there by then),
    ``sent`` are those of the grid; ``approximated`` of these repeat a sample of another valid
    time, ``delayed`` one of their own that had come earlier.
    """

    received: int = 0
    kept: int = 0
    sent: int = 0
    delayed: int = 0
    approximated: int = 0
    pending: int = 0
    dropped: dict[Constraint, int] = field(default_factory=dict)

    def drop(self, constraint: Constraint, count: int) -> None:
        """Count ``count`` samples that ``constraint`` dropped."""
        if count:
            self.dropped[constraint] = self.dropped.get(constraint, 0) + count
