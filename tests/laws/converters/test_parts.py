"""A batch that another thread decodes is the batch that is decoded at once: whatever a part is, and
whatever the engine does meanwhile."""

import json
from contextlib import contextmanager
from itertools import count
from unittest.mock import patch

from hypothesis import example, given, settings
from hypothesis import strategies as st
from sample_lines import bodies, mutated

from dyknow.converters import WireError, ndjson_lines, ndjson_scan, wire
from dyknow.converters.arrow.stream import ArrowWriter
from dyknow.converters.ndjson_errors import mixed_times
from dyknow.converters.ndjson_lines import decode_lines, infer_fields
from dyknow.converters.wire import BatchLimits
from dyknow.engine.durability.commands import (
    DeclareStream,
    EndStream,
    Publish,
    RemoveStream,
    Tick,
)
from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import DyknowError
from dyknow.engine.model.views import StreamDeclaration
from dyknow.streams import history, string_pool
from dyknow.streams.history import Retention
from dyknow.streams.sample import Field, FieldType, Schema, batch_from_rows
from dyknow.streams.string_pool import StringPool

LIMITS = settings(deadline=None, max_examples=300)
SIZES = st.integers(1, 200)


def outcome(decode, *arguments):
    """The samples and the pools, or the error with its place."""
    pools = {}
    try:
        incoming = decode(*arguments, pools)
    except WireError as error:
        assert not pools
        return error.line, error.message, error.hint
    codes = [
        None if column.pool is None else column.values.tolist()
        for column in incoming.batch.columns.values()
        if column.null is None
    ]
    texts = {name: pool.strings() for name, pool in pools.items()}
    return incoming.stamped, repr(list(incoming.batch.rows())), codes, texts


def line_by_line(data, schema, pools):
    """What a body is: its lines, each decoded by itself."""
    rows, stamped = [], None
    for number, line in enumerate(data.split(b"\n"), 1):
        if not line.strip():
            continue
        try:
            found = decode_lines(line, schema, {})
        except WireError as error:
            raise WireError(number, error.message, error.hint) from None
        if stamped not in (None, found.stamped):
            raise mixed_times(number)
        stamped = found.stamped
        rows += found.batch.rows()
    if stamped is None:
        raise WireError(
            None, "the body holds no sample", "send one JSON object a line, at least one"
        )
    batch = batch_from_rows(schema, rows, {})
    pools |= {
        name: column.pool for name, column in batch.columns.items() if column.pool is not None
    }
    return wire.Incoming(batch, stamped)


TWO = Schema((Field("a", FieldType.INTEGER), Field("b", FieldType.STRING)))


@given(bodies() | mutated(), SIZES)
@LIMITS
@example(
    (TWO, b'{"valid":1,"a":1,"b":"x"}{"valid":1,"a":1,"b":"x"}\n{"valid":1,\n"a":1,"b":"x"}'), 9
)
@example((TWO, b'{"valid":1,\n"a":1,"b":"x"}'), 99)
@example((TWO, b'{"valid":1,"a":1,"b":"x"}\n{"valid":1,"available":2,"a":1,"b":"y"}'), 30)
@example((TWO, b'{"valid":1,"a":1,"a":1,"b":""}\n{"valid":1,"a":99999999999999999999,"b":""}'), 99)
def test_a_body_is_its_lines_whatever_a_part_is(drawn, size):
    schema, data = drawn
    whole = outcome(lambda pools: decode_lines(data, schema, pools))
    assert whole == outcome(lambda pools: decode_lines(data, schema, pools, size))
    assert whole == outcome(lambda pools: line_by_line(data, schema, pools))


@given(bodies() | mutated(), SIZES)
@example((TWO, b'{"valid":1,"available":1,"a\\bb":1}'), 30)
@LIMITS
def test_an_open_streams_fields_do_not_depend_on_parts(drawn, size):
    _, data = drawn

    def decided(pools, *more):
        schema = infer_fields(data, None, *more)
        found = decode_lines(data, schema, pools, *more)
        assert [*found.batch.columns] == [*schema.names]
        return found

    whole = outcome(decided)
    assert whole == outcome(lambda pools: decided(pools, size))


FIELDS = (Field("t", FieldType.STRING), Field("n", FieldType.INTEGER))
OTHERS = (Field("t", FieldType.STRING), Field("n", FieldType.FLOAT))
TEXTS = st.sampled_from(["a", "b", "c", "ä", "\n", None]) | st.text("xyz", max_size=2)
ROWS = st.lists(st.tuples(TEXTS, st.integers(-3, 3) | st.none()), min_size=1, max_size=30)


def lines(rows, at):
    dumped = (
        json.dumps({"valid": at + i, "available": at + i, "t": t, "n": n}, ensure_ascii=at % 2 == 0)
        for i, (t, n) in enumerate(rows)
    )
    return "\n".join(dumped).encode()


def tables(rows, at):
    """As an Arrow stream of several batches."""
    writer, found = ArrowWriter(), b""
    for start in range(0, len(rows), 7):
        part = [(at + i, at + i, {"t": t, "n": n}) for i, (t, n) in enumerate(rows)][
            start : start + 7
        ]
        found += writer.write(batch_from_rows(Schema(FIELDS), part))
    return found + writer.close()


def declared(fields):
    return DeclareStream(StreamDeclaration("s", fields, 3, Retention(6)))


WAYS = {"ndjson": lines, "arrow": tables}
COMMANDS = st.one_of(
    st.builds(
        lambda rows, at: Publish("s", "ndjson", lines(rows, at), at),
        ROWS.map(lambda rows: rows[:3]),
        st.integers(0, 90),
    ),
    st.integers(0, 200).map(Tick),
    st.just(EndStream("s")),
    st.just(RemoveStream("s")),
    st.sampled_from([FIELDS, OTHERS]).map(declared),
)


class Meanwhile:
    """Commands that the engine's thread does while another thread decodes: ``moments`` has them by
    the number of the call. ``done`` are those that it did."""

    def __init__(self, engine, moments):
        self.engine, self.moments, self.done, self.count = engine, moments, [], 0

    def __call__(self):
        for command in self.moments.pop(self.count, ()):
            self.done.append(command)
            attempted(self.engine, command)
        self.count += 1


@contextmanager
def disturbed(others):
    """``others`` act before each search for the code of one text in a pool."""
    found = StringPool.find

    def find(pool, text):
        with patch.object(StringPool, "find", found):
            others()
        return found(pool, text)

    with patch.object(StringPool, "find", find):
        yield


def attempted(engine, command):
    try:
        return command.apply(engine)
    except (DyknowError, WireError) as error:
        return type(error), str(error)


def said(engine):
    """All that the stream is, codes of its texts included."""
    try:
        generator = engine.generator("s")
    except DyknowError:
        return None
    batch = generator.stream.all()
    codes = {
        name: column.values.tolist()
        for name, column in batch.columns.items()
        if column.pool is not None
    }
    texts = {name: pool.strings() for name, pool in generator.stream.pools.items()}
    rows = repr((list(batch.rows()), list(generator.pending.rows())))
    return rows, codes, texts, generator.counters


@contextmanager
def small_parts():
    """Each moment that there can be, and texts forgotten at every chance."""
    with (
        patch.object(ndjson_lines, "PART", 40),
        patch.object(string_pool, "_MANY", 2),
        patch.object(string_pool, "_FEW", 1),
        patch.object(history, "_TEXTS", 2),
        patch.object(history, "_SHARE", 1),
    ):
        yield


def make():
    found = Engine(epoch="e")
    declared(FIELDS).apply(found)
    return found


EMPTY = make()
"""An engine takes long to make: each example declares the stream anew."""
OTHER = make()


def anew(engine):
    attempted(engine, RemoveStream("s"))
    declared(FIELDS).apply(engine)
    return engine


BOUNDS = BatchLimits(1000, 1000, 10**6)


@given(
    st.sampled_from([*WAYS]),
    ROWS,
    st.lists(st.tuples(ROWS, st.integers(0, 30)), max_size=2),
    st.dictionaries(st.integers(0, 40), st.lists(COMMANDS, min_size=1, max_size=2), max_size=6),
    st.integers(0, 100),
    st.booleans(),
)
@LIMITS
@example("ndjson", [("a", 1)] * 9, [], {3: [RemoveStream("s"), declared(OTHERS)]}, 5, True)
@example("ndjson", [("a", 1)] * 9, [], {3: [RemoveStream("s")]}, 5, True)
def test_it_is_as_if_it_had_come_when_it_was_decoded(kind, rows, before, moments, at, is_regular):
    """Done again from the log, in the order in which all was done, the same comes of it: the same
    samples under the same numbers, their texts in the same codes."""
    live, again = anew(EMPTY), anew(OTHER)
    with small_parts(), patch.object(ndjson_scan.cells, "LEAST", 0 if is_regular else 10**9):
        for each, time in before:
            for engine in (live, again):
                attempted(engine, Publish("s", "ndjson", lines(each, time), time))
        batch = Publish("s", kind, WAYS[kind](rows, at), at)
        meanwhile = Meanwhile(live, dict(moments))
        found = None
        try:
            while found is None:
                generator = live.accepting("s")
                schema = generator.schema
                meanwhile()
                with disturbed(meanwhile):
                    decoded = batch.decode_beside(generator.stream, schema, BOUNDS)
                meanwhile()
                if live.accepting("s").schema == schema:
                    found = decoded
            result = batch.apply_decoded(live, found)
        except (DyknowError, WireError) as error:
            result = type(error), str(error)
        for command in meanwhile.done:
            attempted(again, command)
        assert result == attempted(again, batch)
        assert said(live) == said(again)


@given(
    st.lists(st.lists(st.text("ab", max_size=2)), max_size=3),
    st.lists(st.text("abc", max_size=3), unique=True, max_size=12),
    st.dictionaries(st.integers(0, 12), st.lists(st.text("abc", max_size=3), max_size=3)),
    st.lists(st.text("abc", max_size=3), max_size=9),
)
@LIMITS
def test_texts_whose_place_is_found_before_are_as_if_encoded(before, own, between, after):
    with small_parts():
        pool, slow = StringPool(), StringPool()
        for texts in before:
            assert pool.encode(texts).tolist() == slow.encode(texts).tolist()
        mine = StringPool(own)
        counter = count()

        def others():
            texts = between.get(next(counter), [])
            assert pool.encode(texts).tolist() == slow.encode(texts).tolist()

        with disturbed(others):
            mine.find_place(pool)
        assert mine.codes_in(pool).tolist() == slow.encode(own).tolist()
        for text in after:
            assert pool.find(text) == slow.find(text)
            assert pool.code(text) == slow.code(text)
        second = StringPool(after)
        second.find_place(pool)
        assert second.has_place(pool)
        assert second.codes_in(pool).tolist() == slow.encode(second.strings()).tolist()
        assert pool.encode(own).tolist() == slow.encode(own).tolist()
        assert pool.strings() == slow.strings()


def test_what_is_found_out_before_is_all_that_takes_long():
    """Nothing is looked up when the batch is taken."""
    pool, mine = StringPool(["a", "b"]), StringPool(["c", "a", "d"])
    mine.find_place(pool)
    assert mine.has_place(pool)
    assert pool.strings() == ["a", "b"]
    with patch.object(StringPool, "encode", None), patch.object(StringPool, "code", None):
        assert mine.codes_in(pool).tolist() == [2, 0, 3]
    assert pool.strings() == ["a", "b", "c", "d"]
    stale = StringPool(["x", "y"])
    stale.find_place(pool)
    pool.code("y")
    assert not stale.has_place(pool)
    assert stale.codes_in(pool).tolist() == [5, 4]


def test_decoding_touches_nothing_before_it_is_taken():
    live = anew(EMPTY)
    before = said(live)
    for kind, make_body in WAYS.items():
        batch = Publish("s", kind, make_body([("new", 1)] * 9, 1), 1)
        stream = live.generator("s").stream
        assert len(batch.decode_beside(stream, Schema(FIELDS), BOUNDS).batch) == 9
        assert said(live) == before
