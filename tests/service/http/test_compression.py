"""Compressed answers: the same bytes, in fewer, where the client accepts gzip."""

from __future__ import annotations

import gzip
import zlib

import httpx
import pytest

from dyknow.service.client.client import Client
from dyknow.service.http.compression import MINIMUM
from dyknow.service.http.response_limit import PIECE_BYTES

TEMPLATE = """PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
REGISTER TEMPLATE dyknow:Fast (?o, ?limit) AS
# {}
SELECT ?o ?spd WHERE {{ ?o dyknow:speed ?spd . FILTER (?spd > ?limit) }}
WINDOW [RANGE 5s STEP 1s]"""


def sent(
    http: httpx.Client, path: str, accepts: str, **headers: str
) -> tuple[bytes, httpx.Headers]:
    """The bytes of an answer as they come, and its headers."""
    headers = {"Accept-Encoding": accepts, **headers}
    with http.stream("GET", path, headers=headers) as answer:
        return b"".join(answer.iter_raw()), answer.headers


@pytest.mark.parametrize("count", [20, 2_000, 30_000], ids=["whole", "long", "pieces"])
@pytest.mark.parametrize("kind", ["application/json", "text/csv"])
def test_an_answer_of_any_length(http: httpx.Client, client: Client, count: int, kind: str) -> None:
    client.put_stream("s", {"o": "string", "x": "float"})
    rows = [{"valid": i, "o": f"o{i % 7}", "x": i / 8} for i in range(count)]
    for begin in range(0, count, 10_000):
        client.publish("s", rows[begin : begin + 10_000])
    path = f"/streams/s/samples?limit={count}"
    plain, headers = sent(http, path, "identity", Accept=kind)
    assert "content-encoding" not in headers
    assert headers["vary"] == "Accept-Encoding"
    packed, headers = sent(http, path, "gzip", Accept=kind)
    assert (headers["content-encoding"], headers["vary"]) == ("gzip", "Accept-Encoding")
    assert headers["content-type"].startswith(kind)
    assert gzip.decompress(packed) == plain
    assert len(packed) < len(plain) / 2
    assert ("content-length" in headers) == (len(plain) <= PIECE_BYTES)


@pytest.mark.parametrize("accepts", ["", "br", "gzip;q=0", "gzip; q=0.0, br", "x-gzip"])
def test_a_client_that_does_not_accept_gzip_gets_plain_bytes(
    http: httpx.Client, accepts: str
) -> None:
    body, headers = sent(http, "/vocabulary", accepts)
    assert body.startswith(b"{")
    assert "content-encoding" not in headers


@pytest.mark.parametrize("accepts", ["gzip", "br, gzip;q=0.5", "gzip;q=1.0"])
def test_a_client_that_accepts_gzip_gets_it(http: httpx.Client, accepts: str) -> None:
    body, headers = sent(http, "/vocabulary", accepts)
    assert headers["content-encoding"] == "gzip"
    assert zlib.decompress(body, 31).startswith(b"{")


def test_a_short_answer_stays_as_it_is(http: httpx.Client) -> None:
    body, headers = sent(http, "/healthz", "gzip")
    assert len(body) < MINIMUM
    assert "content-encoding" not in headers


def test_event_streams_are_never_compressed(http: httpx.Client, client: Client) -> None:
    client.put_stream("s", {"o": "string"})
    client.publish("s", [{"valid": 1, "o": "long " * MINIMUM}])
    headers = {"Accept-Encoding": "gzip"}
    with http.stream("GET", "/streams/s/events?since=start", headers=headers) as answer:
        assert "content-encoding" not in answer.headers
        lines = answer.iter_lines()
        assert any("long long" in line for line in lines)


def test_an_error_is_compressed_like_other_answers(http: httpx.Client) -> None:
    answer = http.get(f"/streams/{'s' * 2 * MINIMUM}")
    assert answer.status_code == 404
    assert answer.headers["content-encoding"] == "gzip"
    assert answer.json()["title"] == "unknown stream"


def test_a_compressed_answer_has_a_weak_etag(http: httpx.Client, client: Client) -> None:
    client.register_template(TEMPLATE.format("long " * MINIMUM))
    _, plain = sent(http, "/templates/Fast", "identity")
    _, packed = sent(http, "/templates/Fast", "gzip")
    assert packed["etag"] == f"W/{plain['etag']}"
    for etag in (plain["etag"], packed["etag"]):
        assert http.get("/templates/Fast", headers={"If-None-Match": etag}).status_code == 304
    assert http.delete("/templates/Fast", headers={"If-Match": packed["etag"]}).status_code == 204


def test_head_has_the_headers_of_get(http: httpx.Client) -> None:
    answer = http.head("/vocabulary", headers={"Accept-Encoding": "gzip"})
    assert answer.headers["content-encoding"] == "gzip"
    assert answer.content == b""
