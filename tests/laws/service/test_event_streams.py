"""What clients of event streams are told: every later sample once and in order, and before what is
not kept a gap, wherever they are cut and whatever the stream does meanwhile."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from typing import Any

from hypothesis import example, given, settings
from hypothesis import strategies as st

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.service.sse.clients import EventClient, EventClients
from dyknow.service.sse.cursor import Cursor
from dyknow.service.sse.delivery import Delivery
from dyknow.service.sse.feeds import Feeds
from dyknow.service.sse.multi_stream import Position, open_cursor
from dyknow.streams.history import Retention
from dyknow.streams.sample import Field, FieldType, Schema, batch_from_rows

MESSAGE = re.compile(rb"(?:id: (\S+)\n)?event: (\w+)\ndata: ([^\n]*)\n\n")
SCHEMA = Schema((Field("n", FieldType.INTEGER), Field("text", FieldType.STRING)))


@dataclass
class Service:
    """A stream that samples are published to, and the same without bounds."""

    retention: Retention
    feeds: Feeds = field(init=False)
    published: int = 0
    time: int = 0

    def __post_init__(self) -> None:
        self.engine = Engine(epoch="e1")
        self.engine.declare(StreamDeclaration("s", SCHEMA.fields, 0, self.retention))
        # A cache so small that most messages are encoded again.
        self.feeds = Feeds(self.engine, 5_000, EventClients(100, 100, 0, 30))

    def publish(self, count: int, length: int) -> None:
        rows = []
        for _ in range(count):
            self.published += 1
            self.time += 1
            rows.append((self.time, self.time, {"n": self.published, "text": "x" * length}))
        pools = self.engine.accepting("s").stream.pools
        self.engine.publish("s", Incoming(batch_from_rows(SCHEMA, rows, pools), False), 0)

    def keep(self, retention: Retention) -> None:
        """Other history than before, from now on."""
        self.engine.declare(StreamDeclaration("s", SCHEMA.fields, 0, retention))

    @property
    def kept(self) -> int:
        return self.engine.stream("s").first_number


@dataclass
class Reader:
    """A client as the standard has it: it knows the id of the last message it had whole."""

    service: Service
    id: str = "e1-0"
    numbers: list[int] = field(default_factory=list)
    ends: list[str] = field(default_factory=list)
    client: EventClient = field(default_factory=lambda: EventClient("x"))

    def __post_init__(self) -> None:
        self._connect()

    def read(self, pieces: int) -> None:
        """Take at most so many pieces of the answer."""
        for _ in range(pieces):
            data = self.cursor.take()
            if data is None:
                break
            self._text += data
            self._parse()

    def cut(self, share: float) -> None:
        """The connection breaks: of the next piece a ``share`` of bytes has come."""
        data = self.cursor.take() or b""
        self._text += data[: int(share * len(data))]
        self._parse()
        self.cursor.leave(self.client)
        self._connect()

    def _connect(self) -> None:
        self._text = b""
        self._lost = 0  # a gap has no id: it is told again
        feeds = self.service.feeds
        self.cursor = Cursor(feeds, "s", feeds.start("s", self.id))
        self.cursor.join(self.client)

    def _parse(self) -> None:
        end = 0
        for found in MESSAGE.finditer(self._text):
            end = found.end()
            data = json.loads(found[3])
            match found[2]:
                case b"sample":
                    self.id = found[1].decode()
                    assert self.id == f"e1-{data['sequence']}"
                    assert data["values"]["n"] == data["sequence"]
                    assert data["sequence"] == self._next()
                    self.numbers.append(data["sequence"])
                case b"gap":
                    # What it says is lost is all that is, and it is no longer there to be had.
                    assert data["from"] == self._next()
                    assert data["from"] <= data["to"] < self.service.kept
                    self._lost = data["to"]
                case b"end":
                    self.ends.append(data["reason"])
        self._text = self._text[end:]

    def _next(self) -> int:
        """The number that comes next, after the last sample or gap."""
        return max(self.numbers[-1] if self.numbers else 0, self._lost) + 1


counts = st.integers(1, 12) | st.sampled_from([300, 700])
steps = st.lists(
    st.tuples(st.just("publish"), counts, st.sampled_from([0, 5, 40, 40_000]))
    | st.tuples(st.just("read"), st.integers(0, 7), st.integers(1, 5))
    | st.tuples(st.just("cut"), st.integers(0, 7), st.floats(0, 1))
    | st.tuples(st.just("end"), st.none(), st.none())
    | st.tuples(st.just("keep"), st.integers(1, 20), st.integers(1, 4_000)),
    max_size=25,
)
retentions = st.builds(
    Retention,
    st.integers(1, 20) | st.just(1_000),
    st.none() | st.integers(0, 30),
    st.none() | st.integers(1, 4_000),
)


@settings(deadline=None, max_examples=80)
@given(retentions, st.integers(1, 4), steps)
@example(Retention(4), 1, [("publish", 12, 0), ("cut", 0, 0.5), ("publish", 12, 0)])
@example(Retention(1), 1, [("publish", 12, 0), ("cut", 0, 0.5), ("publish", 1, 0)])
def test_every_later_sample_once_and_in_order_or_a_gap(
    retention: Retention, clients: int, steps: list[tuple[str, int, float]]
) -> None:
    """Law of `Cursor`: what was read (`Reader` asserts at each message that nothing is skipped but
    by a gap of just that, and nothing comes twice), and at last everybody has got to the end."""
    service = Service(retention)
    readers = [Reader(service) for _ in range(clients)]
    for kind, which, how in steps:
        match kind:
            case "publish":
                count = which if how < 40_000 else min(which, 5)
                service.publish(count, int(how))
            case "read":
                readers[which % clients].read(int(how))
            case "cut":
                readers[which % clients].cut(how)
            case "end":
                service.engine.end("s")
            case "keep":
                service.keep(Retention(which, None, int(how)))
    service.engine.end("s")
    for reader in readers:
        reader.cut(0.0)
        reader.read(10_000)
        assert reader.ends[-1] == "ended"
        assert reader._next() == service.published + 1
        # What was kept all the time has been read, all of it.
        kept = range(service.kept, service.published + 1)
        assert set(kept) <= set(reader.numbers)
    assert service.feeds._cache.size <= 5_000


@settings(deadline=None, max_examples=60)
@given(
    retentions,
    st.lists(
        st.tuples(st.just("publish"), st.integers(0, 2), st.integers(1, 40))
        | st.tuples(st.just("read"), st.integers(0, 5), st.none())
        | st.tuples(st.just("cut"), st.floats(0, 1), st.none())
        | st.tuples(st.just("end"), st.integers(0, 2), st.none()),
        max_size=30,
    ),
)
def test_several_streams_go_on_after_any_id(
    retention: Retention, steps: list[tuple[str, Any, Any]]
) -> None:
    """Law of `MultiCursor`: each stream's later samples once and in order, or a gap; after a cut
    anywhere all resume at their positions."""
    names = ["a", "b", "c"]
    engine = Engine(epoch="e1")
    for name in names:
        engine.declare(StreamDeclaration(name, SCHEMA.fields[:1], 0, retention))
    feeds = Feeds(engine, 3_000, EventClients(100, 100, 0, 30))
    published = dict.fromkeys(names, 0)
    known = dict.fromkeys(names, 0)
    """By stream: the last number that was had, or told to be lost."""
    client = EventClient("x")
    id = str(Position("e1", known))
    followed, text = open_cursor(feeds, names, Delivery(id)), b""
    followed.join(client)

    def take(share: float = 1.0) -> bool:
        nonlocal text, id
        data = followed.take()
        text += (data or b"")[: int(share * len(data or b""))]
        end = 0
        for found in MESSAGE.finditer(text):
            end, told = found.end(), json.loads(found[3])
            name = told["stream"]
            if found[2] == b"sample":
                id = found[1].decode()
                assert told["sequence"] == told["values"]["n"] == known[name] + 1
                known[name] += 1
            elif found[2] == b"gap":
                assert told["from"] == known[name] + 1 <= told["to"]
                assert told["to"] < engine.stream(name).first_number
                known[name] = told["to"]
        text = text[end:]
        return data is not None

    for kind, which, count in steps:
        if kind == "publish":
            name = names[which]
            pools = engine.accepting(name).stream.pools
            rows = [
                (i, i, {"n": i}) for i in range(published[name] + 1, published[name] + 1 + count)
            ]
            published[name] += count
            batch = batch_from_rows(Schema(SCHEMA.fields[:1]), rows, pools)
            engine.publish(name, Incoming(batch, False), 0)
        elif kind == "end":
            engine.end(names[which])
        elif kind == "read":
            for _ in range(which):
                take()
        else:
            take(which)
            followed.leave(client)
            # Of a gap that was told since the last sample nothing is in its id: it is told again.
            known = Position.parse(id, names).numbers
            followed, text = open_cursor(feeds, names, Delivery(id)), b""
            followed.join(client)
    while take():
        pass
    assert known == published
    followed.leave(client)


@settings(deadline=None, max_examples=20)
@given(st.lists(counts, max_size=6), st.lists(counts, min_size=1, max_size=6))
def test_a_stream_that_goes_on_after_its_end_is_resumed_without_loss(
    before: list[int], after: list[int]
) -> None:
    service = Service(Retention(10_000))
    reader = Reader(service)
    for count in before:
        service.publish(count, 3)
    service.engine.end("s")
    reader.read(10_000)
    assert reader.ends == ["ended"]
    for count in after:
        service.publish(count, 3)
    reader.cut(0.3)
    reader.read(10_000)
    assert reader.numbers == list(range(1, service.published + 1))


@settings(deadline=None, max_examples=20)
@given(st.lists(counts, min_size=1, max_size=5), st.integers(0, 40))
def test_of_a_removed_stream_the_last_samples_still_come(batches: list[int], read: int) -> None:
    service = Service(Retention(10_000))
    reader = Reader(service)
    for count in batches:
        service.publish(count, 3)
    reader.read(read)
    reader.cursor.leave(reader.client)
    reader._connect()
    _remove(service)
    reader.read(10_000)
    assert reader.numbers == list(range(1, service.published + 1))
    assert reader.ends == ["removed"]


def _remove(service: Service) -> None:
    """As DELETE does it: a client of events holds no stream."""
    service.engine.remove_stream("s")
    service.feeds.review()


@settings(deadline=None, max_examples=30)
@given(st.lists(st.tuples(counts, st.integers(0, 6), st.integers(0, 6)), min_size=1, max_size=4))
def test_a_stream_that_is_declared_anew_never_uses_an_id_twice(
    lives: list[tuple[int, int, int]],
) -> None:
    """Else a client that resumes would miss the first samples of the new one, and not know."""
    service = Service(Retention(10_000))
    reader = Reader(service)
    for i, (count, read, unseen) in enumerate(lives):
        if i:
            _remove(service)
            service.engine.declare(StreamDeclaration("s", SCHEMA.fields, 0, service.retention))
            reader.cursor.leave(reader.client)
            reader._connect()
        service.publish(count, 3)
        reader.read(read)
        service.publish(unseen, 3)
    reader.cut(0.0)
    reader.read(10_000)
    kept = range(service.kept, service.published + 1)
    assert len(kept) == lives[-1][0] + lives[-1][2]
    assert set(kept) <= set(reader.numbers)
