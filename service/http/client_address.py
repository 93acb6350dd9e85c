"""What counts as one client where nothing tells clients apart but where they come from."""

from __future__ import annotations

import ipaddress

from starlette.requests import Request


def address_of(request: Request) -> str:
    """Who is counted together where nothing tells clients apart but where they come from."""
    return network_of(request.client.host) if request.client else ""


def network_of(host: str) -> str:
    """An address of IPv4; of IPv6 the network of 64 bits that one is given. What is no address
    (the name of a test's client) is itself."""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return host
    if isinstance(address, ipaddress.IPv6Address):
        if address.ipv4_mapped is None:
            return str(ipaddress.IPv6Network((address, 64), strict=False))
        address = address.ipv4_mapped
    return str(address)
