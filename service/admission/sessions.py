"""Sessions of browsers: a cookie in place of a token, which a page's EventSource cannot send.

The cookie is no token: a number of its own, kept as a hash, in memory, for half a day. What it is
worth is decided in service/admission/gate: it counts only from pages of this service.
"""

from __future__ import annotations

import secrets
from collections import OrderedDict

from ...streams.time import HOUR, SECOND, Clock
from .tokens import Caller, digest_of

COOKIE = "dyknow_session"
LASTS = 12 * HOUR
"""After this time (ns) people log in again."""
MOST = 1_000
"""The oldest session ends when there would be more."""
MOST_OF_ONE = 100
"""Of one caller its own oldest one does: nobody logs others out."""


class Sessions:
    """Who has logged in. ``clock`` tells the time in ns."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._sessions: OrderedDict[bytes, tuple[Caller, int]] = OrderedDict()

    def begin(self, caller: Caller) -> str:
        """A new session; gives the value of its cookie."""
        own = [each for each, (whose, _) in self._sessions.items() if whose.name == caller.name]
        if len(own) >= MOST_OF_ONE:
            del self._sessions[own[0]]
        value = secrets.token_urlsafe(32)
        self._sessions[digest_of(value.encode())] = (caller, self._clock() + LASTS)
        while len(self._sessions) > MOST:
            self._sessions.popitem(last=False)
        return value

    def caller(self, cookies: bytes) -> Caller | None:
        """Whose session a Cookie header names; None if nobody's, or it has ended."""
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
        """Forget the session that a Cookie header names."""
        for value in _values(cookies):
            self._sessions.pop(digest_of(value), None)


def set_cookie(value: str, *, secure: bool) -> str:
    """The Set-Cookie header of a session that begins; of one that ends for an empty value.

    Scripts do not see it, and requests that begin on another site do not carry it.
    """
    lasts = LASTS // SECOND if value else 0
    header = f"{COOKIE}={value}; Path=/; Max-Age={lasts}; HttpOnly; SameSite=Strict"
    return f"{header}; Secure" if secure else header


def _values(cookies: bytes) -> list[bytes]:
    """The values of our cookie; there may be several, of services on other ports of this host."""
    pairs = (cookie.strip().partition(b"=") for cookie in cookies.split(b";"))
    return [value for name, _, value in pairs if name == COOKIE.encode()]
