"""How much memory the service may take; what would make it grow is refused beyond.

Every kind of thing has bounds of its own (quotas, retention, windows), and none of these knows how
much the machine has. This does: while the process is larger than its limit, what makes something
(`GROWS`) is answered with 503, and so are samples and ontologies, once they are there
(`Keeper.check_room`): who sends megabytes hears of a refusal at their end only. Reading, event
streams and what removes something go on, so that there is a way back.
"""

from __future__ import annotations

import ctypes
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from ..config.logs import log
from ..config.settings import MEBIBYTE, Settings
from ..http.problems import Problem
from .scopes import ADMIN

CAN: Final = sys.platform == "linux"
"""Elsewhere nothing tells at this price how large the process is, and there is no limit."""
GROWS: Final = frozenset(route for route in ADMIN if not route.startswith("DELETE ")) - {
    # It may say that a stream is to keep less; one without samples takes next to nothing.
    "PUT /streams/{name}",
    # It may only remove units; whether it does stands in its text.
    "POST /specifications",
    # Its bodies may be long.
    "POST /ontologies",
}
"""Routes after which there is more than before, whose bodies are short."""
_LEAST: Final = 512 * MEBIBYTE
"""Nothing is set to less by itself: a service takes 0.4 GiB that has nothing in it, where it has
compiled its loops itself (0.25 where not), and would refuse the first sample."""
_LOOK: Final = 0.02
"""Seconds for which a look at the size of the process holds."""
_NEAR: Final = 0.9
"""From this part of the limit on, what is free in the heap is given back."""
_SHARE: Final = 0.01
"""Of the time, that giving back may take."""
_APART: Final = 1.0
"""Seconds between two times, at least."""
_PATIENCE: Final = "5"
"""Seconds after which to try again."""


class Memory:
    """The bound on the size of the process. ``limit`` in bytes, 0: there is none; ``used`` tells
    the size (`resident`), ``give_back`` lets the system have what is free in the heap; ``clock``
    in seconds.

    Cost: a look at the clock; 50 times a second 10 µs.
    """

    def __init__(
        self,
        limit: int = 0,
        used: Callable[[], int] | None = None,
        give_back: Callable[[], object] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._used = used or resident
        self._give_back = give_back or _trim
        self._clock = clock
        self._seen = 0
        self._looked = self._due = float("-inf")
        self.limit = limit if limit and self._can() else 0
        self.refused = 0
        """How often something was."""

    @classmethod
    def of(cls, settings: Settings) -> Memory:
        """As the settings say, or else as large as the machine allows (`limit_of`)."""
        machine, given = there_is(), settings.memory_limit
        memory = cls(limit_of(machine) if given is None else given)
        if 0 < memory.limit < _LEAST or 0 < machine < 2 * _LEAST:
            log().warning(
                "there is little memory for a service",
                limit=memory.limit,
                machine=machine,
                hint="it takes 0.4 GiB without streams after its first start, its workers theirs",
            )
        if memory.limit:
            # Arrow's own heap keeps what is free for half a minute in each thread, and gives
            # nothing back when told to. It is asked once, when Arrow is loaded.
            os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")
        return memory

    def _can(self) -> bool:
        """Whether anybody tells how large the process is."""
        if self._used is resident and not CAN:
            return False
        try:
            self._used()
        except OSError as error:  # a jail without /proc, say
            log().warning("there is no limit to the memory of the service", reason=str(error))
            return False
        return True

    def within(self, size: int, part: int) -> int:
        """``size`` bytes, or the ``part``-th part of the limit where that is less."""
        return min(size, self.limit // part) if self.limit else size

    @property
    def used(self) -> int:
        """Bytes that the process takes; 0 without a limit, when nobody looks."""
        if self.limit and (now := self._clock()) - self._looked >= _LOOK:
            with suppress(OSError):  # no file can be opened just now: as large as it was
                self._seen = self._used()
            self._looked = now
        return self._seen

    @property
    def is_short(self) -> bool:
        """Whether the limit is reached."""
        return self.limit > 0 and self.used >= self.limit

    def check(self) -> None:
        """Before there is more. Raises a 503 `Problem` while the limit is reached."""
        if self.is_short:
            self.refused += 1
            raise Problem(
                503,
                "memory is short",
                self._told(),
                headers={"Retry-After": _PATIENCE},
            )

    def check_route(self, route: str) -> None:
        """The same, if there is more after ``route``."""
        if self.limit and route in GROWS:
            self.check()

    def review(self) -> None:
        """Now and then: near the limit, give back what is free.

        What was removed is free in the heap, and the process stays as large: the C library keeps
        it for the next who asks, and does not know of the limit.
        """
        if not self.limit or self.used < _NEAR * self.limit or self._clock() < self._due:
            return
        begun = self._clock()
        self._give_back()
        ended = self._clock()
        self._due = ended + max(_APART, (ended - begun) / _SHARE)
        self._looked = float("-inf")

    def reasons(self) -> list[str]:
        """Why the service is not ready: nothing if there is room."""
        return [f"memory: {self._told()}"] if self.is_short else []

    def _told(self) -> str:
        return (
            f"the service takes {self._seen // MEBIBYTE:,} MiB of memory; "
            f"it may have {self.limit // MEBIBYTE:,}"
        )


def limit_of(machine: int) -> int:
    """What the service takes for its limit on a machine, or in a container, with so many bytes.

    Half of it: a copy of the process writes checkpoints, and takes as much again in the worst case;
    workers have theirs. Never less than a service needs that has next to nothing in it.
    """
    return max(machine // 2, _LEAST) if machine else 0


def resident() -> int:
    """Bytes of memory that this process takes at present (Linux)."""
    with open("/proc/self/statm", "rb") as file:
        return int(file.read().split()[1]) * _PAGE


def there_is(proc: Path = Path("/proc"), groups: Path = Path("/sys/fs/cgroup")) -> int:
    """Bytes of memory that this process may come to: those of the machine, or of the control group
    (container, systemd unit) that bounds it. 0 where nothing tells."""
    try:
        machine = int(_PAGE * os.sysconf("SC_PHYS_PAGES"))
    except (ValueError, OSError, AttributeError):
        machine = 0
    return min((each for each in (machine, *_limits(proc, groups)) if each > 0), default=0)


def _limits(proc: Path, groups: Path) -> Iterator[int]:
    """The limits of the control groups that the process is in, of both versions of them."""
    try:
        lines = (proc / "self" / "cgroup").read_text().splitlines()
    except OSError:
        return
    for line in lines:
        _, kinds, path = line.split(":", 2)
        if not kinds:
            folder, name = groups, "memory.max"
        elif "memory" in kinds.split(","):
            folder, name = groups / "memory", "memory.limit_in_bytes"
        else:
            continue
        # Each group within another has that one's limit, too. In a container the path may be one of
        # the host's, and what can be seen is the container's own.
        parts = [part for part in path.split("/") if part not in ("", "..")]
        for count in range(len(parts), -1, -1):
            try:
                text = folder.joinpath(*parts[:count], name).read_text().strip()
            except OSError:
                continue
            if text.isdigit():
                yield int(text)


def _pages() -> int:
    try:
        return int(os.sysconf("SC_PAGE_SIZE"))
    except (ValueError, OSError, AttributeError):
        return 4096


_PAGE: Final = _pages()


def _trim() -> None:
    """Give back what is free in the heap of the C library, if it can."""
    trim: Any = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
