"""File descriptors: a client is one, and many systems allow a process 1,024 unless it asks."""

from __future__ import annotations

import resource

RESERVED = 256
"""Descriptors that event-stream clients never take: publishers, readers and files need some."""


def raise_limit() -> None:
    """Ask for as many descriptors as this process may have. Called once, by `dyknow serve`."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        try:
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
        except (ValueError, OSError):
            # Some systems do not let a process have what they call unlimited.
            return


def places(wanted: int, reserved: int = RESERVED) -> int:
    """How many of ``wanted`` clients there are descriptors for, when so many are left for others;
    at least one."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY:
        return wanted
    return max(1, min(wanted, soft - reserved))
