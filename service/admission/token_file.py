"""Tokens that change while the service runs: their file is read again when it is another, or when
somebody asks (SIGHUP); who came with a token that is not accepted any more goes.

A file that cannot be used changes nothing: the old tokens hold, and the log says why.
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
"""Seconds between two looks at the file. It is read when two in a row have found the same: an
editor may be writing it."""


class TokenFile:
    """Keeps ``tokens`` as the settings' file has them. ``told`` hears what became of it, "taken" or
    "refused"; ``revoke`` lets those go whose token is not accepted any more."""

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
        """Of the file that was read last, whether it could be used or not."""
        self._asked: asyncio.Event | None = None
        self._loop: asyncio.AbstractEventLoop | None = None

    def ask(self) -> None:
        """Read it now. May be called in any thread, and by a signal; nothing happens before the
        service runs."""
        if self._loop is not None and self._asked is not None:
            self._loop.call_soon_threadsafe(self._asked.set)

    async def watch(self) -> None:
        """For as long as the service runs: look at the file; at once for who asks. Returns where
        there is none that could change."""
        path = self._settings.tokens_file
        if path is None or self._known is None:
            return
        self._loop = asyncio.get_running_loop()
        asked = self._asked = asyncio.Event()
        before: Stamp | None = self._known
        while True:
            with anyio.move_on_after(EVERY):
                await asked.wait()
            # Beside the loop: the file may be on a disk that takes its time.
            stamp = await anyio.to_thread.run_sync(_stamp_of, path, abandon_on_cancel=True)
            if asked.is_set() or (stamp == before and stamp != self._known):
                asked.clear()
                self._known = await self._read() or stamp
            before = stamp

    async def _read(self) -> Stamp | None:
        """The stamp of what was taken; None where it cannot be used."""
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
