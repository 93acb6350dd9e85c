"""A table from a pipe: read once, as it arrives, in its own order (``dyknow replay -``).

A file is read completely before the types of its fields and the unit of its times are fixed. For a
pipe, its head fixes them. A chunk ends as soon as the pipe has no further whole line. Rows out of
order in time are counted but not sorted, because sorting needs all rows.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, islice
from typing import Final, Protocol

import numpy as np

from ...streams.sample import FieldType, SampleBatch
from ..csv_table import CHUNK, TextChunk, read_csv_lines
from ..errors import EmptyTable, WireError
from ..inference import TimeReader, time_column
from ..wire import BOM
from .csv_dialect import detect_delimiter
from .many_streams import STREAM
from .recording import Recording, ValueChunk, decode_rows, open_cells, open_rows
from .table_options import GUESSED, TableOptions
from .text_files import GZIP, LONGEST_LINE

HEAD: Final = 1000
"""Rows that decide the fields of a stream that is not declared."""
_READ: Final = 1 << 18
_SAVE: Final = "write it to a file and replay that"
_BINARY: Final = (b"ARROW1", b"\xff\xff\xff\xff", b"PAR1", b"ULog")


class Readable(Protocol):
    """A binary file: `read1` returns the bytes that have arrived, and none at the end."""

    def read1(self, size: int, /) -> bytes: ...


@dataclass(slots=True)
class Piped:
    """A table during its reading. `recording` returns its rows once. ``rows`` and ``out_of_order``
    count those so far, ``last`` is their greatest available time (ns), ``first`` that of the first
    row."""

    recording: Recording
    first: int
    last: int
    rows: int = 0
    out_of_order: int = 0

    @property
    def note(self) -> str | None:
        """A message for the user about rows out of order; None if all are in order."""
        if not self.out_of_order:
            return None
        return (
            f"not sorted: {self.out_of_order:,} of {self.rows:,} rows were out of order, and "
            f"{self.recording.out_of_order_effect}: a pipe is taken as it comes, write it to a "
            "file and replay\n      that, whose rows are sorted"
        )

    def count(self, batch: SampleBatch) -> SampleBatch:
        """Count the rows of ``batch`` and return it."""
        if len(batch):
            highest = np.maximum.accumulate(np.maximum(batch.available, self.last))
            self.out_of_order += int(np.count_nonzero(batch.available < highest))
            self.last = int(highest[-1])
            self.rows += len(batch)
        return batch


def open_pipe(
    file: Readable,
    options: TableOptions = GUESSED,
    types: Mapping[str, FieldType] | None = None,
) -> Piped:
    """Read the head of the CSV or NDJSON table in ``file``.

    ``types`` are those of a declared stream. If they have all fields of the first row, the head is
    that row; else it is up to `HEAD` rows, and the function waits for them. ``options`` as for
    `open_recording`.

    Raises `WireError`; iteration of the recording raises it for a row that does not fit the head.
    Memory: the head, and the bytes of one ``read1``.
    """
    lines, known, wanted = _Lines(file), types or {}, options.time_column
    pace, leading = _Pace(lines), _leading(lines)
    source: _Csv | _Ndjson
    if leading[-1].removeprefix(BOM).lstrip().startswith(b"{"):
        source = _Ndjson(chain(leading, lines), pace)
    else:
        source = _Csv(chain(leading, lines), pace, options.delimiter or _delimiter(leading[0]))
    source.look()
    valid = time_column(source.names, wanted)
    clocks = {valid, "available"}
    if known and set(source.names) <= known.keys() | clocks:
        source.expect(known)
    else:
        pace.head = HEAD
        source.look()
    given = {name: type for name, type in known.items() if name in source.names}
    recording = source.open(wanted, options.times(), given)
    first = int(next(recording.read()).available[0])
    source.go_on(wanted)
    piped = Piped(recording, first, first)
    # Count the batches before `Recording` moves their times.
    piped.recording = replace(recording, rows=0, read=lambda: map(piped.count, recording.read()))
    return piped


class _Lines:
    """The lines of a pipe, each as soon as it is complete."""

    def __init__(self, file: Readable) -> None:
        self._file = file
        self._whole: deque[bytes] = deque()
        self._rest = b""

    @property
    def is_empty(self) -> bool:
        """Whether the next line requires a read."""
        return not self._whole

    def __iter__(self) -> Iterator[bytes]:
        while True:
            while self._whole:
                yield self._whole.popleft()
            data = self._file.read1(_READ)
            if not data:
                rest, self._rest = self._rest, b""
                if rest:
                    yield rest
                return
            *whole, self._rest = (self._rest + data).split(b"\n")
            if len(self._rest) > LONGEST_LINE:
                raise WireError(None, f"a line has more than {LONGEST_LINE:,} bytes")
            self._whole.extend(line + b"\n" for line in whole)


class _Pace:
    """Ends chunks: first after ``head`` rows, then whenever the pipe has no further whole line."""

    def __init__(self, lines: _Lines) -> None:
        self.head = 1
        self._rows = 0
        self._lines = lines

    def ends(self, rows: int = 1) -> bool:
        """Whether a chunk ends here, ``rows`` rows after the last call."""
        before, self._rows = self._rows, self._rows + rows
        return before < self.head <= self._rows or (
            self._rows >= self.head and self._lines.is_empty
        )


class _Csv:
    """Cells of a pipe: those of the head any number of times, then all cells once."""

    def __init__(self, lines: Iterable[bytes], pace: _Pace, delimiter: str) -> None:
        texts = (line.decode("utf-8-sig" if n == 0 else "utf-8") for n, line in enumerate(lines))
        self._delimiter = delimiter
        self._rest = read_csv_lines(texts, delimiter, pace.ends)
        self._head: list[TextChunk] = []
        self._again: Callable[[], Iterator[TextChunk]] = lambda: iter(self._head)

    def look(self) -> None:
        """Extend the head by chunks up to one that has rows."""
        for chunk in self._rest:
            self._head.append(chunk)
            if chunk[0]:
                return
        if not any(lines for lines, _ in self._head):
            raise EmptyTable(None, "the table has no rows")

    @property
    def names(self) -> list[str]:
        """The columns."""
        return list(self._head[0][1])

    def expect(self, known: Mapping[str, FieldType]) -> None:
        """Do nothing: the header has all columns."""

    def open(
        self, wanted: str | None, times: TimeReader, types: Mapping[str, FieldType]
    ) -> Recording:
        """The recording of the head."""
        return open_cells(lambda: self._again(), self._delimiter, wanted, times, types, {})

    def go_on(self, wanted: str | None) -> None:
        """From now on the recording gives all rows."""
        self._again = lambda: chain(self._head, self._rest)


class _Ndjson:
    """Rows of a pipe, as `_Csv`. Later rows have no other fields than the head."""

    def __init__(self, lines: Iterable[bytes], pace: _Pace) -> None:
        self._rest = _decoded(lines, pace)
        self._head: list[ValueChunk] = []
        self._again: Callable[[], Iterator[ValueChunk]] = lambda: iter(self._head)

    def look(self) -> None:
        """Extend the head by a chunk."""
        self._head += islice(self._rest, 1)
        if isinstance(self._head[0][1][0].get(STREAM), str):
            raise WireError(
                None, "the lines of the pipe name their streams, and it is played into one", _SAVE
            )

    @property
    def names(self) -> list[str]:
        """The fields of the rows in the head."""
        return list(dict.fromkeys(name for _, rows in self._head for row in rows for name in row))

    def expect(self, known: Mapping[str, FieldType]) -> None:
        """Let later rows have any field of ``known``."""
        first = self._head[0][1][0]
        first.update(dict.fromkeys(known.keys() - first.keys()))

    def open(
        self, wanted: str | None, times: TimeReader, types: Mapping[str, FieldType]
    ) -> Recording:
        """The recording of the head."""
        return open_rows(lambda: self._again(), wanted, times, types, {})

    def go_on(self, wanted: str | None) -> None:
        """From now on the recording gives all rows."""
        names = self.names
        always = {"available"} & set(names) - {time_column(names, wanted)}
        rest = map(partial(_checked, set(names), always), self._rest)
        self._again = lambda: chain(self._head, rest)


def _decoded(lines: Iterable[bytes], pace: _Pace) -> Iterator[ValueChunk]:
    numbered: list[tuple[int, bytes]] = []
    for number, line in enumerate(lines, 1):
        if number == 1:
            line = line.removeprefix(BOM)
        if line.strip():
            numbered.append((number, line))
        is_row = bool(numbered) and numbered[-1][0] == number
        if numbered and (pace.ends(int(is_row)) or len(numbered) == CHUNK):
            yield from decode_rows(numbered)
            numbered = []
    yield from decode_rows(numbered)


def _checked(names: AbstractSet[str], always: AbstractSet[str], chunk: ValueChunk) -> ValueChunk:
    """A chunk after the head; raises `WireError` for a field beyond ``names``, or without one of
    ``always``."""
    for line, row in zip(*chunk, strict=True):
        for name in row.keys() - names:
            raise WireError(
                line,
                f"field {name!r} is not in the head of the pipe",
                f"declare the stream with it, or {_SAVE}",
            )
        for name in always - row.keys():
            raise WireError(line, f"{name!r} is in some samples and not in others")
    return chunk


def _delimiter(header: bytes) -> str:
    # The reader of the table reports bytes that are no UTF-8, with their line.
    return detect_delimiter(header.decode("utf-8-sig", errors="replace"))


def _leading(lines: Iterable[bytes]) -> list[bytes]:
    """The first line that is not blank, and those before it. Raises `WireError` for other formats
    than CSV and NDJSON."""
    found = []
    for line in lines:
        found.append(line)
        if line.strip():
            break
    else:
        raise EmptyTable(1, "the table is empty")
    first = found[0]
    if first.startswith(GZIP):
        raise WireError(
            None, "the data from the pipe is compressed", "decompress it: gzip -dc FILE | …"
        )
    if first.startswith(_BINARY):
        raise WireError(None, "a pipe takes CSV or NDJSON only", _SAVE)
    return found
