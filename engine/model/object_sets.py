"""Streams of label sets: which objects there are now ([DyKnow10 §4.3], Def. 4.6, 4.7)."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Final

from ...streams.sample import Column, FieldType, SampleBatch

_SEPARATORS: Final = re.compile(r"[\s,]+")
_PREFERRED: Final = ("objects", "object", "id")


def sets_of(batch: SampleBatch) -> Iterator[tuple[int, tuple[str, ...] | str]]:
    """For each sample its available time, and the objects that it names, in their order, each
    once; a text instead says why it names objects in no way that is known.

    They stand in the text field ``objects``, ``object`` or ``id``, else in the first text field;
    in an integer field, as one number, if there is no text. A text is names with blanks or commas
    between them, or a JSON list of names, which may then have anything in them. no_value is the
    empty set.
    """
    column = _column(batch)
    if column is None:
        fields = ", ".join(batch.columns) or "none"
        values: list[object] = []
        reason = f"no field names objects: there is no text among {fields}"
    else:
        values, reason = list(column.tolist()), ""
    for row, time in enumerate(batch.available.tolist()):
        yield time, _set(values[row]) if values else reason


def _column(batch: SampleBatch) -> Column | None:
    texts = [n for n, column in batch.columns.items() if column.type is FieldType.STRING]
    numbers = [n for n, column in batch.columns.items() if column.type is FieldType.INTEGER]
    for names in (texts, numbers):
        if names:
            return batch.columns[next((n for n in _PREFERRED if n in names), names[0])]
    return None


def _set(value: object) -> tuple[str, ...] | str:
    if value is None:
        return ()
    text = str(value)
    if text.lstrip().startswith("["):
        try:
            names = json.loads(text)
        except (ValueError, RecursionError):
            names = None
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            return f"{_short(text)} is no JSON list of names: write each name in quotes"
    else:
        names = [name for name in _SEPARATORS.split(text) if name]
    for name in names:
        if not name or any("\ud800" <= c <= "\udfff" for c in name):
            return f"{_short(text)} has a name that is empty or no Unicode text"
    return tuple(dict.fromkeys(names))


def _short(text: str) -> str:
    shown = ascii(text)
    return shown if len(shown) <= 60 else f"{shown[:57]}…"
