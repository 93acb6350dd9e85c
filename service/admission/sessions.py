"""Sessions of browsers: a cookie instead of a token, which a page's EventSource cannot send.

A cookie has a random value of its own; memory keeps its hash for half a day. The gate accepts it
only from pages of this service.
"""

from __future__ import annotations

import secrets
from collections import OrderedDict

from ...streams.time import HOUR, SECOND, Clock
from .tokens import Caller, digest_of

COOKIE = "dyknow_session"
LASTS = 12 * HOUR
"""The duration of a session (ns); then the user logs in again."""
MOST = 1_000
"""Sessions at most; a further one ends the oldest."""
MOST_OF_ONE = 100
"""Sessions of one caller; a further one ends its own oldest, so no caller logs others out."""


class Sessions:
    """The sessions that have begun. ``clock`` returns the time in ns."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._sessions: OrderedDict[bytes, tuple[Caller, int]] = OrderedDict()

    def begin(self, caller: Caller) -> str:
        """Begin a session, and return the value of its cookie."""
        own = [each for each, (whose, _) in self._sessions.items() if whose.name == caller.name]
        if len(own) >= MOST_OF_ONE:
            del self._sessions[own[0]]
        value = secrets.token_urlsafe(32)
        self._sessions[digest_of(value.encode())] = (caller, self._clock() + LASTS)
        while len(self._sessions) > MOST:
            self._sessions.popitem(last=False)
        return value

    def caller(self, cookies: bytes) -> Caller | None:
        """The caller of the session in a Cookie header; None without one, or after its end."""
        for value in _values(cookies):
            digest = digest_of(value)
            found = self._sessions.get(digest)
            if found is not None:
                caller, ends = found
                if self._clock() < ends:
                    return caller
                del self._sessions[digest]
        return None

    def end(self, cookies: bytes) -> None:
        """End the session in a Cookie header."""
        for value in _values(cookies):
            self._sessions.pop(digest_of(value), None)


def set_cookie(value: str, *, secure: bool) -> str:
    """The Set-Cookie header that begins a session, or ends it with an empty ``value``.

    Scripts cannot read the cookie, and browsers do not send it with requests from another site.
    """
    lasts = LASTS // SECOND if value else 0
    header = f"{COOKIE}={value}; Path=/; Max-Age={lasts}; HttpOnly; SameSite=Strict"
    return f"{header}; Secure" if secure else header


def _values(cookies: bytes) -> list[bytes]:
    """The values of the session cookie; services on other ports of this host may have set some."""
    pairs = (cookie.strip().partition(b"=") for cookie in cookies.split(b";"))
    return [value for name, _, value in pairs if name == COOKIE.encode()]
