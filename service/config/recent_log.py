"""The newest lines of the service's log, for `GET /log`: a page cannot read standard error."""

from __future__ import annotations

import logging
from collections import deque
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Final

from .logs import LOG_NAME, mask

KEPT: Final = 1_000
"""Lines that are kept."""
LONGEST: Final = 4_000
"""Characters of one value; the rest of a longer one is cut."""
_OWN: Final = ("event", "level", "timestamp")


@dataclass(frozen=True, slots=True)
class Line:
    """A line of the log. ``level`` is a name of the logging module in small letters; ``values``
    are the further members, as texts without tokens."""

    time: datetime
    level: str
    event: str
    values: dict[str, str] = field(default_factory=dict)


class RecentLog(logging.Handler):
    """Keeps the newest `KEPT` lines of the service's logger between `open` and `close`."""

    def __init__(self) -> None:
        super().__init__()
        self._lines: deque[Line] = deque(maxlen=KEPT)

    def open(self) -> None:
        """Begin to keep lines."""
        logging.getLogger(LOG_NAME).addHandler(self)

    def close(self) -> None:
        """Stop keeping lines."""
        logging.getLogger(LOG_NAME).removeHandler(self)
        super().close()

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a line; see `logging.Handler`."""
        members = record.msg if isinstance(record.msg, dict) else {"event": record.getMessage()}
        values = {
            str(name): mask(str(value))[:LONGEST]
            for name, value in members.items()
            if name not in _OWN and name != "exc_info"
        }
        failure = record.exc_info[1] if record.exc_info else members.get("exc_info")
        if isinstance(failure, BaseException):
            values["error"] = mask(f"{type(failure).__name__}: {failure}")[:LONGEST]
        time = datetime.fromtimestamp(record.created, UTC)
        event = mask(str(members.get("event", "")))[:LONGEST]
        self._lines.append(Line(time, record.levelname.lower(), event, values))

    def lines(self, level: int, most: int) -> list[Line]:
        """Return the newest ``most`` lines of at least a level, newest first."""
        found = (
            line
            for line in reversed(self._lines)
            if logging.getLevelNamesMapping()[line.level.upper()] >= level
        )
        return [line for line, _ in zip(found, range(most), strict=False)]
