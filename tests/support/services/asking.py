"""A client of a service on this machine."""

from __future__ import annotations

import ssl

import httpx
from waiting import PATIENCE

NO_CERTIFICATES = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
"""Plain HTTP needs none, and to read them takes as long as a short test."""


def asking(url: httpx.URL | str) -> httpx.Client:
    """Plain HTTP, as a client written from the documentation would speak it."""
    return httpx.Client(base_url=url, trust_env=False, timeout=PATIENCE, verify=NO_CERTIFICATES)
