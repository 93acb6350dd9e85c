"""Results of shared requests whose streams have no readers (engine/units/sharing)."""

import numpy as np
import pytest
from feeding import feed, samples

from dyknow.engine.units.sharing import result_log, shared_query
from dyknow.engine.units.sharing.result_log import ResultLog
from dyknow.engine.units.sharing.shared_query import TemplateUnit
from dyknow.streams.sample import Column, FieldType, SampleBatch

SPEEDS = "stream speeds contains speed(UAV) = v for every UAV = id"


@pytest.fixture
def views(engine, high_speed):
    engine.annotate(SPEEDS)
    engine.register_template(high_speed)
    texts = [f"dyknow:HighSpeedEvent(?o, dyknow:UAV, {limit})" for limit in (100, 110, 120)]
    return [engine.request_event(engine.parse_request(text)) for text in texts]


class Listener:
    def __init__(self):
        self.batches = []

    def receive(self, source, batch):
        self.batches.append(len(batch))

    def ended(self, source):
        self.batches.append("end")


def fly(engine, start, end, *, at_once=False):
    """A sample a second of three; published second by second unless ``at_once``."""
    rows = [
        (second + 0.1 * (i + 1), {"id": f"uav{i}", "v": 130.0})
        for second in range(start, end)
        for i in range(3)
    ]
    if at_once:
        feed(engine, "speeds", rows)
    for second in () if at_once else range(start, end):
        feed(engine, "speeds", [row for row in rows if int(row[0]) == second])


def unit_of(engine, view):
    return engine._parts.configuration.units[view.stream]


def shared_unit(engine):
    (unit,) = (one for one in engine.units() if isinstance(one, TemplateUnit))
    return unit


def test_a_stream_without_readers_gets_its_samples_when_it_is_looked_at(engine, views):
    generator = engine.generator(views[1].stream)
    fly(engine, 0, 10)
    assert generator._counters.used == 0
    assert generator.counters.used == 27
    fly(engine, 10, 11)
    assert generator._stream.last_number == 27
    assert generator.stream.last_number == 30
    fly(engine, 11, 12)
    assert generator.watermark == 11 * 10**9 + 1


def test_samples_wait_for_so_many_windows_only(engine, views):
    generator = engine.generator(views[1].stream)
    fly(engine, 0, result_log._BATCHES + 1)
    assert generator._counters.used == 3 * result_log._BATCHES


def test_a_stream_with_a_reader_gets_them_at_once(engine, views):
    listener, generator = Listener(), engine.generator(views[1].stream)
    fly(engine, 0, 5)
    generator.listen(listener)
    fly(engine, 5, 7)
    assert listener.batches == [3, 3]
    generator.leave(listener)
    fly(engine, 7, 9)
    assert listener.batches == [3, 3]
    assert generator.counters.used == 24


def test_what_waits_comes_before_the_end(engine, views):
    fly(engine, 0, 5)
    listener, generator = Listener(), engine.generator(views[2].stream)
    engine.end("speeds")
    generator.listen(listener)
    assert generator.is_ended
    assert generator.counters.used == samples_of(engine, views[0])


def samples_of(engine, view):
    return len(samples(engine, view.stream))


def test_windows_that_are_due_at_once_give_the_same_samples(engine, views, monkeypatch):
    passes = []
    evaluator = shared_unit(engine).evaluator
    close_many = evaluator._close_many
    monkeypatch.setattr(evaluator, "_close_many", lambda ends: passes.append(1) or close_many(ends))
    fly(engine, 0, 60, at_once=True)
    assert passes
    assert samples(engine, views[1].stream) == samples(engine, views[0].stream)
    tallies = samples(engine, shared_unit(engine).output.name)
    assert tallies == [(i, {"instances": 2, "answered": 2}) for i in range(1, 60)]


def test_a_request_that_goes_has_what_it_was_told(engine, views):
    fly(engine, 0, 5)
    generator = engine.generator(views[1].stream)
    engine.cancel_event(views[1].id)
    assert generator.counters.used == 12


def test_texts_of_objects_that_are_gone_are_forgotten(engine, views, monkeypatch):
    monkeypatch.setattr(shared_query, "_TEXTS", 10)
    listener = Listener()
    engine.generator(views[1].stream).listen(listener)
    engine.generator(views[2].stream).listen(listener)
    for second in range(50):
        feed(engine, "speeds", [(second + 0.5, {"id": f"new{second}", "v": 130.0})])
    assert len(shared_unit(engine)._pools["id"]) < 25
    assert samples(engine, views[1].stream) == samples(engine, views[0].stream)


def test_a_log_cuts_samples_by_instance():
    def batch(*values):
        times = np.arange(len(values), dtype=np.int64)
        return SampleBatch(times, times, {"v": Column(FieldType.INTEGER, np.array(values))})

    log = ResultLog()
    assert not log
    assert log.take() == ()
    log.add(np.array([1, 1, 7]), batch(10, 11, 70))
    log.add(np.array([1, 3]), batch(12, 30))
    found = [(number, part.columns["v"].tolist()) for number, part in log.take()]
    assert found == [(1, [10, 11, 12]), (3, [30]), (7, [70])]
    assert not log
