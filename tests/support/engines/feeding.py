"""Short ways to feed an engine and to read what it made."""

import numpy as np

from dyknow.converters.wire import Incoming
from dyknow.streams.sample import batch_from_rows
from dyknow.streams.time import SECOND


def feed(engine, stream, rows, now=None):
    """Publish ``(seconds, values)`` rows with their own available times, or stamped at ``now``."""
    generator = engine.generator(stream)
    timed = [(int(s * SECOND), int(s * SECOND), values) for s, values in rows]
    batch = batch_from_rows(generator.schema, timed, generator.stream.pools)
    return engine.publish(stream, Incoming(batch, now is not None), now or 0)


def samples(engine, stream):
    """All kept samples of a stream as ``(valid in seconds, values)``."""
    return [
        (valid / SECOND, values)
        for _, valid, values in engine.generator(stream).stream.all().rows()
    ]


def flight(start, seconds, speed, latitude=58.0, longitude=15.0):
    """Positions of a steady flight north at ``speed`` km/h, one a second."""
    metres = speed / 3.6
    degrees = np.degrees(metres / 6_371_008.8)
    return [(start + i, latitude + i * degrees, longitude) for i in range(seconds)]


class Reader:
    """A reader of a stream that writes down what it hears."""

    knows_codes = False

    def __init__(self):
        self.heard = []

    def receive(self, source, batch):
        self.heard.append(("samples", len(batch)))

    def advance(self, source, watermark):
        self.heard.append(("time", watermark))

    def ended(self, source):
        self.heard.append(("ended", source.name))

    def resumed(self, source):
        self.heard.append(("resumed", source.name))
