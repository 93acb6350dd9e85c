"""What a commit is to survive."""

from __future__ import annotations

from enum import StrEnum


class Durability(StrEnum):
    """When a commit returns."""

    FSYNC = "fsync"
    """The disk has it: it survives a loss of power."""
    WRITE = "write"
    """The operating system has it: it survives the end of the process."""
