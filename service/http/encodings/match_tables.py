"""Matches and partial matches as tables for people; the members are those of the models."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .verdict_tables import cell, table


def matches_table(found: Mapping[str, Any]) -> str:
    """Return for each match a line, and a line for each of its events."""
    lines: list[str] = []
    for match in found["matches"]:
        told = _values(match["values"])
        lines.append(
            f"{found['query']}{f', {told}' if told else ''}, from {match['start']} to "
            f"{match['end']}, available at {match['available']}"
        )
        events = match["events"]
        columns = [
            ("event", [each["event"] for each in events]),
            ("valid", [each["valid"] for each in events]),
            ("stream", [each["stream"] for each in events]),
            ("sample", [_values(each["values"]) for each in events]),
        ]
        lines += ["", *table(columns), ""]
    return "\n".join([*lines, ""])


def partial_table(found: Mapping[str, Any]) -> str:
    """Return for each partial match the events that came, and those that may come."""
    number = len(found["partial"])
    matches = "partial match" if number == 1 and not found["more"] else "partial matches"
    lines = [
        f"{found['query']}, by {found['watermark'] or 'now'}: "
        f"{f'{number:,}' if number else 'no'}{'+' if found['more'] else ''} {matches}"
    ]
    for partial in found["partial"]:
        came = [
            (each["event"], each["valid"], _values(each["values"])) for each in partial["events"]
        ]
        came += [
            (each["event"], f"{each['earliest']} ..", each["latest"] or "whenever")
            for each in partial["pending"]
        ]
        names, times, rest = map(list, zip(*came, strict=True))
        lines += ["", *table([("event", names), ("time", times), ("sample, or latest", rest)])]
    return "\n".join([*lines, ""])


def _values(values: Mapping[str, object]) -> str:
    return ", ".join(f"{name} = {cell(value)}" for name, value in values.items())
