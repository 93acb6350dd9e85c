"""The memory limit of the service: above it, requests that need more memory get 503.

Quotas, retention and windows limit each kind of thing, but know nothing of the machine. While the
process is larger than its limit, the gate refuses the routes that create something (`GROWS`);
`CommandQueue.check_room` refuses samples and ontologies when their body has arrived, since a client
reads an answer only after sending it. Reading, event streams and removal go on, so that a user can
free memory.
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

from ..config.address_space import process_size
from ..config.logs import log
from ..config.settings import MEBIBYTE, Settings
from ..http.problems import Problem
from .scopes import ADMIN

CAN: Final = sys.platform == "linux"
"""Other systems have no such cheap measure of the process, and there is no limit."""
GROWS: Final = frozenset(route for route in ADMIN if not route.startswith("DELETE ")) - {
    # It may reduce the retention of a stream; a stream without samples takes little memory.
    "PUT /streams/{name}",
    # It may only remove units; only its text shows that.
    "POST /specifications",
    # Its bodies may be long: `CommandQueue.check_room` refuses them.
    "POST /ontologies",
}
"""Routes with short bodies that create something."""
_LEAST: Final = 512 * MEBIBYTE
"""The least default limit: an empty service takes 0.4 GiB after compiling its loops (0.25 if they
were cached), and would refuse the first sample."""
_LOOK: Final = 0.02
"""Seconds for which the measured size of the process is used."""
_NEAR: Final = 0.9
"""The part of the limit from which free heap memory is returned to the system."""
_SHARE: Final = 0.01
"""The part of the time that this may take."""
_APART: Final = 1.0
"""Seconds from one time to the next, at least."""
_PAGE: Final = os.sysconf("SC_PAGE_SIZE")
_PATIENCE: Final = "5"
"""Seconds after which a refused client should try again."""


class Memory:
    """The limit on the size of the process. ``limit`` in bytes, 0: none; ``used`` returns the size
    (`resident`), ``give_back`` returns free heap memory to the system; ``clock`` in seconds.

    Cost: a call of the clock; 50 times a second 10 µs.
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
        """Refused requests."""

    @classmethod
    def of(cls, settings: Settings) -> Memory:
        """The limit of the settings, or else by the memory of the machine (`default_limit`)."""
        machine, given = available_memory(), settings.memory_limit
        memory = cls(default_limit(machine) if given is None else given)
        if 0 < memory.limit < _LEAST or 0 < machine < 2 * _LEAST:
            log().warning(
                "there is little memory for a service",
                limit=memory.limit,
                machine=machine,
                hint="it takes 0.4 GiB without streams after its first start, its workers theirs",
            )
        if memory.limit:
            # Arrow's own heap keeps free memory for half a minute in each thread, even when asked
            # to release it. Arrow reads this variable once, when it is loaded.
            os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")
        return memory

    def _can(self) -> bool:
        """Whether the size of the process can be read."""
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
        """Bytes that the process takes; 0 without a limit, when it is not measured."""
        if self.limit and (now := self._clock()) - self._looked >= _LOOK:
            with suppress(OSError):  # no free file descriptor: keep the last size
                self._seen = self._used()
            self._looked = now
        return self._seen

    @property
    def is_short(self) -> bool:
        """Whether the limit is reached."""
        return self.limit > 0 and self.used >= self.limit

    def check(self) -> None:
        """Raises a 503 `Problem` while the limit is reached."""
        if self.is_short:
            self.refused += 1
            raise Problem(
                503,
                "memory is short",
                self._detail(),
                headers={"Retry-After": _PATIENCE},
            )

    def check_route(self, route: str) -> None:
        """`check`, if ``route`` creates something."""
        if self.limit and route in GROWS:
            self.check()

    def review(self) -> None:
        """Near the limit, return free heap memory to the system. Called by `Service.tick`.

        The C library keeps freed memory for later allocations, and does not know of the limit; so
        the process would stay as large after a removal.
        """
        if not self.limit or self.used < _NEAR * self.limit or self._clock() < self._due:
            return
        begun = self._clock()
        self._give_back()
        ended = self._clock()
        self._due = ended + max(_APART, (ended - begun) / _SHARE)
        self._looked = float("-inf")

    def reasons(self) -> list[str]:
        """Why the service is not ready: nothing below the limit."""
        return [f"memory: {self._detail()}"] if self.is_short else []

    def _detail(self) -> str:
        return (
            f"the service takes {self._seen // MEBIBYTE:,} MiB of memory; "
            f"it may have {self.limit // MEBIBYTE:,}"
        )


def default_limit(machine: int) -> int:
    """The default limit on a machine, or in a container, with ``machine`` bytes: half of them.

    The copy of the process that writes checkpoints may take as much again, and workers take theirs.
    """
    return max(machine // 2, _LEAST) if machine else 0


def resident() -> int:
    """Bytes of memory that this process takes now (Linux)."""
    return process_size().resident


def available_memory(proc: Path = Path("/proc"), groups: Path = Path("/sys/fs/cgroup")) -> int:
    """Bytes of memory that are available to this process: those of the machine, or of the control
    group (container, systemd unit) that limits it. 0 if unknown."""
    machine = _PAGE * os.sysconf("SC_PHYS_PAGES")
    return min((each for each in (machine, *_limits(proc, groups)) if each > 0), default=0)


def _limits(proc: Path, groups: Path) -> Iterator[int]:
    """The limits of the control groups of the process, in version 1 and 2."""
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
        # A group is limited by its ancestors, too. In a container the path may be the host's, which
        # does not exist here; then the root has the container's limit.
        parts = [part for part in path.split("/") if part not in ("", "..")]
        for count in range(len(parts), -1, -1):
            try:
                text = folder.joinpath(*parts[:count], name).read_text().strip()
            except OSError:
                continue
            if text.isdigit():
                yield int(text)


def _trim() -> None:
    """Return the free memory of the C library's heap to the system, if it can."""
    trim: Any = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
