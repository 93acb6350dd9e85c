"""Processes that the service can do without for a while: its copies (snapshots), and workers."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Final

_FIRST: Final = "1000"


def be_dispensable() -> None:
    """Where the machine or the container has no memory left, this process is the first that the
    kernel ends, and not the service (Linux)."""
    with suppress(OSError):  # no /proc: then nobody knows which of them it will be
        Path("/proc/self/oom_score_adj").write_text(_FIRST)
