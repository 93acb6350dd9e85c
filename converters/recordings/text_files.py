"""Lines of text files, which may be compressed: gzip is known by its first bytes, not by a name.

A compressed file is decompressed as it is read, a line at a time. The bound on lines therefore
bounds the memory for any file, however far it expands.
"""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from contextlib import contextmanager
from io import StringIO, TextIOWrapper
from pathlib import Path
from typing import IO, Final, cast

from ..csv_table import UNPACKING, TextChunk, read_csv_lines
from ..errors import WireError
from ..wire import BOM
from .csv_dialect import detect_delimiter

LONGEST_LINE: Final = 1 << 24
"""Most characters of a line, which bounds memory for input without line feeds."""
_BLOCK: Final = 1 << 13
"""Characters that are read at once: what cannot be read is at most so far from the line told."""
GZIP: Final = b"\x1f\x8b"


def read_csv(path: Path, delimiter: str) -> Iterator[TextChunk]:
    """The cells of a CSV file, as `read_csv_lines`."""
    with _unpacked(path) as file, _text(file) as text:
        yield from read_csv_lines(_text_lines(text), delimiter)


def csv_delimiter(path: Path) -> str:
    """The delimiter of a CSV file by its header. Raises `WireError` if two may be it."""
    try:
        with _unpacked(path) as file, _text(file) as text:
            return detect_delimiter(next(_text_lines(text), ""))
    except (UnicodeDecodeError, *UNPACKING) as error:
        raise WireError(1, f"the table cannot be read: {error}") from error


def read_lines(path: Path) -> Iterator[tuple[int, bytes]]:
    """The lines of a file that are not blank, with their numbers from 1."""
    number = 0
    try:
        with _unpacked(path) as file:
            for number, line in enumerate(_bounded(file), 1):
                if number == 1:
                    line = line.removeprefix(BOM)
                if line.strip():
                    yield number, line
    except UNPACKING as error:
        raise WireError(number + 1, f"the table cannot be read: {error}") from error


def read_whole(path: Path) -> bytes:
    """The bytes of a file, decompressed, without a byte order mark. Raises `WireError` for one that
    cannot be decompressed, or is called ``.gz`` and is not compressed."""
    data = path.read_bytes()
    if data.startswith(GZIP) or path.suffix.lower() == ".gz":
        try:
            data = gzip.decompress(data)
        except UNPACKING as error:
            raise WireError(None, f"{path.name} cannot be unpacked: {error}") from error
    return data.removeprefix(BOM)


def ending(path: Path) -> str:
    """The ending of a file's name in lower case, without ``.gz``."""
    return Path(path.name.lower().removesuffix(".gz")).suffix


@contextmanager
def _unpacked(path: Path) -> Iterator[IO[bytes]]:
    with path.open("rb") as file:
        if file.peek(len(GZIP)).startswith(GZIP):
            with gzip.open(file) as unpacked:
                yield cast(IO[bytes], unpacked)
        else:
            yield file


def _text(file: IO[bytes]) -> IO[str]:
    return TextIOWrapper(file, encoding="utf-8-sig", newline="")


def _text_lines(file: IO[str]) -> Iterator[str]:
    """The lines of a text, with their ends; many at once are read ten times as fast as one."""
    number, rest = 0, ""
    while block := file.read(_BLOCK):
        lines = StringIO(rest + block, newline="").readlines()
        # The last one may go on; a carriage return may be half of its end.
        rest = lines.pop()
        yield from lines
        number += len(lines)
        if len(rest) > LONGEST_LINE:
            raise _too_long(number + 1)
    if rest:
        yield rest


def _bounded(file: IO[bytes]) -> Iterator[bytes]:
    number = 0
    while line := file.readline(LONGEST_LINE + 1):
        number += 1
        if len(line) > LONGEST_LINE:
            raise _too_long(number)
        yield line


def _too_long(number: int) -> WireError:
    return WireError(number, f"a line has more than {LONGEST_LINE:,} characters")
