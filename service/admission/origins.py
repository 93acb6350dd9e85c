"""Checks of the Host and Origin headers, against hostile pages in a browser
(docs/reference/access.md, "Browsers").

With DNS rebinding a page makes its name resolve to this machine; its requests have that name as
Host. A page of another origin sends Origin, or its browser sends ``Sec-Fetch-Site``; programs send
neither. Starlette's middlewares do not replace these checks
(docs/explanation/design/0009-access.md).
"""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from ..config.settings import Settings
from ..http.problems import Problem
from .tokens import is_loopback

_HOST = re.compile(r"(\[[0-9a-f:.]+\]|[a-z0-9._-]+)(?::([0-9]{1,5}))?")
_ORIGIN = re.compile(r"([a-z][a-z0-9+.-]*)://(.+)")
_HOST_HINT = "send one header Host with the name or address of the service: Host: 127.0.0.1:8000"
_PORTS = {"http": 80, "https": 443}
_WILDCARDS = ("", "0.0.0.0", "::")
_FOREIGN = (b"cross-site", b"same-site")
"""``Sec-Fetch-Site`` of pages of another origin: another port is the same site."""
Headers = Mapping[bytes, list[bytes]]
"""The values of each header of a request."""
LISTED = 1000
"""Values of Host headers that are cached, at most."""


@dataclass(frozen=True, slots=True)
class Place:
    """A host in its normal form (no dot at its end, addresses without brackets), and a port."""

    host: str
    port: int | None

    @classmethod
    def of(cls, text: str) -> Place | None:
        """Parse ``host``, ``host:port`` or ``[::1]:port``; None for another text."""
        match = _HOST.fullmatch(text.lower())
        if match is None:
            return None
        name, port = match.groups()
        number = None if port is None else int(port)
        if number is not None and number > 65535:
            return None
        if not name.startswith("["):
            name = name.removesuffix(".")
            return cls(name, number) if name else None
        try:
            return cls(str(ipaddress.IPv6Address(name[1:-1])), number)
        except ValueError:
            return None


class Hosts:
    """The hosts of this service: loopback, the address it listens at, and those of the settings. If
    it listens at all addresses, every address is one: DNS rebinding needs a name."""

    def __init__(self, settings: Settings) -> None:
        listed = {name.lower() for name in _names(settings.trusted_hosts)}
        self._all = "*" in listed
        self._below = tuple(name[1:] for name in listed if name.startswith("*."))
        places = (Place.of(name) for name in (*listed, _bracketed(settings.host)))
        self._names = {place.host for place in places if place is not None}
        self._addresses = settings.host in _WILDCARDS
        self._known: dict[bytes, Place] = {}

    def check(self, values: list[bytes], reached: str) -> Place:
        """Check the values of a request's Host headers. ``reached`` is the local address of its
        connection.

        Raises a `Problem`: 400 for no header (also in HTTP/1.0), several, or a malformed one, 421
        for another host.
        """
        if len(values) == 1:
            known = self._known.get(values[0])
            return self._read(values[0], reached) if known is None else known
        raise Problem(
            400,
            "bad Host header",
            f"a request has one Host header, not {len(values)}",
            hint=_HOST_HINT,
        )

    def _read(self, value: bytes, reached: str) -> Place:
        place = Place.of(value.decode("latin-1"))
        if place is None:
            raise Problem(
                400,
                "bad Host header",
                "its value is neither a host nor a host and port",
                hint=_HOST_HINT,
            )
        if not (self._is_ours(place.host) or place.host == reached):
            raise Problem(
                421,
                "wrong host",
                f"this service has no host {place.host}",
                hint=f"if it should: DYKNOW_TRUSTED_HOSTS={place.host} (docs/reference/access.md)",
            )
        if len(self._known) < LISTED:
            self._known[value] = place
        return place

    def _is_ours(self, host: str) -> bool:
        if self._all or host in self._names or is_loopback(host):
            return True
        return host.endswith(self._below) or (self._addresses and _is_address(host))


class Origins:
    """The origins of pages that may send requests: this service, and those of the settings."""

    def __init__(self, settings: Settings) -> None:
        self._trusted = {origin.lower().rstrip("/") for origin in _names(settings.trusted_origins)}

    @property
    def any_trusted(self) -> bool:
        """Whether the settings list an origin, so that answers depend on Origin."""
        return bool(self._trusted)

    def is_trusted(self, origin: bytes) -> bool:
        """Whether the settings list ``origin``: its pages may read answers (CORS)."""
        return origin.decode("latin-1").lower() in self._trusted

    def check(self, headers: Headers, scheme: str, place: Place, method: str) -> None:
        """Raises a 403 `Problem` for a request from a page of an origin that is not trusted."""
        origins = headers.get(b"origin")
        if origins:
            if len(origins) > 1 or not (
                self.is_trusted(origins[0]) or is_same(origins[0], scheme, place)
            ):
                raise _foreign(origins[0].decode("latin-1")[:200])
        elif _fetch(headers, b"site") in _FOREIGN and not (
            method in ("GET", "HEAD") and _follows_link(headers)
        ):
            raise _foreign("another page")


def is_own_page(headers: Headers, scheme: str, place: Place) -> bool:
    """Whether a browser confirms that a page of this service sends a request, or the user: then
    cookies count."""
    if origins := headers.get(b"origin"):
        return is_same(origins[0], scheme, place)
    return _fetch(headers, b"site") in (b"same-origin", b"none")


def _follows_link(headers: Headers) -> bool:
    """Whether the user follows a link: the page with the link cannot read the answer."""
    destination = _fetch(headers, b"dest")
    return _fetch(headers, b"mode") == b"navigate" and destination in (b"", b"document")


def _fetch(headers: Headers, name: bytes) -> bytes:
    return headers.get(b"sec-fetch-" + name, [b""])[0].lower()


def is_same(origin: bytes, scheme: str, place: Place) -> bool:
    """Whether ``origin`` is this service: scheme, host and port."""
    match = _ORIGIN.fullmatch(origin.decode("latin-1").lower())
    if match is None or match[1] != scheme:
        return False
    theirs = Place.of(match[2])
    if theirs is None or theirs.host != place.host:
        return False
    usual = _PORTS.get(scheme)
    return (theirs.port or usual) == (place.port or usual)


def _foreign(whose: str) -> Problem:
    return Problem(
        403,
        "foreign origin",
        f"{whose} may not use this service from a browser",
        hint="DYKNOW_TRUSTED_ORIGINS lists the pages that may (docs/reference/access.md)",
    )


def _names(text: str) -> Iterable[str]:
    return (name.strip() for name in text.split(",") if name.strip())


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True
