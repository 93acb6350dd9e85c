"""Messages of robots' logs as samples: a stream a topic, nested members as dotted fields.

`mcap` and `rosbag` give the messages in the order in which they were logged. A sample has the two
times of [DyKnow10 Def. 5.3]: its valid time is the stamp of the message's header, if it has one,
else the time of publication; its available time is the time of the log. All else is a field:
``pose.position.x``; of an array of the same few elements in each message ``q.0``, ``q.1`` ….
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from ...streams.sample import TIME_FIELDS, check_field_name
from ...streams.time import SECOND, TIME_MAX, TIME_MIN
from ..csv_table import CHUNK
from ..errors import WireError
from ..inference import TimeReader
from .names import distinct, valid_name
from .recording import Recording, ValueChunk, open_rows

DAMAGED: Final = (
    struct.error,
    OSError,  # of a position before the file
    EOFError,
    LookupError,
    ValueError,
    TypeError,
    AttributeError,
    AssertionError,
    RuntimeError,  # of lz4
    OverflowError,
    MemoryError,
)
"""What libraries raise for damaged data, beside errors of their own."""
MOST_ELEMENTS: Final = 16
"""An array of more elements is no set of fields: a covariance of 9 is, an image is not."""
HEADER: Final = "header"
STAMP: Final = "stamp"
_VALID: Final = "valid"
_AVAILABLE: Final = "available"
SECONDS: Final = ("sec", "secs")
NANOSECONDS: Final = ("nanosec", "nsec", "nsecs")
_PLAIN: Final = (bool, int, float, str)


@dataclass(frozen=True, slots=True)
class TopicLog:
    """A log: a recording for each topic, and notes about what differs from the logged data.

    ``dropouts`` counts the gaps in which nothing was logged, ``lost`` is their length in ns; None
    and 0 if the log does not say.
    """

    recordings: Mapping[str, Recording]
    dropouts: int | None = None
    lost: int = 0
    notes: tuple[str, ...] = ()


@dataclass(slots=True)
class Topics:
    """Collects messages by topic. Memory: all values that become fields."""

    _topics: dict[str, _Topic] = field(default_factory=dict)

    def add(self, topic: str, message: Any, logged: int, published: int = 0) -> None:
        """Add a message: a mapping, or an object whose attributes are its members.

        ``logged`` and ``published`` are in ns; 0 for a time of publication that is not known.
        Raises `WireError` with the topic for a time outside 64 bits.
        """
        self._topics.setdefault(topic, _Topic(topic)).add(message, logged, published or logged)

    def log(self, name: str, notes: Sequence[str] = ()) -> TopicLog:
        """All topics as streams. Raises `WireError` if no topic has a field."""
        found: dict[str, Recording] = {}
        told = list(notes)
        for name_of_topic, topic in sorted(self._topics.items()):
            recording = topic.recording(told)
            if recording is not None:
                stream = distinct(valid_name(name_of_topic.strip("/"), "topic"), found)
                found[stream] = recording
        if not found:
            reasons = "; ".join(told)
            raise WireError(None, f"{name}: the log has no messages that can be read", reasons)
        return TopicLog(dict(sorted(found.items())), notes=tuple(told))


@dataclass(slots=True)
class _Array:
    """The elements of an array; None if they cannot be fields."""

    size: int
    elements: tuple[Any, ...] | None


class _Topic:
    """The messages of a topic, as rows of plain values and arrays."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._rows: list[dict[str, Any]] = []
        self._stamped = 0
        self._beyond: set[str] = set()
        """Fields with an integer beyond 64 bits."""
        self._arrays: dict[str, set[int]] = {}
        """Each array's sizes; -1 for one whose elements are no values."""

    def add(self, message: Any, logged: int, published: int) -> None:
        members = dict(_members(message))
        stamp = _stamp(members)
        self._stamped += stamp is not None
        row: dict[str, Any] = {}
        self._flatten("", members, row)
        valid = published if stamp is None else stamp
        for time in (valid, logged):
            if not TIME_MIN <= time <= TIME_MAX:
                raise WireError(None, f"{self._name}: its times are outside 64-bit nanoseconds")
        self._rows.append({_VALID: valid, _AVAILABLE: logged, **row})

    def recording(self, notes: list[str]) -> Recording | None:
        """The samples; None if there is no field. Appends to ``notes`` what was left out."""
        kept = {}
        for name, sizes in self._arrays.items():
            if len(sizes) == 1 and 0 < max(sizes) <= MOST_ELEMENTS:
                kept[name] = max(sizes)
            else:
                notes.append(f"{self._name}: {name} is left out, {_array_note(sizes)}")
        notes += [
            f"{self._name}: {name} is a float: not all of its integers fit signed 64 bits"
            for name in sorted(self._beyond)
        ]
        rows = [_expanded(row, kept) for row in self._rows]
        if not any(len(row) > len(TIME_FIELDS) for row in rows):
            notes.append(f"{self._name} has no fields beside its times")
            return None

        def read() -> Iterator[ValueChunk]:
            for start in range(0, len(rows), CHUNK):
                part = rows[start : start + CHUNK]
                yield list(range(start + 1, start + 1 + len(part))), part

        clock = f"{HEADER}.{STAMP}" if self._stamped else "time of publication"
        return replace(open_rows(read, _VALID, TimeReader("ns"), None, {}), time_column=clock)

    def _flatten(self, prefix: str, members: Mapping[str, Any], row: dict[str, Any]) -> None:
        for key, value in members.items():
            name = _field_name(f"{prefix}{key}", row)
            if isinstance(value, np.generic):
                value = value.item()
            if value is None or isinstance(value, _PLAIN):
                row[name] = self._plain(name, value)
            elif (elements := _elements(value)) is not None:
                array = self._array(name, elements)
                self._arrays.setdefault(name, set()).add(array.size)
                row[name] = array
            else:
                self._flatten(f"{name}.", dict(_members(value)), row)

    def _array(self, name: str, elements: Sequence[Any]) -> _Array:
        if len(elements) > MOST_ELEMENTS:
            return _Array(len(elements), None)
        values = [each.item() if isinstance(each, np.generic) else each for each in elements]
        if not all(value is None or isinstance(value, _PLAIN) for value in values):
            return _Array(-1, None)
        return _Array(len(values), tuple(self._plain(name, value) for value in values))

    def _plain(self, name: str, value: Any) -> Any:
        if isinstance(value, float) and not math.isfinite(value):
            return None
        if isinstance(value, int) and not -(2**63) <= value < 2**63:
            self._beyond.add(name)
            return float(value)
        return value


def _members(message: Any) -> Iterable[tuple[str, Any]]:
    if isinstance(message, Mapping):
        return ((str(key), value) for key, value in message.items())
    # mcap-ros2-support makes slots, rosbags a dataclass that also has the type's name.
    names = getattr(type(message), "__slots__", None) or vars(message)
    return [(name, getattr(message, name)) for name in names if not name.startswith("_")]


def _elements(value: Any) -> Sequence[Any] | None:
    """The elements of an array, None if ``value`` is none."""
    if isinstance(value, np.ndarray):
        return list(value.flat) if value.size <= MOST_ELEMENTS else range(value.size)
    if isinstance(value, Mapping) or not hasattr(value, "__len__"):
        return None
    found: Sequence[Any] = value
    return found


def _stamp(members: dict[str, Any]) -> int | None:
    """Take the stamp (ns) out of a message's header; None for no stamp, or one of 0."""
    header = members.get(HEADER)
    if header is None or isinstance(header, _PLAIN) or _elements(header) is not None:
        return None
    inside = dict(_members(header))
    stamp = inside.get(STAMP)
    if stamp is None or isinstance(stamp, _PLAIN) or _elements(stamp) is not None:
        return None
    parts = dict(_members(stamp))
    seconds = next((parts[name] for name in SECONDS if name in parts), None)
    rest = next((parts[name] for name in NANOSECONDS if name in parts), None)
    if not isinstance(seconds, int) or not isinstance(rest, int):
        return None
    members[HEADER] = {name: value for name, value in inside.items() if name != STAMP}
    return seconds * SECOND + rest or None


def _field_name(key: str, taken: Mapping[str, Any]) -> str:
    try:
        check_field_name(key)
    except ValueError:
        return distinct(valid_name(key, "field"), taken)
    return f"{key}_" if key in TIME_FIELDS else key


def _expanded(row: Mapping[str, Any], kept: Mapping[str, int]) -> dict[str, Any]:
    """The row with the elements of its arrays as fields."""
    found: dict[str, Any] = {}
    for name, value in row.items():
        if not isinstance(value, _Array):
            found[name] = value
        elif name in kept and value.elements is not None:
            found.update((f"{name}.{i}", each) for i, each in enumerate(value.elements))
    return found


def _array_note(sizes: set[int]) -> str:
    if sizes <= {-1}:
        return "an array of structures"
    if len(sizes) > 1:
        return "an array of changing length"
    return f"an array of {max(sizes):,} elements; up to {MOST_ELEMENTS} become fields"
