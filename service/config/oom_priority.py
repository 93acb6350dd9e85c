"""The priority of processes that the kernel should end first when memory runs out: snapshots and
workers, which the service can replace."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Final

_FIRST: Final = "1000"


def be_dispensable() -> None:
    """Make this process, not the service, the first that the kernel ends when the machine or the
    container has no memory left (Linux)."""
    with suppress(OSError):  # no /proc: the kernel chooses
        Path("/proc/self/oom_score_adj").write_text(_FIRST)
