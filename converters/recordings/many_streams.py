"""Recordings of many streams: logs of robots, lines that name their stream, folders, files.

Called by ``dyknow replay`` and by programs that reason over recorded streams without a service.
"""

from __future__ import annotations

import heapq
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import islice, pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from ...streams.sample import FieldType
from ...streams.time import SECOND, TIME_MIN
from ..errors import EmptyTable, WireError
from ..inference import TimeReader
from ..wire import Incoming
from .mcap import open_mcap
from .names import valid_name
from .rdf_file import FORMATS as RDF
from .rdf_file import is_rdf_file, open_rdf
from .recording import (
    ARROW,
    CSV,
    NDJSON,
    PARQUET,
    Recording,
    ValueChunk,
    decode_rows,
    open_recording,
    open_rows,
)
from .rosbag import METADATA, open_rosbag
from .table_options import GUESSED, TableOptions
from .text_files import read_lines
from .topics import TopicLog
from .ulog import open_ulog

STREAM: Final = "stream"
"""The key of a line that names the sample's stream."""
_TABLES: Final = (*CSV, *NDJSON, *ARROW, *PARQUET, *RDF)
_ULOG: Final = ".ulg"
_MCAP: Final = ".mcap"
_BAGS: Final = (".bag", ".db3")
_LOGS: Final = (_ULOG, _MCAP, *_BAGS)
_NAMED = re.compile(r"([A-Za-z][A-Za-z0-9_]*)=(.+)", re.DOTALL).fullmatch

Types = Mapping[str, Mapping[str, FieldType]]


@dataclass(frozen=True, slots=True)
class Recordings(Mapping[str, Recording]):
    """Recordings by the name of their stream, in the order of names.

    ``dropouts`` counts the gaps in which a recorder logged nothing, ``lost`` is their length in ns;
    None and 0 if no recorder says. ``notes`` tell the differences from the recorded data.
    """

    _by_name: Mapping[str, Recording] = field(default_factory=dict)
    dropouts: int | None = None
    lost: int = 0
    notes: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> Recording:
        return self._by_name[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._by_name)

    def __len__(self) -> int:
        return len(self._by_name)


def open_recordings(
    paths: Sequence[Path | str],
    options: TableOptions = GUESSED,
    types: Types | None = None,
    *,
    utc: bool = False,
    skip_empty: bool = False,
) -> Recordings:
    """Open all files of ``paths``; each stream has its own fields and string pools.

    A path is a log ``.ulg``, ``.mcap``, ``.bag`` or ``.db3``, or the folder of a bag (a stream a
    topic), an NDJSON file whose lines carry ``"stream": "name"`` (many streams), any other table
    (one stream, named like the file), a folder of such files, or ``NAME=FILE`` for a table under
    another name. ``options`` and ``types`` (by stream and field) apply to tables, as for
    `open_recording`; ``utc`` applies to ``.ulg``, as for `open_ulog`. A table without rows is an
    error, or no stream with ``skip_empty``.

    Raises `WireError`, also if two files have streams of one name; `OSError` if a file cannot be
    read. Memory: the whole of a log, and the text of a file of many streams.
    """
    found: dict[str, Recording] = {}
    notes: list[str] = []
    dropouts: int | None = None
    lost = 0
    for name, path in _files(paths):
        if is_log(path):
            if name is not None:
                raise _many(name, path)
            log = _open_log(path, utc=utc)
            opened = dict(log.recordings)
            if log.dropouts is not None:
                dropouts, lost = (dropouts or 0) + log.dropouts, lost + log.lost
            notes.extend(log.notes)
        elif has_many_streams(path):
            if name is not None:
                raise _many(name, path)
            opened = _open_many(path, options.time_column, options.times(), types or {})
        else:
            name = name or valid_name(_stem(path), STREAM)
            kinds = (types or {}).get(name)
            opened = {}
            try:
                opened[name] = open_table(path, options, kinds)
            except EmptyTable:
                if not skip_empty:
                    raise
        for stream, recording in opened.items():
            if stream in found:
                raise WireError(
                    None,
                    f"{path.name}: there is a stream {stream!r} in another file already",
                    "give a table another name: NAME=FILE",
                )
            found[stream] = recording
    return Recordings(dict(sorted(found.items())), dropouts, lost, tuple(notes))


def open_table(
    path: Path, options: TableOptions = GUESSED, types: Mapping[str, FieldType] | None = None
) -> Recording:
    """The recording of one stream: a table, or a file of RDF, of which the time column is the
    property that gives times. Raises as `open_recording`."""
    if is_rdf_file(path):
        return open_rdf(path, options.time_column or "")
    return open_recording(path, options, types)


def open_stream(path: Path | str, name: str, options: TableOptions = GUESSED) -> Recording:
    """The recording of stream ``name`` in a file: a table, whatever its name, or one of the streams
    of a log or of lines that name theirs.

    Raises `WireError`, also if the file has streams of other names only. Cost: of many streams, the
    whole file is read.
    """
    path = Path(path)
    if not has_many_streams(path):
        return open_table(path, options)
    found = open_recordings([path], options)
    if name not in found:
        raise WireError(
            None,
            f"{path.name}: there is no stream {name!r} in this recording",
            f"its streams are {', '.join(found)}",
        )
    return found[name]


def in_order(
    recordings: Mapping[str, Recording], step: int = SECOND
) -> Iterator[tuple[str, Incoming]]:
    """All samples of all streams in order of available time, as ``(stream, batch)``.

    The multiples of ``step`` (ns) cut time into slices, which come in order. A slice has one batch
    of each stream, by first available time, then by name. The rows of each stream keep their order.
    The result is deterministic.

    Cost: O(streams log streams) a slice, nothing per sample. Memory: a chunk of each stream.
    """
    if step <= 0:
        raise ValueError("a slice of time is longer than 0")
    parts = [_slices(name, recording, step) for name, recording in sorted(recordings.items())]
    for (_, _, name), incoming in heapq.merge(*parts, key=lambda part: part[0]):
        yield name, incoming


def is_log(path: Path) -> bool:
    """Whether ``path`` is a log that a vehicle or robot has recorded, with a stream a topic."""
    return path.name.lower().endswith(_LOGS) or (path / METADATA).is_file()


def has_many_streams(path: Path) -> bool:
    """Whether ``path`` names its streams: a log, or NDJSON whose first line names its stream.

    A pipe does not: its lines can be read only once.
    """
    if is_log(path):
        return True
    if path.is_fifo():
        return False
    if not path.name.lower().removesuffix(".gz").endswith(NDJSON):
        return False
    for _, rows in decode_rows(islice(read_lines(path), 1)):
        return isinstance(rows[0].get(STREAM), str)
    return False


def _slices(
    name: str, recording: Recording, step: int
) -> Iterator[tuple[tuple[int, int, str], Incoming]]:
    """A stream in slices, each with its sort key."""
    reached = TIME_MIN
    for incoming in recording:
        # A table's available times may step back; such a row comes with the rows before it.
        times = np.maximum(np.maximum.accumulate(incoming.batch.available), reached)
        reached = int(times[-1])
        slots = times // step
        edges = [0, *(np.flatnonzero(slots[1:] != slots[:-1]) + 1).tolist(), len(times)]
        for start, end in pairwise(edges):
            batch = incoming.batch.take(slice(start, end))
            order = (int(slots[start]), int(times[start]), name)
            yield order, Incoming(batch, incoming.stamped)


def _files(paths: Sequence[Path | str]) -> Iterator[tuple[str | None, Path]]:
    """Every file, with its given name."""
    for given in paths:
        named = _NAMED(given) if isinstance(given, str) and not Path(given).exists() else None
        path = Path(given if named is None else named[2])
        if not path.is_dir() or is_log(path):
            yield (None if named is None else named[1]), path
            continue
        if named is not None:
            raise _many(named[1], path)
        inside = sorted(p for p in path.iterdir() if _is_recording(p))
        if not inside:
            raise WireError(None, f"{path}: there is no recording in this folder")
        yield from ((None, p) for p in inside)


def _is_recording(path: Path) -> bool:
    if path.is_dir():
        return is_log(path)
    return is_log(path) or path.name.lower().removesuffix(".gz").endswith(_TABLES)


def _open_log(path: Path, *, utc: bool) -> TopicLog:
    name = path.name.lower()
    if name.endswith(_ULOG):
        return open_ulog(path, utc=utc)
    return open_mcap(path) if name.endswith(_MCAP) else open_rosbag(path)


def _stem(path: Path) -> str:
    name = path.name
    for ending in (".gz", *_TABLES):
        if name.lower().endswith(ending):
            name = name[: -len(ending)]
    return name


def _open_many(
    path: Path, time_column: str | None, times: TimeReader, types: Types
) -> dict[str, Recording]:
    """A recording for each stream that the lines of the file name."""
    texts: dict[str, list[tuple[int, bytes]]] = {}
    for number, line in read_lines(path):
        for _, (row,) in decode_rows([(number, line)]):
            name = row.get(STREAM)
            if not isinstance(name, str):
                raise WireError(
                    number,
                    f"{STREAM!r} is missing, and the lines before name their stream",
                    'write "stream": "name" in every line or in none',
                )
            if valid_name(name, STREAM) != name:
                raise WireError(
                    number,
                    f"{name!r} is no name of a stream",
                    "a name has letters, digits and _, and begins with a letter",
                )
            texts.setdefault(name, []).append((number, line))
    # The times of one file are in one unit, which the greatest of all its streams decides.
    found: dict[str, Recording] = {}
    for name, numbered in texts.items():
        rows: Callable[[], Iterator[ValueChunk]] = partial(_rows, numbered)
        found[name] = open_rows(rows, time_column, times, types.get(name), {})
    return found


def _rows(numbered: Sequence[tuple[int, bytes]]) -> Iterator[ValueChunk]:
    for lines, rows in decode_rows(numbered):
        plain: list[dict[str, Any]] = [
            {key: value for key, value in row.items() if key != STREAM} for row in rows
        ]
        yield lines, plain


def _many(name: str, path: Path) -> WireError:
    return WireError(
        None, f"{path.name} holds many streams, {name!r} can name only one", "leave the name out"
    )
