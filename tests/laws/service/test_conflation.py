"""``every`` of event streams: what it sends is what its definition gives, and a client that is cut
off anywhere resumes without a repetition, and with the newest sample of each object."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any
from unittest.mock import patch

from hypothesis import example, given, settings
from hypothesis import strategies as st
from sse_clients import MESSAGE

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.engine.requests.adaptive_subscription import Rematch
from dyknow.service.sse.clients import EventClient, EventClients
from dyknow.service.sse.conflation import ConflatedCursor
from dyknow.service.sse.cursor import Cursor
from dyknow.service.sse.delivery import Delivery, Projection
from dyknow.service.sse.feeds import Feeds
from dyknow.service.sse.multi_stream import MultiCursor, Position, open_cursor
from dyknow.streams.history import Retention
from dyknow.streams.sample import Field, FieldType, Schema, batch_from_rows
from dyknow.streams.time import SECOND

SCHEMA = Schema(
    (Field("id", FieldType.STRING), Field("n", FieldType.INTEGER), Field("text", FieldType.STRING))
)
SSL = "stream s contains xydist(UAV as a, UAV as b) = n for every a = id, b = text"
"""Two fields name an object, and its triples have a node, which counts samples of an instant."""
Name = tuple[str | None, str] | None
OBJECTS = ["a", "b", "c", None]
MANY: list[str | None] = [f"o{i}" for i in range(150)]
"""More objects than a piece has messages."""


@dataclass
class Service:
    """A stream of objects, and a clock (s) that is moved by hand."""

    is_annotated: bool = True
    now: float = 0.0
    published: list[tuple[str | None, str]] = field(default_factory=list)
    """The object of each sample."""

    def __post_init__(self) -> None:
        self.engine = Engine(epoch="e1")
        self.engine.declare(StreamDeclaration("s", SCHEMA.fields, 0))
        if self.is_annotated:
            self.engine.annotate(SSL)
        self.feeds = Feeds(self.engine, 5_000, EventClients(100, 100, 0, 30))

    def publish(self, objects: list[str | None], length: int) -> None:
        rows = []
        for object in objects:
            self.published.append((object, "x" * length))
            number = len(self.published)
            time = number // 2
            rows.append((time, time, {"id": object, "n": number, "text": "x" * length}))
        pools = self.engine.accepting("s").stream.pools
        self.engine.publish("s", Incoming(batch_from_rows(SCHEMA, rows, pools), False), 0)

    def name(self, number: int) -> Name:
        """The object of a sample, as the client counts it."""
        return self.published[number - 1] if self.is_annotated else None

    def cursor(self, id: str, every: int) -> ConflatedCursor:
        start = self.feeds.start("s", id)
        parts = (None, Projection(("n",), has_rdf=True), every * SECOND, lambda: self.now)
        return ConflatedCursor(self.feeds, "s", start, *parts)


def by_definition(
    service: Service, looks: list[tuple[float, int]], every: int
) -> list[tuple[int, int]]:
    """The messages as (number, count) of a client that looks at these moments, each with the number
    of the newest sample: unless it is within ``every`` after the begin of the last round, a round
    of all samples since then."""
    found: list[tuple[int, int]] = []
    last_round, begin = -float("inf"), 0
    for moment, newest in looks:
        if moment < last_round + every or newest == begin:
            continue
        members: dict[Name, list[int]] = {}
        for number in range(begin + 1, newest + 1):
            members.setdefault(service.name(number), []).append(number)
        found += sorted((max(each), len(each)) for each in members.values())
        last_round, begin = moment, newest
    return found


def read(cursor: Cursor) -> list[tuple[int, dict[str, Any]]]:
    """The numbers and data of all messages that there are now."""
    text = b""
    while (data := cursor.take()) is not None:
        text += data
    return [(int(m[1].rpartition(b"-")[2]), json.loads(m[3])) for m in MESSAGE.finditer(text)]


batches = (
    st.lists(st.sampled_from(OBJECTS), min_size=1, max_size=8)
    | st.builds(
        lambda few, many: few * many,
        st.lists(st.sampled_from(OBJECTS), min_size=1, max_size=3),
        st.just(200),
    )
    | st.just(MANY)
)
steps = st.lists(
    st.tuples(st.just("publish"), batches, st.sampled_from([0, 5]))
    | st.tuples(st.just("pass"), st.integers(0, 12), st.none()),
    max_size=20,
)


@settings(deadline=None, max_examples=60)
@given(steps, st.integers(1, 10), st.booleans())
@example([("publish", ["a", "b", "a"], 0), ("pass", 3, None), ("publish", ["b"], 0)], 5, True)
def test_what_every_sends_is_what_its_definition_gives(
    steps: list[tuple[str, Any, Any]], every: int, is_annotated: bool
) -> None:
    """Law of `ConflatedCursor`, with a client that looks after each step, and when it must."""
    service = Service(is_annotated)
    cursor, plain = (
        service.cursor("e1-0", every),
        Cursor(service.feeds, "s", service.feeds.start("s", "e1-0")),
    )
    clients = EventClient("x"), EventClient("y")
    cursor.join(clients[0])
    plain.join(clients[1])
    looks, found = [], []

    def look() -> None:
        looks.append((service.now, len(service.published)))
        found.extend(read(cursor))

    for kind, what, length in steps:
        if kind == "publish":
            service.publish(what, length)
        else:
            end = service.now + what
            while cursor.delay is not None and service.now + cursor.delay <= end:
                service.now += cursor.delay
                look()
            service.now = end
        look()
    if cursor.delay is not None:
        service.now += cursor.delay
        look()
    assert [(number, data["count"]) for number, data in found] == by_definition(
        service, looks, every
    )
    # No sample is left out of all counts, and a message says what it says without `every`.
    assert sum(data["count"] for _, data in found) == len(service.published)
    whole = dict(read(plain))
    for number, data in found:
        del data["count"]
        data["values"] = whole[number]["values"] | data["values"]
        assert data == whole[number]


@settings(deadline=None, max_examples=80)
@given(
    st.lists(
        st.tuples(st.just("publish"), batches, st.sampled_from([0, 900]))
        | st.tuples(st.just("pass"), st.integers(0, 12), st.none())
        | st.tuples(st.just("cut"), st.floats(0, 1), st.integers(0, 3))
        | st.tuples(st.just("look"), st.integers(0, 3), st.none())
        | st.tuples(st.just("keep"), st.integers(1, 200), st.none()),
        max_size=20,
    ),
    st.integers(1, 10),
)
@example([("publish", MANY, 0), ("look", 1, None), ("keep", 20, None), ("publish", ["a"], 0)], 5)
def test_cut_anywhere_nothing_comes_twice_and_the_newest_always(
    steps: list[tuple[str, Any, Any]], every: int
) -> None:
    service = Service()
    client, id, text = EventClient("x"), "e1-0", b""
    newest: dict[Name, int] = {}
    """By object: the number of the last sample that came, or was reported as lost."""
    last = 0
    moments: dict[Name, float] = {}
    """By object: when its last message of this connection came."""
    cursor = service.cursor(id, every)
    cursor.join(client)

    def take(share: float = 1.0) -> bool:
        nonlocal id, text, last
        data = cursor.take()
        text += (data or b"")[: int(share * len(data or b""))]
        end = 0
        for found in MESSAGE.finditer(text):
            end, told = found.end(), json.loads(found[3])
            if found[2] == b"gap":
                lost = range(told["from"], told["to"] + 1)
                assert lost.stop <= service.engine.stream("s").first_number
                newest.update((service.name(number), number) for number in lost)
            elif found[2] == b"sample":
                assert last < told["sequence"]
                last, id = told["sequence"], found[1].decode()
                name = service.name(last)
                newest[name] = last
                assert told["values"] == {"n": last}
                assert service.now - moments.get(name, -every) >= every
                moments[name] = service.now
        text = text[end:]
        return data is not None

    for kind, what, how in steps:
        if kind == "publish":
            service.publish(what, how)
        elif kind == "pass":
            service.now += what
            while take():
                pass
        elif kind == "look":
            for _ in range(what):
                take()
        elif kind == "keep":
            service.engine.declare(StreamDeclaration("s", SCHEMA.fields, 0, Retention(what)))
        else:
            for _ in range(how):
                take()
            take(what)
            cursor.leave(client)
            cursor, text = service.cursor(id, every), b""
            moments.clear()
            cursor.join(client)
    service.now += every
    while take():
        pass
    service.now += every
    while take():
        pass
    assert newest == {
        name: max(n for n in range(1, len(service.published) + 1) if service.name(n) == name)
        for name in {service.name(n) for n in range(1, len(service.published) + 1)}
    }
    cursor.leave(client)


@settings(deadline=None, max_examples=40)
@given(
    st.lists(
        st.tuples(st.just("publish"), st.sampled_from("st"), batches)
        | st.tuples(st.just("pass"), st.integers(0, 12), st.none())
        | st.tuples(st.just("cut"), st.floats(0, 1), st.integers(0, 3)),
        max_size=15,
    ),
    st.integers(1, 10),
)
def test_several_streams_are_conflated_each_by_itself(
    steps: list[tuple[str, Any, Any]], every: int
) -> None:
    """After any id of several streams, no sample comes twice, and the newest of each object."""
    now = 0.0
    engine = Engine(epoch="e1")
    published: dict[str, list[str | None]] = {"s": [], "t": []}
    for name in published:
        engine.declare(StreamDeclaration(name, SCHEMA.fields))
        engine.annotate(SSL.replace("stream s", f"stream {name}"))
    feeds = Feeds(engine, 5_000, EventClients(100, 100, 0, 30))
    client, text = EventClient("x"), b""
    id = str(Position("e1", dict.fromkeys(published, 0)))
    last = dict.fromkeys(published, 0)
    newest: dict[tuple[str, str | None], int] = {}

    def opened() -> MultiCursor:
        cursor = open_cursor(feeds, [*published], Delivery(id, every=every * SECOND))
        cursor.join(client)
        return cursor

    def take(share: float = 1.0) -> bool:
        nonlocal id, text
        data = cursor.take()
        text += (data or b"")[: int(share * len(data or b""))]
        end = 0
        for found in MESSAGE.finditer(text):
            end, told = found.end(), json.loads(found[3])
            name, id = told["stream"], found[1].decode()
            assert last[name] < told["sequence"]
            last[name] = told["sequence"]
            newest[name, told["values"]["id"]] = told["sequence"]
        text = text[end:]
        return data is not None

    with patch("dyknow.service.sse.feeds.monotonic", lambda: now):
        cursor = opened()
        for kind, what, how in steps:
            if kind == "publish":
                first = len(published[what]) + 1
                published[what] += how
                rows = [
                    (n, n, {"id": object, "n": n, "text": ""})
                    for n, object in enumerate(how, first)
                ]
                pools = engine.accepting(what).stream.pools
                engine.publish(what, Incoming(batch_from_rows(SCHEMA, rows, pools), False), 0)
            elif kind == "pass":
                now += what
                while take():
                    pass
            else:
                for _ in range(how):
                    take()
                take(what)
                cursor.leave(client)
                text = b""
                cursor = opened()
        for _ in range(2):
            now += every
            while take():
                pass
        cursor.leave(client)
    assert newest == {
        (name, object): number
        for name, objects in published.items()
        for number, object in enumerate(objects, 1)
    }


def test_a_switch_between_the_samples_of_a_round_cuts_it_in_two() -> None:
    service = Service()
    service.publish(["a", "b", "a", "b", "a", "b"], 0)
    start = service.feeds.start("s", "e1-0")
    switches = [Rematch(0, 3, "s1 ended", ("s1",), ("s2",)), Rematch(0, 6, "again", (), ())]
    cursor = ConflatedCursor(
        service.feeds, "s", start, switches, Projection(), 5 * SECOND, lambda: service.now
    )
    cursor.join(EventClient("x"))
    text = b""
    while (data := cursor.take()) is not None:
        text += data
    told = [(found[2].decode(), json.loads(found[3])) for found in MESSAGE.finditer(text)]
    assert [
        (data["sequence"], data["count"]) if kind == "sample" else data["why"]
        for kind, data in told
    ] == [(2, 1), (3, 2), "s1 ended", (5, 1), (6, 2), "again"]
