"""What can be wrong with a data directory. Each error says what to do next."""

from __future__ import annotations

import errno
from typing import Final

_FULL: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class JournalError(Exception):
    """``hint`` says what to do next."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint

    def __str__(self) -> str:
        return f"{self.message} ({self.hint})" if self.hint else self.message


class JournalFull(JournalError):
    """There is no room on the disk. Nothing was taken; it may work later."""


class JournalBroken(JournalError):
    """The disk has failed to keep what it was given: nothing more is taken by this process."""


class JournalDamaged(JournalError):
    """What was kept is not as it was written."""


class DirectoryInUse(JournalError):
    """Another process has the directory open."""


class UnknownFormat(JournalError):
    """The directory was written by a later version, or is none of ours."""


def is_full(error: OSError) -> bool:
    """Whether there is no room: on the disk, for this user, or in a file."""
    return error.errno in _FULL
