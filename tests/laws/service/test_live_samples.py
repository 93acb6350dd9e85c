"""Live samples: however the bytes of a body are cut, the same is published and refused."""

import itertools
import json
from contextlib import contextmanager
from unittest.mock import patch

from hypothesis import example, given, settings
from hypothesis import strategies as st

from dyknow.converters.arrow.stream import decode_arrow, encode_arrow
from dyknow.converters.errors import WireError
from dyknow.converters.ndjson import decode_ndjson
from dyknow.converters.ndjson_errors import mixed_times
from dyknow.converters.wire import BOM, BatchLimits
from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import DyknowError
from dyknow.engine.model.views import StreamDeclaration
from dyknow.rdf.namespaces import DYKNOW
from dyknow.service.durability.command_queue import CommandQueue
from dyknow.service.runtime.live_ingest import LiveLines, LiveTables
from dyknow.streams.history import Retention
from dyknow.streams.sample import Field, FieldType, Schema, batch_from_rows

LIMITS = settings(deadline=None, max_examples=150)
SCHEMA = Schema((Field("id", FieldType.STRING), Field("n", FieldType.INTEGER)))


ENGINE = Engine(epoch="e1")
COMMANDS = CommandQueue(ENGINE, None, {})
LIMITED = BatchLimits(10_000, 1 << 20, 1 << 30)
NUMBERS = itertools.count()
"""Each example has streams of its own in one engine, which takes longer to make than all else."""


@contextmanager
def streams(is_open=False):
    """Two new ones; their fields are decided by their first sample if they are open."""
    names = [f"s{next(NUMBERS)}" for _ in range(2)]
    for name in names:
        if is_open:
            ENGINE.add_kpl(f"source pos {name}")
        else:
            ENGINE.declare(StreamDeclaration(name, SCHEMA.fields, 3, Retention(), DYKNOW, None))
    try:
        yield names
    finally:
        for name in names:
            if is_open:
                ENGINE.remove_kpl(name, cascade=True)
            else:
                ENGINE.remove_stream(name)


def good(time, stamped=False, text="a"):
    sample = {"valid": time, "id": text, "n": time}
    if not stamped:
        sample["available"] = time
    return json.dumps(sample).encode()


@st.composite
def lines(draw):
    stamped = draw(st.booleans())
    usual = st.builds(
        good, st.integers(0, 30), st.just(stamped), st.sampled_from(["a", "ö", "\n", '"'])
    )
    other = st.sampled_from(
        [
            b"",
            b"  ",
            b"\t",
            b"\x0b",
            BOM,
            BOM + good(3, stamped),
            good(4, not stamped),
            b'{"valid": 1}',
            b'{"valid": 1, "available": 1, "id": "a", "n": 1, "n": 2}',
            b'{"valid": 1, "available": 1, "id": "a", "n": 99999999999999999999}',
            b'{"valid": "1970-13-01T00:00:00Z", "id": "a", "n": 1}',
            b'{"valid": 1, "id": "a", "n": 1.5}',
            good(5, stamped) + good(6, stamped),
            b"[1]",
            b"\xff",
            b"{",
            b"[" * 3000,
        ]
    )
    found = draw(st.lists(st.one_of(usual, usual, usual, st.just(b""), other), max_size=12))
    end = draw(st.sampled_from([b"\n", b"\r\n"]))
    last = draw(st.sampled_from([b"", b"\n"]))
    begin = draw(st.sampled_from([b"", b"", BOM]))
    # Repeated, so that some parts are large enough for the short way through NDJSON.
    times = draw(st.sampled_from([1, 1, 40]))
    return begin + end.join(found * times) + last


def line_by_line(name, body):
    """The definition: each line is a batch of its own, until one is refused."""
    accepted, stamped = 0, None
    for number, line in enumerate(body.removeprefix(BOM).split(b"\n"), 1):
        if not line.strip():
            continue
        if line.startswith(BOM):
            return accepted, WireError, number
        generator = ENGINE.accepting(name)
        try:
            incoming = decode_ndjson(line, generator.schema, generator.stream.pools, LIMITED)
        except WireError:
            return accepted, WireError, number
        if stamped not in (None, incoming.stamped):
            return accepted, WireError, number
        try:
            accepted += ENGINE.publish(name, incoming, 100)
        except DyknowError as error:
            return accepted, type(error), None
        stamped = incoming.stamped
    return accepted, None, None


def cut(data, places):
    edges = sorted({0, len(data), *(place % (len(data) + 1) for place in places)})
    return [data[begin:end] for begin, end in itertools.pairwise(edges)]


def live(name, parts, make=LiveLines, together=1 << 20):
    samples = make(ENGINE, COMMANDS, name, lambda: 100, LIMITED)
    try:
        with patch("dyknow.service.runtime.live_ingest._TOGETHER", together):
            for part in parts:
                while samples.take(part):
                    part = b""
            samples.end()
    except (WireError, DyknowError) as error:
        return samples.accepted, type(error), getattr(error, "line", None)
    return samples.accepted, None, None


def state(name):
    """What is stamped together on arrival is one instant, so the cuts decide those times."""
    generator = ENGINE.accepting(name)
    rows = list(generator.stream.all().rows())
    if generator.stamped:
        rows = [(valid, values) for _, valid, values in rows]
    return rows, generator.counters, generator.stamped


@LIMITS
@given(
    lines(),
    st.lists(st.integers(0, 10_000), max_size=12),
    st.booleans(),
    st.sampled_from(["open", "declared", "begun"]),
)
# A byte order mark within the body begins what has come, and is no part of it all the same.
@example(good(1) + b"\n" + BOM + good(3), [], True, "declared")
# What decides the fields has some.
@example(b'{"valid": 1}\n' + good(3), [], False, "open")
def test_lines_are_published_as_one_by_one(body, places, bytewise, before):
    bytewise = bytewise and len(body) < 2000
    parts = [body[i : i + 1] for i in range(len(body))] if bytewise else cut(body, places)
    with streams(before == "open") as (whole, slow):
        if before == "begun":  # samples came before that bring their times
            for name in (whole, slow):
                pools = ENGINE.accepting(name).stream.pools
                ENGINE.publish(name, decode_ndjson(good(1), SCHEMA, pools), 5)
        assert live(whole, parts) == line_by_line(slow, body)
        assert state(whole) == state(slow)


def tables(rows):
    return [
        batch_from_rows(SCHEMA, [(t, t, {"id": f"u{t % 3}", "n": n}) for t, n in part], {})
        for part in rows
    ]


TOGETHER = st.sampled_from([1, 300, 1 << 20])
"""Bytes of record batches that are published in one go."""
ROWS = st.lists(
    st.lists(st.tuples(st.integers(0, 50), st.integers(-5, 5)), min_size=1, max_size=5), max_size=5
)


def one_stream(batches, dictionary):
    """All batches in one Arrow stream; text as dictionaries that grow where ``dictionary``."""
    import pyarrow as pa

    found = [pa.ipc.open_stream(encode_arrow(batch)).read_all() for batch in batches]
    if not found:
        return b""
    if dictionary:
        found = [t.set_column(2, "id", t.column("id").dictionary_encode()) for t in found]
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, found[0].schema) as writer:
        for table in found:
            writer.write_table(table)
    return sink.getvalue().to_pybytes()


@LIMITS
@given(
    ROWS,
    st.lists(st.integers(0, 10_000), max_size=12),
    st.sampled_from(["many", "one", "dict"]),
    TOGETHER,
)
def test_record_batches_are_published_as_they_are_complete(rows, places, form, together):
    batches = tables(rows)
    if form == "many":  # one stream after the other
        body = b"".join(encode_arrow(batch) for batch in batches)
    else:
        body = one_stream(batches, form == "dict")
    with streams() as (whole, slow):
        pools = ENGINE.accepting(slow).stream.pools
        accepted = 0
        for batch in batches:
            incoming = decode_arrow(encode_arrow(batch), SCHEMA, pools)
            accepted += ENGINE.publish(slow, incoming, 100)
        assert live(whole, cut(body, places), LiveTables, together) == (accepted, None, None)
        assert state(whole) == state(slow)


def arrow_of(kind, times):
    """A stream of one record batch; all but the first two kinds are refused."""
    import pyarrow as pa

    columns = {"valid": times, "available": times, "id": ["a"] * len(times), "n": times}
    if kind == "stamped":
        del columns["available"]
    if kind == "too large":
        columns["n"] = pa.array([2**63] * len(times), pa.uint64())
    if kind == "without id":
        del columns["id"]
    table = pa.table(columns)
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    return sink.getvalue().to_pybytes()


KINDS = st.sampled_from(["good", "good", "good", "good", "stamped", "too large", "without id"])


@LIMITS
@given(
    st.lists(st.tuples(KINDS, st.lists(st.integers(0, 9), min_size=1, max_size=3)), max_size=8),
    st.lists(st.integers(0, 10_000), max_size=6),
    st.booleans(),
    TOGETHER,
)
def test_a_record_batch_is_refused_as_if_it_came_alone(parts, places, is_open, together):
    bodies = [arrow_of(kind, times) for kind, times in parts]
    with streams(is_open) as (whole, slow):
        accepted, rows, stamped, refused = 0, 0, None, None
        for body, (_, times) in zip(bodies, parts, strict=True):
            target = ENGINE.accepting(slow)
            try:
                incoming = decode_arrow(body, target.schema, target.stream.pools)
                if stamped not in (None, incoming.stamped):
                    raise mixed_times(1)
                accepted += ENGINE.publish(slow, incoming, 100)
            except (WireError, DyknowError) as error:
                line = getattr(error, "line", None)
                refused = (type(error), None if line is None else rows + line)
                break
            rows, stamped = rows + len(times), incoming.stamped
        found = live(whole, cut(b"".join(bodies), places), LiveTables, together)
        assert found == (accepted, *(refused or (None, None)))
        assert state(whole) == state(slow)


@LIMITS
@given(ROWS.filter(bool), st.integers(0, 10_000), st.binary(min_size=1, max_size=4), st.data())
def test_no_bytes_make_it_fail_otherwise(rows, place, noise, data):
    """Broken streams are refused, whatever is broken in them and however they come."""
    body = bytearray(one_stream(tables(rows), data.draw(st.booleans())))
    at = place % len(body)
    body[at : at + len(noise)] = noise
    places = data.draw(st.lists(st.integers(0, 10_000), max_size=5))
    with streams() as (first, second):
        found = live(first, cut(bytes(body), places), LiveTables)
        assert found == live(second, [bytes(body)], LiveTables)
        assert state(first) == state(second)
        assert found[0] <= sum(map(len, rows))
