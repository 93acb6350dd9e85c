"""File descriptors: a client takes one, and many systems allow a process 1,024 by default."""

from __future__ import annotations

import resource

RESERVED = 256
"""Descriptors that clients of event streams do not take: other clients and files need some."""


def raise_limit() -> None:
    """Raise the soft limit of descriptors to the hard one. Called once, by `dyknow serve`."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        try:
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
        except (ValueError, OSError):
            # Some systems refuse a limit that they report as unlimited.
            return


def places(wanted: int, reserved: int = RESERVED) -> int:
    """The number of clients, at most ``wanted`` and at least one, for which descriptors are left
    when ``reserved`` are kept for other uses."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY:
        return wanted
    return max(1, min(wanted, soft - reserved))
