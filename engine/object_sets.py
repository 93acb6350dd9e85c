"""Streams of label sets: which objects there are now ([DyKnow10 §4.3], Def. 4.6, 4.7)."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from typing import Final

from ..streams.sample import Column, FieldType, SampleBatch

_SEPARATORS: Final = re.compile(r"[\s,]+")
_PREFERRED: Final = ("objects", "object", "id")


def sets_of(batch: SampleBatch) -> list[tuple[str, ...]]:
    """The objects that each sample names, in their order, each once.

    They stand in the text field ``objects``, ``object`` or ``id``, else in the first text field;
    in an integer field, as one number, if there is no text. A text is names with blanks or commas
    between them, or a JSON list of names, which may then have anything in them. no_value is the
    empty set. Raises `ValueError` for a sample that names objects in no such way.
    """
    column = _column(batch)
    return [_set(value) for value in column.tolist()]


def _column(batch: SampleBatch) -> Column:
    texts = [n for n, column in batch.columns.items() if column.type is FieldType.STRING]
    numbers = [n for n, column in batch.columns.items() if column.type is FieldType.INTEGER]
    for names in (texts, numbers):
        if names:
            return batch.columns[next((n for n in _PREFERRED if n in names), names[0])]
    fields = ", ".join(batch.columns) or "none"
    raise ValueError(f"no field names objects: there is no text among {fields}")


def _set(value: object) -> tuple[str, ...]:
    names: Sequence[str]
    if value is None:
        names = ()
    elif isinstance(value, str) and value.lstrip().startswith("["):
        try:
            found = json.loads(value)
        except ValueError as error:
            raise ValueError(f"{value!r} is no JSON list of names: {error}") from None
        if not all(isinstance(name, str) for name in found):
            raise ValueError(f"{value!r} is no JSON list of names: write them in quotes")
        names = found
    else:
        names = [name for name in _SEPARATORS.split(str(value)) if name]
    return tuple(dict.fromkeys(names))
