"""PX4 flight logs (``.ulg``) as recordings: a stream for each topic instance. Read by pyulog.

Called by `many_streams.open_recordings`. A sample has the two times of [DyKnow10 Def. 5.3]: its
valid time is ``timestamp_sample`` (sensing) if the topic has it, else ``timestamp``; its available
time is ``timestamp`` (publication). A timestamp of publication is unusable if it is 0, does not
increase, or is before the begin of the log. Such a message becomes available when it was logged: at
the greatest timestamp of all messages up to it. The other members of a message are fields.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any, Final

import numpy as np

from ...streams.sample import (
    TIME_FIELDS,
    Column,
    Field,
    FieldType,
    SampleBatch,
    Schema,
    Times,
)
from ...streams.time import MICROSECOND, MILLISECOND, TIME_MAX, TIME_MIN
from ..csv_table import CHUNK
from ..errors import WireError
from .names import distinct, valid_name
from .recording import Recording, running_maximum
from .topics import TopicLog

_TIMES: Final = ("timestamp", "timestamp_sample")
_MAGIC: Final = b"ULog\x01\x12\x35"
_HEADER: Final = 16
_APPENDED: Final = 3 + 8
"""Place of the incompatible flags, with the bit for appended data, in the flag message."""
_SATELLITES: Final = ("vehicle_gps_position", "sensor_gps")
_MOST: Final = (TIME_MAX // 2) // MICROSECOND


def open_ulog(path: Path | str, *, utc: bool = False) -> TopicLog:
    """Read the log at ``path``. Times count from the boot of the vehicle.

    With ``utc`` the first time of a satellite receiver shifts them to UTC. Streams have the name of
    their topic, further instances ``topic_1``, ``topic_2`` …; elements of arrays are fields
    ``q_0``, ``q_1`` …. A number that is not finite is no_value. A topic's available times do not
    decrease, as those of a table.

    Raises `WireError` for a file that is no log, damaged or cut off, or without pyulog; `OSError`
    if the file cannot be read. Memory: the whole log, twice.
    """
    path = Path(path)
    data = path.read_bytes()
    order = _check_whole(path.name, data)
    log = _parse(path.name, data)
    shift = _utc_shift(log) if utc else 0
    begin = np.array(min(int(log.start_timestamp), _MOST), np.int64)
    logged = _logged(log, order)
    notes: list[str] = []
    found: dict[str, Recording] = {}
    for topic in sorted(log.data_list, key=lambda topic: (topic.multi_id, topic.name)):
        wanted = topic.name if topic.multi_id == 0 else f"{topic.name}_{topic.multi_id}"
        name = distinct(valid_name(wanted, "topic"), found)
        if not len(topic.data.get("timestamp", ())):
            notes.append(f"{name} has no messages")
            continue
        whole = _batch(name, topic, shift, begin, logged.get(topic.msg_id, begin), notes)
        if not whole.columns:
            notes.append(f"{name} has no fields beside its times")
            continue
        sensed = "timestamp_sample" in topic.data
        found[name] = _recording(whole, "timestamp_sample" if sensed else "timestamp")
    if not found:
        raise WireError(None, f"{path.name}: the log has no messages")
    lost = sum(int(dropout.duration) for dropout in log.dropouts) * MILLISECOND
    return TopicLog(dict(sorted(found.items())), len(log.dropouts), lost, tuple(notes))


def _check_whole(name: str, data: bytes) -> list[int]:
    """Follow the messages' lengths to the end of the file: pyulog does not report a cut log.

    Returns the topics' numbers of all data messages, in the order of the log.
    """
    order: list[int] = []
    if len(data) < _HEADER or not data.startswith(_MAGIC):
        raise WireError(None, f"{name}: this is no PX4 log (ULog)")
    place = _HEADER
    header = struct.Struct("<HB")
    while place + header.size <= len(data):
        length, kind = header.unpack_from(data, place)
        flags = place + _APPENDED
        if kind == ord("B") and flags < len(data) and data[flags] & 1:
            return []  # data appended after a crash begins in the middle of a message
        if kind == ord("D") and length >= 2 and place + 5 <= len(data):
            order.append(data[place + 3] | data[place + 4] << 8)
        place += header.size + length
    if place != len(data):
        raise WireError(
            None,
            f"{name}: the log is damaged or cut off: its last message ends at byte {place}, the "
            f"file at byte {len(data)}",
            "copy it again from the vehicle",
        )
    return order


def _parse(name: str, data: bytes) -> Any:
    try:
        from pyulog import ULog  # an optional dependency
        from pyulog.exceptions import ULogException
    except ImportError:
        raise WireError(
            None, f"{name}: reading PX4 logs needs pyulog", "pip install 'dyknow[px4]'"
        ) from None
    try:
        # It prints warnings; `file_corruption` has the same information.
        with redirect_stdout(io.StringIO()):
            log = ULog(io.BytesIO(data))
    except (
        ULogException,
        struct.error,
        LookupError,
        ValueError,
        TypeError,
        AttributeError,
        RecursionError,
        OverflowError,
        MemoryError,
    ) as error:
        raise WireError(None, f"{name}: the log is damaged: {error}") from None
    if log.file_corruption:
        raise WireError(
            None,
            f"{name}: the log is damaged: some messages cannot be read",
            "copy it again from the vehicle",
        )
    return log


def _logged(log: Any, order: list[int]) -> dict[int, Times]:
    """The greatest timestamp (µs) in the log up to each message of a topic, by its number.

    It lacks topics with another number of messages than in ``order``.
    """
    numbers = np.array(order, np.int64)
    begin = min(int(log.start_timestamp), _MOST)
    told = np.full(len(order), begin, np.int64)
    places: dict[int, Times] = {}
    for topic in log.data_list:
        times = topic.data.get("timestamp", np.empty(0, np.uint64))
        found = np.flatnonzero(numbers == topic.msg_id)
        if len(found) == len(times):
            told[found] = np.clip(times, begin, _MOST)
            places[topic.msg_id] = found
    reached = np.maximum.accumulate(told)
    return {number: reached[found] for number, found in places.items()}


def _utc_shift(log: Any) -> int:
    """The offset from times since boot to UTC, in ns."""
    for topic in log.data_list:
        told = topic.data.get("time_utc_usec") if topic.name in _SATELLITES else None
        if told is not None and told.any():
            first = int(np.flatnonzero(told)[0])
            shift = (int(told[first]) - int(topic.data["timestamp"][first])) * MICROSECOND
            if not 0 <= shift <= TIME_MAX // 2:
                raise WireError(None, "the time of the satellite receiver is outside 64-bit time")
            return shift
    raise WireError(
        None, "no satellite receiver told the time in this log", "play it in times since boot"
    )


def _batch(
    name: str, topic: Any, shift: int, begin: Times, logged: Times, notes: list[str]
) -> SampleBatch:
    """All messages of a topic as samples.

    ``begin`` (µs) is the begin of the log, ``logged`` the greatest timestamp up to each message.
    """
    told = topic.data["timestamp"]
    published = _times(name, told, shift)
    silent = (told == 0) | (told < begin)
    silent[1:] |= told[1:] <= told[:-1]
    available = np.where(silent, logged * MICROSECOND + shift, published)
    valid = np.where(told == 0, available, published)
    if "timestamp_sample" in topic.data:
        sensed = topic.data["timestamp_sample"]
        # PX4 writes zero for an unknown time.
        valid = np.where(sensed == 0, valid, _times(name, sensed, shift))
    truths = {field.field_name for field in topic.field_data if field.type_str == "bool"}
    columns: dict[str, Column] = {}
    for key, values in topic.data.items():
        if key in _TIMES or key.rpartition(".")[2].startswith("_padding"):
            continue
        short = valid_name(key, "field")
        if short in TIME_FIELDS:
            short += "_"
        column = _column(values, key in truths)
        if column.type is FieldType.FLOAT and values.dtype.kind == "u":
            notes.append(f"{name}.{key} is a float: not all of its integers fit signed 64 bits")
        columns[distinct(short, columns)] = column
    return SampleBatch(running_maximum(available, TIME_MIN), valid, columns)


def _times(name: str, times: Any, shift: int) -> Times:
    if times.dtype.kind not in "ui" or int(times.max()) > _MOST or int(times.min()) < 0:
        raise WireError(None, f"{name}: its times are outside 64-bit nanoseconds")
    return times.astype(np.int64) * MICROSECOND + shift  # type: ignore[no-any-return]


def _column(values: Any, truth: bool) -> Column:
    if truth:
        return Column(FieldType.BOOLEAN, values.astype(np.bool_))
    if values.dtype.kind == "f":
        missing = ~np.isfinite(values)
        plain = np.where(missing, 0.0, values.astype(np.float64))
        return Column(FieldType.FLOAT, plain, missing if missing.any() else None)
    if values.dtype.kind == "u" and int(values.max()) > TIME_MAX:
        return Column(FieldType.FLOAT, values.astype(np.float64))
    return Column(FieldType.INTEGER, values.astype(np.int64))


def _recording(whole: SampleBatch, time_column: str) -> Recording:
    def read() -> Iterator[SampleBatch]:
        for start in range(0, len(whole), CHUNK):
            yield whole.take(slice(start, start + CHUNK))

    schema = Schema(tuple(Field(name, column.type) for name, column in whole.columns.items()))
    return Recording(schema, len(whole), {}, read, True, time_column)
