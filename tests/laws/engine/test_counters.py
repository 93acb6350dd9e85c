"""Each accepted sample is in exactly one counter, of every stream, always: as the engine tells it
and as Prometheus reads it (P5)."""

from __future__ import annotations

import asyncio
from collections import Counter, defaultdict

from hypothesis import given, settings
from hypothesis import strategies as st
from prometheus_client.parser import text_string_to_metric_families

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import DyknowError
from dyknow.engine.model.views import StreamDeclaration
from dyknow.service.runtime.stream_metrics import StreamMetrics
from dyknow.streams.history import Retention
from dyknow.streams.sample import Field, FieldType, Schema, batch_from_rows
from dyknow.streams.time import SECOND

SCHEMA = Schema((Field("id", FieldType.STRING), Field("spd", FieldType.FLOAT)))
QUERY = """REGISTER STREAM speeds COMPUTE EVERY 1s AS
CONSTRUCT { ?o dyknow:speed ?mean }
FROM STREAM <http://www.ida.liu.se/dyknow/s5.trdf> [RANGE 3s STEP 1s]
WHERE { ?o a dyknow:UAV . ?o dyknow:speed ?v . }
AGGREGATE {(?mean, AVG, {?v}) FILTER (?mean > 0)}"""
KPL = """source float raw
strmgen kept[a] = raw
stream slow = kept[a] with sample every 1000, max delay 2000
stream ordered = kept[a] with monotone order, max delay 500"""
SOURCES = {"s5": SCHEMA, "raw": Schema((Field("value", FieldType.FLOAT),))}

moments = st.integers(0, 30)
steps = st.lists(
    st.tuples(st.just("publish"), st.sampled_from(list(SOURCES)), st.lists(moments, max_size=8))
    | st.tuples(st.just("stamped"), st.just("free"), st.lists(moments, max_size=4))
    | st.tuples(st.just("tick"), moments, st.none())
    | st.tuples(st.just("end"), st.sampled_from([*SOURCES, "free"]), st.none())
    | st.tuples(st.just("late"), st.sampled_from(["s5_late", "speeds_late_s5"]), st.none())
    | st.tuples(st.just("remove"), st.just("free"), st.none()),
    max_size=14,
)


def fates(engine: Engine) -> dict[str, Counter[str]]:
    """By stream, as Prometheus reads it."""
    text = asyncio.run(StreamMetrics(engine, 1000).text(0)).decode()
    found: dict[str, Counter[str]] = defaultdict(Counter)
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            if sample.name == "dyknow_samples_total":
                found[sample.labels["stream"]][sample.labels["fate"]] = int(sample.value)
            if sample.name == "dyknow_samples_pending":
                found[sample.labels["stream"]]["pending"] = int(sample.value)
    return found


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 4), steps)
def test_accepted_is_the_sum_of_all_fates(lateness: int, steps: list) -> None:
    engine = Engine(epoch="e1")
    engine.declare(StreamDeclaration("s5", SCHEMA.fields, lateness * SECOND, Retention(10)))
    engine.declare(StreamDeclaration("free", SOURCES["raw"].fields, 0, Retention(3)))
    engine.annotate("stream s5 contains speed(UAV) = spd for every UAV = id")
    engine.queries.register(QUERY)
    engine.add_kpl(KPL)
    offered: Counter[str] = Counter()
    views = {view.name: view for view in engine.streams()}
    for kind, which, times in steps:
        try:
            match kind:
                case "publish" | "stamped":
                    schema = SOURCES.get(which, SOURCES["raw"])
                    value = {"id": "a", "spd": 1.0} if which == "s5" else {"value": 1.0}
                    rows = [(time * SECOND, time * SECOND, value) for time in times]
                    pools = engine.accepting(which).stream.pools
                    batch = batch_from_rows(schema, rows, pools)
                    engine.publish(which, Incoming(batch, kind == "stamped"), 31 * SECOND)
                    offered[which] += len(times)
                case "tick":
                    engine.tick(which * SECOND)
                case "end":
                    engine.end(which)
                case "late":
                    engine.stream(which)
                case "remove":
                    engine.remove_stream("free")
                    engine.declare(StreamDeclaration("free", SOURCES["raw"].fields))
                    offered["free"] = 0
        except DyknowError:
            continue  # refused, and so without effect
        read = fates(engine)
        views = {view.name: view for view in engine.streams()}
        assert read.keys() == views.keys()
        for name, view in views.items():
            told, counters = read[name], view.counters
            assert told.pop("accepted") == counters.accepted == told.total()
            if name != "free":  # which goes on counting when it is declared anew
                assert told["used"] == view.last_number
        for name, count in offered.items():
            assert views[name].counters.accepted == count
    assert {"speeds", "slow", "ordered", "status"} <= views.keys()
