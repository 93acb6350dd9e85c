"""Waiting for what a service does by its own clock."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

PATIENCE = 120.0
"""Seconds: only what never comes takes so long."""

HANGS = 600.0
"""Seconds for a script of many commands: it is killed only if it hangs."""


def until(found: Callable[[], T], seconds: float = PATIENCE, said: object = "") -> T:
    """What ``found()`` gives as soon as that is true; ``said`` helps to see why it never was."""
    end, pause = time.monotonic() + seconds, 0.01
    while not (given := found()):
        assert time.monotonic() < end, (given, said)
        time.sleep(pause)
        # A service that answers many questions makes less progress.
        pause = min(1.3 * pause, 0.25)
    return given
