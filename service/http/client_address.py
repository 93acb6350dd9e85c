"""The address that identifies a client without a token."""

from __future__ import annotations

import ipaddress

from starlette.requests import Request


def address_of(request: Request) -> str:
    """The key under which the requests of a client without a token are counted."""
    return network_of(request.client.host) if request.client else ""


def network_of(host: str) -> str:
    """An IPv4 address, or the /64 network of an IPv6 address, which is the usual allocation of one
    client. A text that is no address (the name of a test's client) stays as it is."""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return host
    if isinstance(address, ipaddress.IPv6Address):
        if address.ipv4_mapped is None:
            return str(ipaddress.IPv6Network((address, 64), strict=False))
        address = address.ipv4_mapped
    return str(address)
