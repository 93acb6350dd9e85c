"""The file of tokens, read again when it changes and on SIGHUP, while the service runs.

Event streams and live bodies of removed tokens end. A file with an error changes nothing: the old
tokens stay valid, and the log has the reason.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

import anyio
import anyio.to_thread

from ..config.logs import log
from ..config.settings import Settings
from .tokens import Stamp, Tokens, TokensError

EVERY = 1.0
"""Seconds between two checks of the file. The service reads it when two checks agree: an editor may
be writing it."""


class TokenFile:
    """Keeps ``tokens`` equal to the settings' file. ``told`` gets the outcome of each reading,
    "taken" or "refused"; ``revoke`` ends the requests of removed tokens, and returns their
    number."""

    def __init__(
        self,
        settings: Settings,
        tokens: Tokens,
        told: Callable[[str], None],
        revoke: Callable[[], int],
    ) -> None:
        self._settings = settings
        self._tokens = tokens
        self._told = told
        self._revoke = revoke
        self._known = tokens.stamp
        """The stamp of the file that was read last, valid or not."""
        self._asked: asyncio.Event | None = None
        self._loop: asyncio.AbstractEventLoop | None = None

    def ask(self) -> None:
        """Read the file now, if the service runs. May be called by any thread, and by a signal."""
        if self._loop is not None and self._asked is not None:
            self._loop.call_soon_threadsafe(self._asked.set)

    async def watch(self) -> None:
        """Check the file until cancelled, at once after `ask`. Return if there is no file that
        could change."""
        path = self._settings.tokens_file
        if path is None or self._known is None:
            return
        self._loop = asyncio.get_running_loop()
        asked = self._asked = asyncio.Event()
        before: Stamp | None = self._known
        while True:
            with anyio.move_on_after(EVERY):
                await asked.wait()
            # In a thread: the file may be on a slow disk.
            stamp = await anyio.to_thread.run_sync(_stamp_of, path, abandon_on_cancel=True)
            if asked.is_set() or (stamp == before and stamp != self._known):
                asked.clear()
                self._known = await self._read() or stamp
            before = stamp

    async def _read(self) -> Stamp | None:
        """Read the file and return its stamp; None if it has an error."""
        try:
            fresh = await anyio.to_thread.run_sync(Tokens.of, self._settings)
        except TokensError as error:
            self._told("refused")
            log().error(
                "tokens not taken, the old ones hold", reason=error.message, hint=error.hint
            )
            return None
        self._tokens.replace(fresh)
        self._told("taken")
        log().info("tokens taken", tokens=len(self._tokens), ended=self._revoke())
        return fresh.stamp


def _stamp_of(path: Path) -> Stamp | None:
    try:
        return Stamp.of(path.stat())
    except OSError:
        return None
