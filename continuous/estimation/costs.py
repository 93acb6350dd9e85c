"""The table of estimated and measured costs of the operators of a plan, for people."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

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


def cost_table(
    plan: Plan, costs: Mapping[int, Estimate], known: Known, profile: Profile | None
) -> Iterator[str]:
    """The lines of the table: the rates of the inputs, then rows out and time of each operator.

    An operator ``WITHIN`` the one above it has no time of its own. Lines of operators are cut to
    the width: the plan above has them whole.
    """
    for name in dict.fromkeys(one.input for one in known.schedule.windows):
        yield f"{name or 'any stream'}: {known.flows.get(name, NOTHING_KNOWN)}"
    ran = profile is not None and profile.windows > 0
    nodes = walk(plan)
    lines = describe(plan)
    ways = [costs[id(node)].way for node in nodes]
    columns = sum(_NUMBERS) * (2 if ran else 1)
    room = _WIDEST - columns - 2 - max(len(way) for way in ways)
    width = min(max(len("together"), *map(len, lines)), room)
    heads = ("estimated", "measured") if ran else ("estimated",)
    yield f"{'':<{width}}" + "".join(f"{head:>{sum(_NUMBERS)}}" for head in heads)
    yield f"{'':<{width}}{_pair('rows', 'time') * len(heads)}"
    estimated, spent = 0.0, 0.0
    for node, line, way in zip(nodes, lines, ways, strict=True):
        cost = costs[id(node)]
        estimated += cost.nanoseconds
        rows = "" if cost.rows is None else _rows(cost.rows)
        shown = _pair(rows, "" if way is Way.WITHIN else _time(cost.nanoseconds, 2))
        if ran:
            assert profile is not None
            measured = profile.measured(node)
            spent += 0.0 if measured is None else measured.nanoseconds
            shown += _measured(measured)
        yield f"{_cut(line, width):<{width}}{shown}  {way}"
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
