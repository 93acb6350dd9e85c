"""What counts as one client, of connections and of event streams."""

from starlette.requests import Request

from dyknow.service.http.client_address import address_of, network_of


def test_of_ipv4_an_address_is_one_client() -> None:
    assert network_of("192.0.2.1") == network_of("::ffff:192.0.2.1") == "192.0.2.1"


def test_of_ipv6_a_network_of_64_bits_is_one_client() -> None:
    assert network_of("2001:db8::1") == network_of("2001:db8::2") != network_of("2001:db8:0:1::1")
    assert network_of("fe80::1%eth0") == "fe80::/64"


def test_what_is_no_address_is_itself() -> None:
    assert network_of("") == ""
    assert network_of("testclient") == "testclient"


def test_event_streams_count_clients_as_connections_do() -> None:
    """Else who has a network has as many event streams as it has addresses."""
    one, two = (
        address_of(Request({"type": "http", "client": (f"2001:db8::{i}", 1)})) for i in (1, 2)
    )
    assert one == two == "2001:db8::/64"
