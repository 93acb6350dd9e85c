"""Samples that a Python program gives as dicts, as a recording. `dyknow.run` reads them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

import numpy as np

from ..csv_table import CHUNK
from ..errors import WireError
from ..inference import TimeReader
from .recording import Recording, ValueChunk, open_rows

VALID: Final = "valid"
_PLAIN: Final = (bool, int, float, str)


def recording_of(samples: Iterable[Mapping[str, Any]]) -> Recording:
    """Return ``samples`` as a recording: dicts with ``valid``, optionally ``available``, and the
    fields. Times are integers (ns) or ISO-8601 texts, values are plain or None.

    Raises `WireError` with the number of the sample, from 1, as its line. Memory: all samples.
    """
    rows = [_plain(i, sample) for i, sample in enumerate(samples, 1)]

    def read() -> Iterator[ValueChunk]:
        for start in range(0, len(rows), CHUNK):
            part = rows[start : start + CHUNK]
            yield list(range(start + 1, start + 1 + len(part))), part

    return open_rows(read, VALID, TimeReader("ns"), None, {})


def _plain(line: int, sample: Mapping[str, Any]) -> dict[str, Any]:
    found = {}
    for name, value in sample.items():
        if isinstance(value, np.generic):
            value = value.item()
        if value is not None and type(value) not in _PLAIN:
            raise WireError(
                line,
                f"field {name!r} is a {type(value).__name__}",
                "a value is a bool, an int, a float, a str or None; a time an int (ns) or a text",
            )
        found[name] = value
    return found
