"""A history answer comes in pieces, each encoded when the one before it is taken."""

from __future__ import annotations

import asyncio
import io
import json
from collections.abc import Iterator
from typing import Any

import httpx
import pyarrow as pa
import pytest
from fastapi import Response
from fastapi.responses import StreamingResponse
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from pyoxigraph import RdfFormat, parse

from dyknow.converters.arrow.stream import decode_arrow
from dyknow.service.client.client import Client
from dyknow.service.client.connection import ServiceError
from dyknow.service.config.media_types import (
    ARROW,
    CSV,
    JSON,
    JSON_LD,
    NDJSON,
    NQUADS,
    NTRIPLES,
    TRIG,
)
from dyknow.service.config.settings import Settings
from dyknow.service.http.encodings import history_encoding
from dyknow.service.http.encodings.history_encoding import (
    PIECE_BYTES,
    PIECE_SAMPLES,
    RDF_KINDS,
    RDF_SAMPLES,
    RdfWriter,
    history_answer,
    pieces,
)
from dyknow.service.routes import samples
from dyknow.streams.instants import PlacesOf
from dyknow.streams.sample import (
    Field,
    FieldType,
    SampleBatch,
    Schema,
    batch_from_rows,
)

KINDS = (NDJSON, JSON, CSV, ARROW, NTRIPLES, NQUADS, TRIG, JSON_LD)
FIELDS = Schema((Field("t", FieldType.STRING), Field("v", FieldType.FLOAT)))
LINES = {"Content-Type": NDJSON}
SECOND = 1_000_000_000


@pytest.fixture
def settings(settings: Settings) -> Settings:
    return settings.model_copy(update={"batch_samples": 1_500})


def test_questions_about_the_past(http: httpx.Client, client: Client) -> None:
    """[DyKnow10 Def. 5.5-5.7], and 410 where the stream has forgotten what the answer needs."""
    retention = {"samples": 3}
    client.put_stream("s", {"v": "integer"}, retention=retention)
    rows = [(10, 5), (11, 3), (12, 6), (13, 6)]
    lines = [{"available": a, "valid": v, "v": i} for i, (a, v) in enumerate(rows)]
    client.publish("s", lines[:3])
    asked = {"at": 5, "before": 5, "prev": 12, "last_avail": 11, "valid_from": 4, "start": 10}
    found = {key: [s["v"] for s in client.history("s", **{key: t})] for key, t in asked.items()}
    assert found == {
        "at": [0],
        "before": [0, 1],
        "prev": [1],
        "last_avail": [1],
        "valid_from": [0, 2],
        "start": [0, 1, 2],
    }
    assert [s["v"] for s in client.history("s", at=5, known=9)] == []
    client.publish("s", lines[3:])
    for question in ({"at": 5}, {"before": 5}, {"prev": 11}, {"last_avail": 10}, {"valid_to": 5}):
        with pytest.raises(ServiceError) as refused:
            client.history("s", **question)
        assert refused.value.status == 410
        assert refused.value.problem["oldest"] == "1970-01-01T00:00:00.000000011Z"
    with pytest.raises(ServiceError, match="forgotten"):
        client.history("s", start=10)
    assert [s["v"] for s in client.history("s", at=6)] == [3]
    assert [s["v"] for s in client.history("s", start=11)] == [1, 2, 3]
    assert [s["v"] for s in client.history("s")] == [1, 2, 3]
    assert [s["v"] for s in client.history("s", before=6, limit=2)] == [2, 3]


def test_an_instant_that_retention_has_cut(http: httpx.Client, client: Client) -> None:
    fields = {"v": "integer"}
    client.put_stream("s", fields)
    for time in (10, 11, 12):
        client.publish("s", [{"available": time, "valid": time, "v": row} for row in range(3)])
    client.put_stream("s", fields, retention={"samples": 4})
    for url in ("/streams/s/samples?from=11", "/streams/s/events?since=11"):
        refused = http.get(url)
        assert refused.status_code == 410, url
        assert refused.json()["oldest"] == "1970-01-01T00:00:00.000000012Z"
    assert len(client.history("s", start=12)) == 3
    for wrong in ("at=1&prev=2", "at=1&valid_from=2", "known=3", "prev=1&known=2", "before=soon"):
        assert http.get(f"/streams/s/samples?{wrong}").status_code == 400
    with pytest.raises(TypeError, match="later"):
        client.history("s", later=1)


@pytest.fixture
def plotted(client: Client) -> Client:
    """Two objects, a sample a second of each, of which one comes late in valid time."""
    client.put_stream("s", {"id": "string", "spd": "float", "mode": "string"})
    client.annotate("stream s contains speed(UAV) = spd for every UAV = id")
    seconds = [0, 1, 2, 3, 14, 12, 13]
    rows = [
        {"available": i, "valid": second * SECOND, "id": name, "spd": sign * second, "mode": "m"}
        for i, second in enumerate(seconds)
        for name, sign in (("a", 1.0), ("b", -1.0))
    ]
    client.publish("s", rows)
    return client


def test_intervals_have_minimum_maximum_and_last(plotted: Client) -> None:
    rows = plotted.history("s", every="10s")
    assert [(row["valid"][17:], row["id"]) for row in rows] == [
        ("03Z", "a"),
        ("03Z", "b"),
        ("14Z", "a"),
        ("14Z", "b"),
    ]
    assert rows[3] == {
        "available": "1970-01-01T00:00:00.000000004Z",
        "valid": "1970-01-01T00:00:14Z",
        "id": "b",
        "spd": -14.0,
        "spd_min": -14.0,
        "spd_max": -12.0,
        "mode": "m",
    }
    chosen = plotted.history("s", every="10s", fields=["mode"])
    assert chosen[0].keys() == {"available", "valid", "id", "mode"}
    bounded = plotted.history("s", every="10s", valid_from=2 * SECOND, valid_to=12 * SECOND)
    assert [(row["spd_min"], row["spd"]) for row in bounded if row["id"] == "a"] == [
        (2.0, 3.0),
        (12.0, 12.0),
    ]


def test_intervals_come_in_all_tables_and_in_pieces(http: httpx.Client, plotted: Client) -> None:
    path, columns = "/streams/s/samples?every=10s", "available,valid,id,spd,spd_min,spd_max,mode"
    answers = {kind: http.get(path, headers={"Accept": kind}) for kind in KINDS}
    assert answers[CSV].text.splitlines()[0] == columns
    assert pa.ipc.open_stream(answers[ARROW].content).read_all().num_rows == 4
    assert len(answers[NDJSON].text.splitlines()) == len(answers[JSON].json()) == 4
    assert {answers[kind].status_code for kind in RDF_KINDS} == {406}
    assert [row["spd"] for row in plotted.history("s", every="1s", limit=2)] == [14.0, -14.0]
    # A piece ends with its interval, so that the next one begins after it.
    first = plotted.history("s", every="1s", limit=1, valid_from=0)
    assert [row["id"] for row in first] == ["a", "b"]
    rest = plotted.history("s", every="1s", limit=100, valid_from=SECOND)
    assert first + rest == plotted.history("s", every="1s")


def test_what_has_no_intervals_is_refused(
    http: httpx.Client, plotted: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    plotted.put_stream("t", {"v": "float", "v_max": "float"})
    for stream, query, status, told in (
        ("s", "every=0s", 400, "too short"),
        ("s", "every=1000d", 400, "too long"),
        ("s", "every=1s&at=5", 400, "excludes"),
        ("s", "every=1s&fields=sped", 400, "no field 'sped'"),
        ("s", "fields=", 400, "no field ''"),
        ("t", "every=1s", 400, "'v_max'"),
        ("t", "every=1s&fields=v", 200, ""),
        ("nothing", "every=1s", 404, "nothing"),
    ):
        answer = http.get(f"/streams/{stream}/samples?{query}")
        assert (answer.status_code, told in answer.text) == (status, True), query
    monkeypatch.setattr(samples, "MOST_DOWNSAMPLED", 13)
    answer = http.get("/streams/s/samples?every=1s")
    assert (answer.status_code, answer.json()["title"]) == (422, "range too long")
    assert http.get(f"/streams/s/samples?every=1s&valid_to={13 * SECOND}").status_code == 200


def test_a_range_may_be_of_one_object(http: httpx.Client, plotted: Client) -> None:
    whole = plotted.history("s")
    mine = [row for row in whole if row["id"] == "a"]
    assert 1 < len(mine) < len(whole)
    for name in ("a", "dyknow:a", "<http://www.ida.liu.se/dyknow/a>"):
        assert plotted.history("s", object=name) == mine
    # The limit counts what is left: the newest ones, or the oldest from a time on.
    assert plotted.history("s", object="a", limit=2) == mine[-2:]
    assert plotted.history("s", object="a", limit=2, start=0) == mine[:2]
    assert plotted.history("s", object="a", limit=2, valid_from=2 * SECOND) == mine[2:4]
    in_intervals = plotted.history("s", every="10s")
    assert plotted.history("s", object="a", every="10s") == [
        row for row in in_intervals if row["id"] == "a"
    ]
    assert plotted.history("s", object="nobody") == []
    refused = http.get("/streams/s/samples?object=a&at=5")
    assert (refused.status_code, refused.json()["hint"][:12]) == (400, "send a range")
    plotted.put_stream("t", {"v": "float"})
    assert http.get("/streams/t/samples?object=a").status_code == 409
    # A stream without samples yet.
    plotted.annotate("stream later contains speed(UAV) = spd for every UAV = id")
    assert plotted.history("later", object="a") == []


def test_a_range_of_answers_and_of_rdf_may_be_of_one_object(
    http: httpx.Client, plotted: Client
) -> None:
    request = plotted.subscribe_to("dyknow:speed", sort="dyknow:UAV", since="start")
    rows = plotted.history(request["stream"], object="a")
    assert [row["object"] for row in rows] == ["a"] * 7
    http.put("/streams/facts", json={"kind": "rdf"}).raise_for_status()
    lines = "<x:a> <x:p> <x:b> .\n<x:b> <x:p> <x:a> .\n"
    headers = {"Content-Type": NTRIPLES}
    http.post("/streams/facts/samples", content=lines, headers=headers).raise_for_status()
    (row,) = plotted.history("facts", object="x:a")
    assert row["subject"] == "<x:a>"


def test_a_history_may_have_only_some_fields(http: httpx.Client, plotted: Client) -> None:
    rows = plotted.history("s", limit=2, fields="mode,id")
    assert [list(row) for row in rows] == [["available", "valid", "mode", "id"]] * 2
    refused = http.get("/streams/s/samples?fields=id", headers={"Accept": NTRIPLES})
    assert refused.status_code == 406


def batch(*sizes: int | None) -> SampleBatch:
    """A sample each, with a text so long."""
    texts = [None if size is None else "x" * size for size in sizes]
    return batch_from_rows(FIELDS, [(i, i, {"t": t, "v": 0.5}) for i, t in enumerate(texts)])


def told(part: SampleBatch, places: PlacesOf) -> list[str]:
    return [f"<urn:{time}> <urn:p> <urn:o> ." for time in part.available.tolist()]


@hypothesis_settings(deadline=None)  # its texts take long to make on a busy machine
@given(st.lists(st.sampled_from([None, 0, 1, PIECE_BYTES // 3, PIECE_BYTES, 2 * PIECE_BYTES])))
def test_pieces_are_the_batch_and_have_a_bound(sizes: list[int | None]) -> None:
    whole = batch(*sizes)
    parts = list(pieces(whole))
    assert [row for part in parts for row in part.rows()] == list(whole.rows())
    assert len(parts) == 1 or all(map(len, parts))
    for part, following in zip(parts, [*parts[1:], None], strict=True):
        texts = [len(str(values["t"] or "")) for _, _, values in part.rows()]
        assert len(part) <= 1 or sum(texts) <= PIECE_BYTES
        if following is not None:  # no piece is smaller than it must be
            first = next(iter(following.rows()))[2]["t"]
            assert sum(texts) + len(str(first or "")) + 112 * (len(part) + 1) > PIECE_BYTES


def test_pieces_have_so_many_samples() -> None:
    counts = [len(part) for part in pieces(batch(*[None] * (2 * PIECE_SAMPLES + 1)))]
    assert sum(counts) == 2 * PIECE_SAMPLES + 1
    assert max(counts) <= PIECE_SAMPLES


async def body_of(answer: Response) -> list[bytes]:
    if not isinstance(answer, StreamingResponse):
        return [bytes(answer.body)]
    return [bytes(piece) async for piece in answer.body_iterator]  # type: ignore[arg-type]


def count_of(table: bytes) -> int:
    return int(pa.ipc.open_stream(table).read_all().num_rows)


def rows_of(kind: str, body: bytes) -> list[Any]:
    if kind == ARROW:
        return list(decode_arrow(body, FIELDS, {}).batch.rows()) if count_of(body) else []
    return json.loads(body) if kind in (JSON, JSON_LD) else body.splitlines()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", [0, 1, 2, 3, 7])
def test_in_pieces_it_says_what_it_says_in_one(
    kind: str, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def both() -> tuple[list[bytes], list[bytes]]:
        given = batch(*[100] * count)
        whole = await body_of(await history_answer(kind, given, RdfWriter("urn:s", told)))
        monkeypatch.setattr(history_encoding, "PIECE_BYTES", 500)
        return whole, await body_of(await history_answer(kind, given, RdfWriter("urn:s", told)))

    whole, parts = asyncio.run(both())
    assert (len(whole), len(parts)) == (1, max(1, (count + 1) // 2))
    assert rows_of(kind, b"".join(parts)) == rows_of(kind, whole[0])
    if kind != ARROW:
        assert b"".join(parts) == whole[0]


def test_json_ld_is_what_nquads_are_and_pieces_may_cut_an_instant(
    http: httpx.Client, client: Client
) -> None:
    """Of samples whose triples have a node, named by the place in the instant; some have none."""
    client.put_stream("s", {"id": "string", "to": "string", "v": "float"})
    client.annotate("stream s contains xydist(UAV as a, UAV as b) = v for every a = id, b = to")
    count, instant = 2 * RDF_SAMPLES + 100, RDF_SAMPLES - 300
    rows = [
        {"available": i // instant, "valid": i, "id": "a", "to": "b", "v": i} for i in range(count)
    ]
    rows[-200:] = [{**row, "id": None} for row in rows[-200:]]
    for begin in range(0, count, RDF_SAMPLES):
        client.publish("s", rows[begin : begin + RDF_SAMPLES])
    texts = {
        kind: http.get(f"/streams/s/samples?limit={count}", headers={"Accept": kind}).content
        for kind in (NQUADS, JSON_LD, NTRIPLES)
    }
    quads = set(parse(texts[NQUADS], RdfFormat.N_QUADS))
    assert set(parse(texts[JSON_LD], RdfFormat.JSON_LD)) == quads
    nodes = {quad.object for quad in quads if str(quad.predicate).endswith("xydist>")}
    assert len(nodes) == count - 200
    triples = {quad.triple for quad in parse(texts[NTRIPLES], RdfFormat.N_TRIPLES)}
    assert triples < {quad.triple for quad in quads}
    assert {graph["@id"] for graph in json.loads(texts[JSON_LD])} == {
        str(quad.graph_name)[1:-1] for quad in quads if "/" in str(quad.graph_name)
    }


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_encoded_before_it_is_asked_for(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken = 0
    cut = pieces

    def counted(whole: SampleBatch, most: int) -> Iterator[SampleBatch]:
        nonlocal taken
        for part in cut(whole, most):
            taken += 1
            yield part

    async def some() -> list[int]:
        answer = await history_answer(kind, batch(*[PIECE_BYTES] * 10), RdfWriter("urn:s", told))
        assert isinstance(answer, StreamingResponse)
        before = taken
        return [before, *[taken async for _ in answer.body_iterator]]

    monkeypatch.setattr(history_encoding, "pieces", counted)
    # The one that is written, and the one that says whether it is the last.
    assert asyncio.run(some()) == [3, 3, 3, 4, 5, 6, 7, 8, 9, 10, 10]


def dictionary(count: int, text: str) -> bytes:
    sink = io.BytesIO()
    texts = pa.DictionaryArray.from_arrays(pa.array([0] * count, pa.int8()), pa.array([text]))
    table = pa.table({"valid": pa.array(range(count), pa.int64()), "t": texts})
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    return sink.getvalue()


def test_a_small_body_that_stands_for_much_is_answered_in_pieces(http: httpx.Client) -> None:
    http.put("/streams/texts", json={"fields": {"t": "string"}}).raise_for_status()
    body = dictionary(1_000, "x" * 60_000)
    assert len(body) < 100_000
    sent = http.post("/streams/texts/samples", content=body, headers={"Content-Type": ARROW})
    assert sent.json() == {"accepted": 1_000}
    with http.stream("GET", "/streams/texts/samples?limit=1000000") as answer:
        assert "content-length" not in answer.headers
        found = 0
        for line in answer.iter_lines():
            assert json.loads(line)["t"] == "x" * 60_000
            found += 1
    assert found == 1_000
    plain = {"Accept-Encoding": "identity"}
    short = http.get("/streams/texts/samples?limit=1", headers=plain)
    assert int(short.headers["content-length"]) == len(short.content)


def test_what_a_batch_may_have_is_a_setting(http: httpx.Client) -> None:
    http.put("/streams/texts", json={"fields": {"t": "string"}}).raise_for_status()
    good = json.dumps({"valid": 1, "t": "x" * 65_536}) + "\n"
    bad = json.dumps({"valid": 1, "t": "x" * 65_537}) + "\n"

    def send(path: str, content: bytes | str, kind: str = NDJSON) -> dict[str, Any]:
        answer = http.post(
            f"/streams/texts/samples{path}", content=content, headers={"Content-Type": kind}
        )
        return {"status": answer.status_code, **answer.json()}

    assert send("", good)["accepted"] == 1
    for path in ("", "/live"):
        problem = send(path, good + bad)
        assert (problem["status"], problem["line"]) == (400, 2)
        assert "at most 65536 bytes" in problem["detail"]
        problem = send(path, dictionary(3, "x" * 65_537), ARROW)
        assert (problem["status"], problem["line"]) == (400, 1)
        problem = send(path, dictionary(1_501, "x"), ARROW)
        assert (problem["status"], "at most 1500 samples" in problem["detail"]) == (400, True)
    lines = "".join(f'{{"valid": {i}, "t": null}}\n' for i in range(1_501))
    assert send("", lines)["line"] == 1_501
    # Of lines that come one by one there may be any number.
    assert send("/live", lines)["accepted"] == 1_501
