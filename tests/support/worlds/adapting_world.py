"""A small world for tests of adaptive subscriptions: streams of speeds, and what a client gets.

Times are seconds, values km/h unless a stream says otherwise.
"""

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.engine.processes.registry import Processes
from dyknow.streams.sample import Field, FieldType, batch_from_rows
from dyknow.streams.time import SECOND

FIELDS = (
    Field("id", FieldType.STRING),
    Field("spd", FieldType.FLOAT),
    Field("other", FieldType.FLOAT),
)
OF_ALL = "stream {} contains speed(UAV) = spd [km.h-1] for every UAV = id"
OF_UAV1 = "stream {} contains speed(uav1) = spd [km.h-1]"


def ns(seconds):
    """Seconds as the engine has them."""
    return round(seconds * SECOND)


class World:
    """An engine and its clock."""

    def __init__(self, processes=None, **options):
        self.engine = Engine(epoch="test", processes=processes or Processes(), **options)

    def declare(self, *names, meaning=None, fields=FIELDS, **options):
        """Streams of the usual fields; ``meaning`` is SSL with ``{}`` for the name."""
        for name in names:
            self.engine.declare(StreamDeclaration(name, fields, **options))
            if meaning is not None:
                self.engine.annotate(meaning.format(name))

    def say(self, name, time, value=None, id="uav1", *, own=None, field="spd"):
        """A sample comes at ``time``; with ``own`` it brings that as its available time."""
        self.say_all(name, time, [(id, time if value is None else value)], own=own, field=field)

    def say_all(self, name, time, said, *, own=None, field="spd"):
        """A batch of ``(id, value)`` comes at ``time``."""
        generator = self.engine.generator(name)
        at = ns(time if own is None else own)
        silent = dict.fromkeys(generator.schema.names)
        rows = [
            (at + k, at + k, silent | {"id": id, field: value})
            for k, (id, value) in enumerate(said)
        ]
        batch = batch_from_rows(generator.schema, rows, generator.stream.pools)
        self.engine.publish(name, Incoming(batch, own is None), ns(time))

    def tick(self, time):
        self.engine.tick(ns(time))

    def run(self, begin, end, step, *names):
        """From ``begin`` until before ``end`` each of ``names`` speaks every ``step``; the clock
        goes on whether anybody speaks or not."""
        for k in range(round((end - begin) / step)):
            time = begin + k * step
            self.tick(time)
            for name in names:
                self.say(name, time)

    def subscribe(self, feature="speed", **options):
        """Its id, to a feature of every UAV unless something else is said."""
        if "objects" not in options:
            options.setdefault("sort", "UAV")
        for name in ("hold_off", "staleness"):
            if options.get(name) is not None:
                options[name] = ns(options[name])
        return self.engine.subscribe_to_feature(feature, **options).id

    def view(self, id):
        return self.engine.subscription(id).adaptive

    def state(self, id):
        return self.view(id).state

    def reads(self, id):
        return self.view(id).reads

    def received(self, id):
        """What the client got, as (valid time, object, value)."""
        stream = self.engine.generator(self.engine.subscription(id).stream).stream
        return [(valid / SECOND, *values.values()) for _, valid, values in stream.all().rows()]

    def values(self, id):
        return [row[-1] for row in self.received(id)]

    def switches(self, id):
        """Each switch as (when, why, before, after)."""
        return [(r.time / SECOND, r.why, r.before, r.after) for r in self.engine.rematches(id)]

    def path(self, id):
        """What was read one after another."""
        return [" ".join(after) for _, _, _, after in self.switches(id)]

    def status(self, change=None):
        """What the status stream told, of one kind of change or of all, as dictionaries."""
        told = [values for _, _, values in self.engine.generator("status").stream.all().rows()]
        return [values for values in told if change is None or values["change"] == change]

    def ask(self, pattern):
        """What the ontology's mirror says: the local names of ``?x`` in ``pattern``."""
        query = f"PREFIX : <http://www.dyknow.eu/ontology#> SELECT ?x WHERE {{ {pattern} }}"
        _, rows = self.engine.ontology.query_rows(query)
        return sorted(row[0].value.split("#")[-1] for row in rows)

    def mirrored(self, id):
        """What the subscription's merge reads, by the mirror."""
        return self.ask(f":{self.engine.subscription(id).source} ^:hasOutput/:hasInput ?x")

    def everything(self):
        """All that there is: streams, units, triples of the mirror."""
        parts = self.engine._parts.configuration
        return set(parts.streams), set(parts.units), self.engine._parts.manager.assertions()
