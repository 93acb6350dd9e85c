"""Records the readings of user-written sources and the failures of sinks, and replays them.

The engine is a function of its commands, but a user-written source reads the outside world. The log
therefore has the readings of a tick with the tick, and a replayed tick takes them from the tape.

The size of a reading is unknown before the source is called. If the log has no room for it, the
engine drops the reading, and does not call the source until there is room for as much.

The failure of a sink is also unknown before its call. The engine counts and reports it only when
it is in the log, as a command of its own after the one that called the sink. Replay does not call
sinks.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

import msgspec

from ..model.process_reports import Report

READINGS = 16
"""Bytes of a tick's record for the list of readings itself."""
_BLOCKED_SIZE = 256
"""Bytes of a reading that says only that the source did not return, without its name."""


class Reading(msgspec.Struct, frozen=True, omit_defaults=True):
    """The answer of ``source`` at ``time`` (ns): a sample ``(available, valid, values)`` or none,
    with the parts of its report. Or the text of its ``error``; ``is_blocked``: it did not return
    within its deadline. The log contains such records."""

    source: str
    time: int
    sample: tuple[int, int, dict[str, float | int | bool | str | None]] | None = None
    quality: float | None = None
    contains: str | None = None
    error: str | None = None
    is_blocked: bool = False

    @property
    def report(self) -> Report | None:
        """The report of the source about its stream."""
        if self.quality is None and self.contains is None:
            return None
        return Report(None, self.quality, self.contains)


class Failed(msgspec.Struct, frozen=True, omit_defaults=True):
    """A failed call of a sink with a sample of ``time`` (ns). ``verdict`` is the decision of its
    rule, ``reason`` the reason for that."""

    time: int
    text: str
    verdict: str
    reason: str = ""


class Outcome(msgspec.Struct, frozen=True, omit_defaults=True):
    """The failures of some calls of ``sink`` (its name in the configuration), and the number of
    calls that have failed ``in_a_row`` by now. The log contains such records."""

    sink: str
    failed: tuple[Failed, ...] = ()
    in_a_row: int = 0


class Tape:
    """Records readings, or replays them (`is_replaying`).

    Law: replaying a recording has the effects of the first run, also if a source blocked, returned
    too late, or was not called for lack of room.
    """

    def __init__(self) -> None:
        self._recorded: list[Reading] = []
        self._size = 0
        self._to_replay: deque[Reading] = deque()
        self._has_room: Callable[[int], bool] = lambda _: True
        self._needs: dict[str, int] = {}
        """The bytes needed for each stream whose source had no room."""
        self.is_replaying = False
        self.outcomes: list[Outcome] = []
        """Outcomes of sinks that are not in the log yet."""

    @property
    def unread(self) -> str | None:
        """A message with the sources that are not called, and why; None: all are called."""
        if not self._needs:
            return None
        return (
            f"the disk has no room for the readings of {', '.join(sorted(self._needs))}; these "
            "sources are not read until it has"
        )

    def record(self, has_room: Callable[[int], bool]) -> None:
        """Start a recording. ``has_room(size)`` returns whether the log has room for so many bytes
        of readings."""
        self._recorded = []
        self._size = 0
        self._has_room = has_room
        if self._needs and has_room(max(self._needs.values())):
            self._needs.clear()

    def readings(self) -> tuple[Reading, ...]:
        """Return the readings since `record`."""
        return tuple(self._recorded)

    def replay(self, readings: Sequence[Reading]) -> None:
        """Give ``readings`` in place of those of the sources."""
        self._to_replay = deque(readings)

    def turn(self, source: str, stream: str) -> ReadingTurn:
        """Begin a turn of ``source``, whose output is ``stream``, with one due time or several."""
        return ReadingTurn(self, source, stream)

    # -- for turns ---------------------------------------------------------------------------

    def can_call(self, stream: str, size: int) -> bool:
        """Whether the source of ``stream`` may be called, after ``size`` bytes in this turn."""
        # A call may block, and the record of that needs room as well.
        return self.can_add(stream, size + max(_BLOCKED_SIZE, self._needs.get(stream, 0)))

    def can_add(self, stream: str, size: int) -> bool:
        """Whether the log has room for ``size`` bytes of ``stream``."""
        if self._has_room(self._size + size):
            return True
        self._needs[stream] = max(size, self._needs.get(stream, 0))
        return False

    def add(self, readings: Sequence[Reading], size: int) -> None:
        """Add the readings of a turn, of at most ``size`` bytes."""
        self._recorded += readings
        self._size += size

    def next_reading(self, source: str, time: int) -> Reading | None:
        """Return the recorded reading of ``source`` at ``time``; None: it was not called."""
        head = self._to_replay[0] if self._to_replay else None
        if head is None or (head.source, head.time) != (source, time):
            return None
        return self._to_replay.popleft()


class ReadingTurn:
    """The readings of one source at its due times in a tick. `read` may run on a watchdog's thread;
    after `end` that thread has no effect any more."""

    def __init__(self, tape: Tape, source: str, stream: str) -> None:
        self.is_replaying = tape.is_replaying
        self._tape = tape
        self._source = source
        self._stream = stream
        self._readings: list[Reading | None] = []
        self._size = 0
        self._is_over = False

    def read(self, time: int, call: Callable[[], Reading]) -> Reading | None:
        """Return the reading at ``time``: that of ``call``, or the recorded one. None: the log has
        no room for it, so it does not count."""
        if self.is_replaying:
            found = self._tape.next_reading(self._source, time)
        else:
            found = self._call(call)
        self._readings.append(found)
        return found

    def end(self, count: int, time: int, blocked: str | None) -> int:
        """End the turn, in which ``count`` calls returned. ``blocked`` is the error of the call at
        ``time`` that did not return. Return the number of due times without room."""
        self._is_over = True
        readings = self._readings[:count]
        if not self.is_replaying:
            if blocked is not None:
                readings.append(Reading(self._source, time, error=blocked, is_blocked=True))
            recorded = [reading for reading in readings if reading is not None]
            self._tape.add(recorded, sum(map(size_of, recorded)))
        return readings.count(None)

    def _call(self, call: Callable[[], Reading]) -> Reading | None:
        least = self._size + len(self._source.encode())
        if self._is_over or not self._tape.can_call(self._stream, least):
            return None
        # The call may outlast its deadline, so `end` may come before the next line.
        reading = call()
        size = size_of(reading)
        if self._is_over or not self._tape.can_add(self._stream, self._size + size):
            return None
        self._size += size
        return reading


def size_of(reading: Reading) -> int:
    """Return the bytes of a reading in the log. Cost: O(bytes)."""
    return len(msgspec.msgpack.encode(reading))
