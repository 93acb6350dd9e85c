"""Which host a request may name, and which pages may send one: what a browser of somebody who
visits a hostile page must not be used for (docs/reference/access.md, "Browsers").

A page whose name is made to point at this machine (DNS rebinding) sends its own name as Host; a
page elsewhere sends its Origin, or the browser says ``Sec-Fetch-Site``. Programs send neither.
"""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Iterable
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
"""What ``Sec-Fetch-Site`` says of pages of another origin: another port is the same site."""
LISTED = 1000
"""So many spellings of a Host header are remembered."""


@dataclass(frozen=True, slots=True)
class Place:
    """A host, in one spelling (no dot at its end, addresses without brackets), and a port."""

    host: str
    port: int | None

    @classmethod
    def of(cls, text: str) -> Place | None:
        """``host``, ``host:port``, ``[::1]:port``; None for what is none."""
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
    """The names of this service: those of the loopback, the address it listens at, and those that
    the settings list. Where it listens at all addresses every address is one, too: a hostile page
    has a name, never the address itself."""

    def __init__(self, settings: Settings) -> None:
        listed = {name.lower() for name in _names(settings.trusted_hosts)}
        self._all = "*" in listed
        self._below = tuple(name[1:] for name in listed if name.startswith("*."))
        places = (Place.of(name) for name in (*listed, _bracketed(settings.host)))
        self._names = {place.host for place in places if place is not None}
        self._addresses = settings.host in _WILDCARDS
        self._known: dict[bytes, Place] = {}

    def check(self, values: list[bytes], reached: str) -> Place:
        """The place that a request is for, by the values of its Host headers. ``reached`` is the
        address of ours that it came to.

        Raises a `Problem`: 400 for none (also in HTTP/1.0), several, or what is no host, 421 for
        another one.
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
                400, "bad Host header", "it is no host, or host and port", hint=_HOST_HINT
            )
        if not (self._is_ours(place.host) or place.host == reached):
            raise Problem(
                421,
                "wrong host",
                f"this service is not called {place.host}",
                hint=f"if it is: DYKNOW_TRUSTED_HOSTS={place.host} (docs/reference/access.md)",
            )
        if len(self._known) < LISTED:
            self._known[value] = place
        return place

    def _is_ours(self, host: str) -> bool:
        if self._all or host in self._names or is_loopback(host):
            return True
        return host.endswith(self._below) or (self._addresses and _is_address(host))


class Origins:
    """Which pages may send requests: those of this service, and those that the settings list."""

    def __init__(self, settings: Settings) -> None:
        self._trusted = {origin.lower().rstrip("/") for origin in _names(settings.trusted_origins)}

    @property
    def any_trusted(self) -> bool:
        """Whether answers differ by Origin."""
        return bool(self._trusted)

    def is_trusted(self, origin: bytes) -> bool:
        """Whether the settings list ``origin``: its pages may read answers (CORS)."""
        return origin.decode("latin-1").lower() in self._trusted

    def check(
        self,
        origins: list[bytes],
        scheme: str,
        place: Place,
        fetch: FetchMetadata,
        method: str,
    ) -> None:
        """Raises a 403 `Problem` for a request that a page elsewhere has sent."""
        if origins:
            if len(origins) > 1 or not (
                self.is_trusted(origins[0]) or is_same(origins[0], scheme, place)
            ):
                raise _foreign(origins[0].decode("latin-1")[:200])
        elif fetch.is_foreign and not (fetch.opens_a_page and method in ("GET", "HEAD")):
            raise _foreign("another page")


@dataclass(slots=True)
class FetchMetadata:
    """What a browser says of who asks, and for what (``Sec-Fetch-Site``, ``-Mode``, ``-Dest``)."""

    site: bytes = b""
    mode: bytes = b""
    destination: bytes = b""

    @property
    def is_foreign(self) -> bool:
        """A page of another origin asks."""
        return self.site in _FOREIGN

    @property
    def is_own(self) -> bool:
        """A page of this service asks, or the person in front of the browser."""
        return self.site in (b"same-origin", b"none")

    @property
    def opens_a_page(self) -> bool:
        """Somebody has followed a link: the answer is shown in a window, and not to the page."""
        return self.mode == b"navigate" and self.destination in (b"", b"document")


def is_same(origin: bytes, scheme: str, place: Place) -> bool:
    """Whether ``origin`` is that of this service itself: scheme, host and port."""
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
