"""Bodies of lines in parts: whole lines, few enough that a part is decoded in some milliseconds."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import islice
from typing import Final, NamedTuple

from ..streams.yield_points import Pauses

PART: Final = 1 << 16
"""Bytes of a part, and as many as its last line has more."""
_SAMPLE = re.compile(rb"\S[^\n]*")
"""What of a line is not blank: blanks are those of `bytes.strip`."""


class Part(NamedTuple):
    """Whole lines, with the number of the first one."""

    data: bytes
    line: int

    def lines(self) -> Iterator[tuple[int, bytes]]:
        """Those that are not blank, with their numbers."""
        for number, line in enumerate(self.data.split(b"\n"), self.line):
            if line.strip():
                yield number, line

    def samples(self) -> int:
        """How many lines are not blank."""
        return len(_SAMPLE.findall(self.data))

    def number(self, nth: int) -> int:
        """The number of the nth line that is not blank, from 0 on. Contract: there is one."""
        found = next(islice(_SAMPLE.finditer(self.data), nth, None))
        return self.line + self.data.count(b"\n", 0, found.start())


def parts(data: bytes, size: int) -> Iterator[Part]:
    """``data`` in parts of at least one line. Cost: a copy, but of what is one part."""
    if 0 < len(data) <= size:
        yield Part(data, 1)
        return
    start, line = 0, 1
    while start < len(data):
        end = len(data)
        if end - start > size:
            end = data.rfind(b"\n", start, start + size) + 1 or data.find(b"\n", start + size) + 1
            end = end or len(data)
        part = data[start:end]
        yield Part(part, line)
        if end < len(data):
            line += part.count(b"\n")
        start = end


def count_lines(data: bytes, most: int, size: int, pauses: Pauses) -> int | None:
    """The number of the first line that is one too many where more than ``most`` are not blank;
    None where they are not."""
    if data.count(b"\n") < most:
        return None
    before = 0
    for part in parts(data, size):
        count = part.samples()
        if before + count > most:
            return part.number(most - before)
        before += count
        pauses.breathe()
    return None
