"""Streams of label sets: the objects that exist now ([DyKnow10 §4.3], Def. 4.6, 4.7)."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Final

from ...streams.sample import Column, FieldType, SampleBatch

_SEPARATORS: Final = re.compile(r"[\s,]+")
_PREFERRED: Final = ("objects", "object", "id")


def read_sets(batch: SampleBatch) -> Iterator[tuple[int, tuple[str, ...] | str]]:
    """Return for each sample its available time and the objects that it names, in their order, each
    once. An error message stands in place of the objects if the sample names none in a known form.

    The names are in the text field ``objects``, ``object`` or ``id``, else in the first text field.
    Without a text field an integer field names one object. A text has names between blanks or
    commas, or it is a JSON list of names, which may contain any characters. no_value is the empty
    set.
    """
    column = _column(batch)
    if column is None:
        fields = ", ".join(batch.columns) or "none"
        values: list[object] = []
        reason = f"no field names objects: there is no text or integer among {fields}"
    else:
        values, reason = list(column.tolist()), ""
    for row, time in enumerate(batch.available.tolist()):
        yield time, _names(values[row]) if values else reason


def _column(batch: SampleBatch) -> Column | None:
    texts = [n for n, column in batch.columns.items() if column.type is FieldType.STRING]
    numbers = [n for n, column in batch.columns.items() if column.type is FieldType.INTEGER]
    for names in (texts, numbers):
        if names:
            return batch.columns[next((n for n in _PREFERRED if n in names), names[0])]
    return None


def _names(value: object) -> tuple[str, ...] | str:
    if value is None:
        return ()
    text = str(value)
    if text.lstrip().startswith("["):
        try:
            names = json.loads(text)
        except (ValueError, RecursionError):
            names = None
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            return f"{_excerpt(text)} is not a JSON list of names: write each name in quotes"
    else:
        names = [name for name in _SEPARATORS.split(text) if name]
    for name in names:
        if not name or any("\ud800" <= c <= "\udfff" for c in name):
            return f"{_excerpt(text)} has a name that is empty or not valid Unicode"
    return tuple(dict.fromkeys(names))


def _excerpt(text: str) -> str:
    shown = ascii(text)
    return shown if len(shown) <= 60 else f"{shown[:57]}…"
