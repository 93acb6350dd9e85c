"""The AST of KPL ([DyKnow10 §5.2], SPEC §1): the text as written, with unresolved names.

Spans take no part in comparisons: two declarations that differ only in spans are equal. `check`
converts these values to those of `declarations`. *Extension* marks additions to the paper.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field as attribute
from typing import Final, Literal, TypeAlias

from ...streams.policies.policy import Approximation, Order
from ..errors import Span

KEYWORDS: Final = frozenset(
    [
        *("any", "approximation", "change", "compunit", "delay", "every", "from", "max"),
        *("monotone", "most", "no", "oo", "order", "recent", "sample", "source", "stream"),
        *("strict", "strmgen", "to", "update", "use", "with"),
    ]
)
"""Def. 5.12: these words are no symbols. Our `unit`, `sort`, `foreach`, `in` and `sink` may be
symbols."""


@dataclass(frozen=True, slots=True)
class Name:
    """A symbol as written: ``pos_car1``, ``dyknow:speed``; an object without its quotes."""

    text: str
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Time:
    """A duration or time point as written: ``200``, ``-5``, ``1.5s``, ``2021-10-07T19:12:53Z``."""

    text: str
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Change:
    """Def. 5.22. ``period`` belongs to ``sample every`` only, ``difference`` to ``change by`` only
    ([DyKnow10 §4.3.1]); it is as written: ``10``, ``0.5``."""

    kind: Literal["any update", "any change", "change by", "sample every"]
    period: Time | None
    span: Span = attribute(compare=False)
    difference: str | None = None


@dataclass(frozen=True, slots=True)
class Delay:
    """Def. 5.23; None stands for ``oo``."""

    delay: Time | None
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Duration:
    """Def. 5.24; ``to_oo`` distinguishes a written ``to oo`` from a missing ``to``."""

    start: Time | None
    end: Time | None
    to_oo: bool
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Ordering:
    """Def. 5.25."""

    order: Order
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Approximating:
    """Def. 5.26."""

    approximation: Approximation
    span: Span = attribute(compare=False)


Constraint: TypeAlias = Change | Delay | Duration | Ordering | Approximating


@dataclass(frozen=True, slots=True)
class LabelTerm:
    """Def. 5.17: ``pos[car1]``; ``pos`` and ``pos[]`` are equal."""

    feature: Name
    objects: tuple[Name, ...]
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class StreamTerm:
    """Def. 5.19: a label and the constraints after ``with``; empty without ``with``."""

    label: LabelTerm
    policy: tuple[Constraint, ...]
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Source:
    """Def. 5.15: ``source pos pos_car1``."""

    sort: Name
    name: Name
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Compunit:
    """Def. 5.16: ``compunit speed SpeedEst(pos)``."""

    sort: Name
    name: Name
    inputs: tuple[Name, ...]
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Mediation:
    """Extension (Def. 4.7): ``(pos[car] foreach car in cars)``, the inputs of a mediation
    process."""

    pattern: StreamTerm
    variable: Name
    members: StreamTerm
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Strmgen:
    """Def. 5.18. Without ``terms`` and ``mediation`` the process is a source, since the text had no
    parentheses. ``synchronization`` are the constraints after ``;``, ``inner_times`` is ``; inner
    times`` (both extensions)."""

    label: LabelTerm
    process: Name
    terms: tuple[StreamTerm, ...]
    synchronization: tuple[Constraint, ...]
    mediation: Mediation | None
    span: Span = attribute(compare=False)
    inner_times: bool = False


@dataclass(frozen=True, slots=True)
class Stream:
    """Def. 5.20: ``stream speed_car1 = speed[car1] with from 300 to 400``."""

    name: Name
    term: StreamTerm
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Sort:
    """Extension: ``sort altitude = float`` (one sort) or ``sort pos = (x float, y float)``."""

    name: Name
    value: Name | tuple[tuple[Name, Name], ...]
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Foreach:
    """Extension, a configuration process (Def. 4.6): ``generators`` for each object in
    ``members``."""

    variable: Name
    members: StreamTerm
    generators: tuple[Strmgen, ...]
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Sink:
    """Extension: ``sink Log(speed[car1] with any change)``, a process without output."""

    name: Name
    terms: tuple[StreamTerm, ...]
    span: Span = attribute(compare=False)


Declaration: TypeAlias = Source | Compunit | Strmgen | Stream | Sort | Foreach | Sink


@dataclass(frozen=True, slots=True)
class Specification:
    """Def. 5.14. ``unit`` is that of integers; None: the caller decides."""

    unit: Name | None
    declarations: tuple[Declaration, ...]
