"""RDF in by the Python client."""

from __future__ import annotations

import pytest

from dyknow.service.client.client import Client, ServiceError

TRIG = "application/trig"


def test_rdf_is_published_and_makes_its_stream(client: Client) -> None:
    with pytest.raises(ServiceError, match="no stream called"):
        client.publish_rdf("facts", "<urn:a> <urn:p> 1 .")
    assert client.publish_rdf("facts", "<urn:a> <urn:p> 1, 2 .", create=True) == 2
    assert client.publish_rdf("facts", b"<urn:g> { <urn:a> <urn:p> 3 }", TRIG) == 1
    found = client.history("facts")
    assert [each["number"] for each in found] == [1, 2, 3]
    assert [each["graph"] for each in found] == [None, None, "<urn:g>"]


def test_a_repeated_key_has_no_second_effect(client: Client) -> None:
    client.put_rdf_stream("facts", time="urn:t", retention={"samples": 10})
    assert client.stream("facts")["time"] == "urn:t"
    text = '<urn:a> <urn:t> "2021-05-01T12:00:00Z"^^<http://www.w3.org/2001/XMLSchema#dateTime> .'
    for _ in range(2):
        assert client.publish_rdf("facts", text, idempotency_key="k") == 1
    assert len(client.history("facts")) == 1
