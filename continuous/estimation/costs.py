"""The estimated and measured costs of the operators of a plan: as values, and as a table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from ..algebra.plan import Plan, walk
from ..algebra.plan_text import describe
from ..operators.profile import Measured, Profile
from .estimates import Estimate, Way
from .input_rates import NOTHING_KNOWN
from .pattern_sizes import Known

_WIDEST = 96
"""Columns of the table: with the margin of its section it fits a terminal of 100."""
_NUMBERS = (9, 8)
"""Columns of rows and of time."""


@dataclass(frozen=True, slots=True)
class OperatorCost:
    """One operator of a plan, as in `plan_text.describe`: ``depth`` below the first, its text, and
    its cost. ``measured`` is None where it has not run by itself."""

    depth: int
    text: str
    estimate: Estimate
    measured: Measured | None


def operator_costs(
    plan: Plan, costs: Mapping[int, Estimate], profile: Profile | None
) -> tuple[OperatorCost, ...]:
    """The operators of a plan with their costs, each before its inputs."""
    return tuple(
        OperatorCost(
            (len(line) - len(line.lstrip())) // 2,
            line.lstrip(),
            costs[id(node)],
            None if profile is None else profile.measured(node),
        )
        for node, line in zip(walk(plan), describe(plan), strict=True)
    )


def cost_table(operators: Sequence[OperatorCost], known: Known) -> Iterator[str]:
    """The lines of the table: the rates of the inputs, then rows out and time of each operator.

    An operator ``WITHIN`` the one above it has no time of its own. Lines of operators are cut to
    the width: the plan above has them whole.
    """
    for name in dict.fromkeys(one.input for one in known.schedule.windows):
        yield f"{name or 'any stream'}: {known.flows.get(name, NOTHING_KNOWN)}"
    ran = any(one.measured is not None for one in operators)
    lines = ["  " * one.depth + one.text for one in operators]
    columns = sum(_NUMBERS) * (2 if ran else 1)
    room = _WIDEST - columns - 2 - max(len(one.estimate.way) for one in operators)
    width = min(max(len("together"), *map(len, lines)), room)
    heads = ("estimated", "measured") if ran else ("estimated",)
    yield f"{'':<{width}}" + "".join(f"{head:>{sum(_NUMBERS)}}" for head in heads)
    yield f"{'':<{width}}{_pair('rows', 'time') * len(heads)}"
    estimated, spent = 0.0, 0.0
    for one, line in zip(operators, lines, strict=True):
        cost = one.estimate
        estimated += cost.nanoseconds
        rows = "" if cost.rows is None else _rows(cost.rows)
        shown = _pair(rows, "" if cost.way is Way.WITHIN else _time(cost.nanoseconds, 2))
        if ran:
            spent += 0.0 if one.measured is None else one.measured.nanoseconds
            shown += _measured(one.measured)
        yield f"{_cut(line, width):<{width}}{shown}  {cost.way}"
    total = _pair("", _time(estimated, 2)) + (_pair("", _time(spent)) if ran else "")
    yield f"{'together':<{width}}{total}"


def _measured(measured: Measured | None) -> str:
    if measured is None:
        return _pair("", "")
    return _pair(_rows(measured.rows), _time(measured.nanoseconds))


def _pair(rows: str, time: str) -> str:
    return f"{rows:>{_NUMBERS[0]}}{time:>{_NUMBERS[1]}}"


def _rows(rows: float) -> str:
    """A whole number from ten on, else one decimal."""
    if rows < 9.95:
        return f"{rows:.1f}".removesuffix(".0")
    return f"{rows:,.0f}" if rows < 1e7 else f"{rows:.1e}".replace("e+0", "e").replace("e+", "e")


def _time(nanoseconds: float, digits: int = 3) -> str:
    nanoseconds = float(f"{nanoseconds:.{digits}g}")
    for unit, size in (("s", 1e9), ("ms", 1e6), ("µs", 1e3)):
        if nanoseconds >= size:
            return f"{_rows(nanoseconds / size)} {unit}"
    return f"{nanoseconds:.0f} ns"


def _cut(line: str, width: int) -> str:
    return line if len(line) <= width else f"{line[: width - 1]}…"
