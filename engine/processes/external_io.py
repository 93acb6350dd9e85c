"""What comes from the world outside by user-written code, so that it can be given again: what
sources read, and what went wrong in sinks.

All else that an engine does follows from its commands; what a user-written source says does not. So
it is written down with the tick that asked for it, and a tick that is done again asks the tape.

How much a source says is not known before it is asked. What finds no room to be written down is
dropped, as if it had not been asked; and it is asked no more until there is room for as much.

What went wrong in a sink is not known before it was called either. It changes nothing and is told
to nobody until it is written down, as a command of its own after the one in which the sink was
called: a sink is not called again for what is done again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

import msgspec

from ..model.process_reports import Report

READINGS = 16
"""Bytes that readings take in a tick beside their own."""
_LEAST = 256
"""Bytes of a reading that tells only that the source did not come back, beside its name."""


class Reading(msgspec.Struct, frozen=True, omit_defaults=True):
    """What ``source`` said at ``time`` (ns): a sample ``(available, valid, values)`` or none, and
    what it reported of its stream; or the text of its ``error``, with ``is_blocked`` that it did
    not come back in time."""

    source: str
    time: int
    sample: tuple[int, int, dict[str, float | int | bool | str | None]] | None = None
    quality: float | None = None
    contains: str | None = None
    error: str | None = None
    is_blocked: bool = False

    @property
    def report(self) -> Report | None:
        """What it reported."""
        if self.quality is None and self.contains is None:
            return None
        return Report(None, self.quality, self.contains)


class Failed(msgspec.Struct, frozen=True, omit_defaults=True):
    """A call of a sink with a sample of ``time`` (ns) that failed; ``verdict`` is what its rule
    makes of that, and ``reason`` why."""

    time: int
    text: str
    verdict: str
    reason: str = ""


class Outcome(msgspec.Struct, frozen=True, omit_defaults=True):
    """What came of some calls of the ``sink`` (its unit's name) where that is of interest: what
    failed, and how many calls have failed ``in_a_row`` now."""

    sink: str
    failed: tuple[Failed, ...] = ()
    in_a_row: int = 0


class Tape:
    """Records readings, or gives them again: `is_playing`.

    Law: whoever plays what was recorded does what was done, also where a source did not come back,
    came back too late, or was not asked for lack of room.
    """

    def __init__(self) -> None:
        self._made: list[Reading] = []
        self._size = 0
        self._kept: deque[Reading] = deque()
        self._has_room: Callable[[int], bool] = lambda _: True
        self._needs: dict[str, int] = {}
        """So many bytes were needed for each stream whose source found no room."""
        self.is_playing = False
        self.outcomes: list[Outcome] = []
        """Of sinks, not written down yet."""

    @property
    def unread(self) -> str | None:
        """Which sources are not asked, and why; None: all are."""
        if not self._needs:
            return None
        return (
            f"there is no room left on the disk for what {', '.join(sorted(self._needs))} may say; "
            "not asked until there is"
        )

    def record(self, has_room: Callable[[int], bool]) -> None:
        """From now on sources are read; ``has_room(size)``: so many bytes of readings can be
        written down."""
        self._made = []
        self._size = 0
        self._has_room = has_room
        if self._needs and has_room(max(self._needs.values())):
            self._needs.clear()

    def taken(self) -> tuple[Reading, ...]:
        """What was read since `record`."""
        return tuple(self._made)

    def play(self, readings: Sequence[Reading]) -> None:
        """What sources will say."""
        self._kept = deque(readings)

    def turn(self, source: str, stream: str) -> Turn:
        """``source``, whose stream is called so, is to be asked, for one due time or several."""
        return Turn(self, source, stream)

    # -- for turns ---------------------------------------------------------------------------

    def allows(self, stream: str, size: int) -> bool:
        """Whether the source of ``stream`` may be asked, that has said ``size`` bytes by now."""
        return self.takes(stream, size + max(_LEAST, self._needs.get(stream, 0)))

    def takes(self, stream: str, size: int) -> bool:
        """Whether so many bytes for ``stream`` can be written down."""
        if self._has_room(self._size + size):
            return True
        self._needs[stream] = max(size, self._needs.get(stream, 0))
        return False

    def add(self, readings: Sequence[Reading], size: int) -> None:
        """What was said in a turn, in ``size`` bytes at most."""
        self._made += readings
        self._size += size

    def next(self, source: str, time: int) -> Reading | None:
        """What ``source`` said at ``time``; None: it was not asked."""
        if self._kept and (self._kept[0].source, self._kept[0].time) == (source, time):
            return self._kept.popleft()
        return None


class Turn:
    """The due times at which one source is asked, one after the other. `ask` may be called in
    another thread; one that is left behind there says nothing to anybody any more."""

    def __init__(self, tape: Tape, source: str, stream: str) -> None:
        self.is_playing = tape.is_playing
        self._tape = tape
        self._source = source
        self._stream = stream
        self._said: list[Reading | None] = []
        self._size = 0
        self._is_over = False

    def ask(self, time: int, read: Callable[[], Reading]) -> Reading | None:
        """What the source says at ``time``: what ``read`` gives, or what that was. None: there is
        no room for it, and it has said nothing."""
        found = self._tape.next(self._source, time) if self.is_playing else self._read(read)
        self._said.append(found)
        return found

    def end(self, count: int, time: int, blocked: str | None) -> int:
        """The turn is over: ``count`` times the source came back; ``blocked`` says that it did not
        at ``time``. Gives how often it was not asked for lack of room."""
        self._is_over = True
        said = self._said[:count]
        if not self.is_playing:
            if blocked is not None:
                said.append(Reading(self._source, time, error=blocked, is_blocked=True))
            readings = [reading for reading in said if reading is not None]
            self._tape.add(readings, sum(map(size_of, readings)))
        return said.count(None)

    def _read(self, read: Callable[[], Reading]) -> Reading | None:
        least = self._size + len(self._source.encode())
        if self._is_over or not self._tape.allows(self._stream, least):
            return None
        reading = read()
        size = size_of(reading)
        if self._is_over or not self._tape.takes(self._stream, self._size + size):
            return None
        self._size += size
        return reading


def size_of(reading: Reading) -> int:
    """Bytes of a reading as it is written down. Cost: O(bytes)."""
    return len(msgspec.msgpack.encode(reading))
