"""Adaptive subscriptions and the mirror: what a loss costs, and what it costs to know everything.

Run by ``python bench/matching/adaptive.py``. *Recovery*: 1,000 subscriptions to the speed of one
object, with two streams each; a stream ends, and the time is that of the call in which its
subscription is matched again and reads the other one, the samples that this keeps passed on.
*Mirror*: 10,000 streams; what a second of publishing and ticking costs with subscribers mirrored
and without, and what it costs to bring rates and subscribers up to date for somebody who asks.
"""

from __future__ import annotations

import statistics
import time

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.streams.sample import Field, FieldType, batch_from_rows
from dyknow.streams.time import SECOND

SUBSCRIPTIONS = 1_000
STREAMS = 10_000
FIELDS = (Field("spd", FieldType.FLOAT),)


def publish(engine: Engine, stream: str, now: int, count: int = 1) -> None:
    """``count`` samples that are stamped at ``now``."""
    generator = engine.generator(stream)
    rows = [(now, now, {"spd": 1.0})] * count
    engine.publish(
        stream, Incoming(batch_from_rows(generator.schema, rows, generator.stream.pools), True), now
    )


def recovery() -> None:
    """One, ten and a hundred of the streams that subscriptions read end."""
    engine = Engine()
    for i in range(SUBSCRIPTIONS):
        for kind in "ab":
            name = f"s{i}{kind}"
            engine.declare(StreamDeclaration(name, FIELDS))
            engine.annotate(f"stream {name} contains speed(car{i}) = spd [m.s-1]")
    for i in range(SUBSCRIPTIONS):
        engine.subscribe_to_feature("speed", objects=[f"car{i}"])
    for i in range(SUBSCRIPTIONS):
        publish(engine, f"s{i}a", SECOND, 10)
        publish(engine, f"s{i}b", 2 * SECOND, 10)
    print(f"recovery, of {SUBSCRIPTIONS:,} subscriptions, a loss each")
    times = []
    for i in range(100):
        begin = time.perf_counter()
        engine.end(f"s{i}a")
        times.append((time.perf_counter() - begin) * 1e3)
        assert engine.rematches(f"subscription{i + 1}")[-1].after == (f"s{i}b",)
    print(f"{'one stream ends':<40} {statistics.median(times):>8.2f} ms, worst {max(times):.2f}")
    engine.tick(3 * SECOND)
    begin = time.perf_counter()
    for i in range(100, 200):
        engine.end(f"s{i}a")
    print(f"{'a hundred streams end, together':<40} {(time.perf_counter() - begin) * 1e3:>8.2f} ms")


def mirror() -> None:
    """The work of a second at 10,000 streams of which a thousand get a batch."""
    engine = Engine()
    for i in range(STREAMS):
        engine.declare(StreamDeclaration(f"s{i}", FIELDS))
    now = SECOND

    def second() -> float:
        nonlocal now
        begin = time.perf_counter()
        for step in range(10):
            now += SECOND // 10
            for i in range(100):
                publish(engine, f"s{100 * step + i}", now, 100)
            engine.tick(now)
        return (time.perf_counter() - begin) * 1e3

    second()
    own = engine._parts.manager.count_subscribers
    with_it, without = [], []
    for _ in range(5):
        engine._parts.manager.count_subscribers = own
        with_it.append(second())
        engine._parts.manager.count_subscribers = lambda counts: None
        without.append(second())
    engine._parts.manager.count_subscribers = own
    ratio = statistics.median(with_it) / statistics.median(without) - 1
    print(f"mirror, {STREAMS:,} streams, 1,000 batches of 100 samples a second")
    print(f"{'a second of work':<40} {statistics.median(with_it):>8.1f} ms")
    print(
        f"{'the same without the mirror':<40} {statistics.median(without):>8.1f} ms ({ratio:+.1%})"
    )
    begin = time.perf_counter()
    engine.measure()
    print(
        f"{'rates and subscribers for who asks':<40} {(time.perf_counter() - begin) * 1e3:>8.1f} ms"
    )
    now += 2 * SECOND
    engine.tick(now)
    begin = time.perf_counter()
    engine.measure()
    print(
        f"{'the same where little has changed':<40} {(time.perf_counter() - begin) * 1e3:>8.1f} ms"
    )


if __name__ == "__main__":
    recovery()
    print()
    mirror()
