"""The explanation of a verdict as a table for people; its members are those of `WhyModel`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from string import ascii_lowercase
from typing import Any


def why_table(found: Mapping[str, Any]) -> str:
    """Return a legend of the parts of the formula, and a line for each state."""
    objects = ", ".join(f"?{name} = {value}" for name, value in found["objects"].items())
    decided = "not decided yet" if found["decided"] is None else f"decided at {found['decided']}"
    head = f"{found['query']}, {objects}" if objects else found["query"]
    lines = [f"{head}, from {found['start']}: {found['verdict']}, {decided}", ""]
    parts = list(zip(_letters(), found["formulas"], strict=False))
    lines += [f"{letter}  {'  ' * part['depth']}{part['text']}" for letter, part in parts]
    columns = [("state", found["states"])]
    columns += [(each["text"], list(map(cell, each["values"]))) for each in found["features"]]
    columns += [(letter, part["values"]) for letter, part in parts if part["values"]]
    return "\n".join([*lines, "", *table(columns), ""])


def table(columns: Sequence[tuple[str, Sequence[str]]]) -> Iterator[str]:
    """Yield the lines of a table: the heads, then the rows."""
    widths = [max(map(len, (name, *values))) for name, values in columns]
    rows = [[name for name, _ in columns]]
    rows += map(list, zip(*(values for _, values in columns), strict=True))
    for row in rows:
        yield "  ".join(
            f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)
        ).rstrip()


def cell(value: object) -> str:
    """Return a value as people read it."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _letters() -> Iterator[str]:
    """a, b, … z, a1, b1, …"""
    yield from ascii_lowercase
    number = 1
    while True:
        yield from (f"{letter}{number}" for letter in ascii_lowercase)
        number += 1
