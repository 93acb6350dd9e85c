"""Streams, units and what is told of them, for tests of user-written processes."""

from dyknow.engine.model.views import Since
from dyknow.engine.processes.registry import Processes
from dyknow.engine.processes.supervision import DIRECT
from dyknow.engine.units.join import FunctionProcess
from dyknow.streams.generator import StreamGenerator
from dyknow.streams.sample import Field, FieldType, Schema, batch_from_rows
from dyknow.streams.string_pool import StringPool

OPEN = Schema(())


def stream(name="pos", lateness=0, **fields):
    """A generator; fields by type name, for example ``value="float"``."""
    schema = Schema(tuple(Field(key, FieldType(kind)) for key, kind in fields.items()))
    pools = {key: StringPool() for key, kind in fields.items() if kind == "string"}
    return StreamGenerator(name, schema, lateness=lateness, pools=pools)


def offer(generator, *rows):
    """Offer ``(available, valid, values...)`` rows as one batch."""
    names = generator.schema.names
    timed = [(a, v, dict(zip(names, values, strict=True))) for a, v, *values in rows]
    generator.offer(batch_from_rows(generator.schema, timed, generator.stream.pools))


def content(generator):
    """All kept samples as ``(available, valid, values...)``."""
    return [(a, v, *values.values()) for a, v, values in generator.stream.all().rows()]


class Events(list):
    """Hears what is told: ``(kind, text)`` of each event."""

    def __call__(self, process, event, text):
        self.append((str(event), text))

    @property
    def kinds(self):
        return [kind for kind, _ in self]


def unit(
    code, inputs, output=None, events=None, runner=DIRECT, batch=False, since=Since.NOW, **rule
):
    """A unit at work over ``inputs``, with an open output unless one is given."""
    registry = Processes()
    sorts = [f"sort{i}" for i in range(len(inputs))]
    registry.computational_unit("out", sorts, name="unit", batch=batch, **rule)(code)
    made = FunctionProcess(
        "cu1",
        "unit",
        inputs,
        stream("out") if output is None else output,
        {},
        _system_failure,
        implementation=registry.unit("unit"),
        on_event=Events() if events is None else events,
        runner=runner,
    )
    made.start(since)
    return made


def _system_failure(broken):
    raise AssertionError(f"the system failed, not the user's code: {broken.failure}")
