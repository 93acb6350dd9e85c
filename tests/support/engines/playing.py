"""Telling an engine a world of recorded sources, in any order or in that of time."""

from hypothesis import strategies as st

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.streams.sample import batch_from_rows


def _publish(engine, name, samples):
    generator = engine.generator(name)
    batch = batch_from_rows(generator.schema, samples, generator.stream.pools)
    engine.publish(name, Incoming(batch, stamped=False), 0)


def play(draw, processes, sources, network, rows):
    """The world told in some order and some cuts, the KPL of ``network`` declared at some moment;
    ``rows``: what each source says, as (available, valid, values)."""
    engine = Engine(processes=processes)
    engine.add_kpl(sources)
    left = {name: list(samples) for name, samples in rows.items()}
    running, steps = list(left), [network]
    while running or steps:
        name = draw(st.sampled_from(running + ["network"] * len(steps)))
        if name == "network":
            engine.add_kpl(steps.pop())
            continue
        samples = left[name]
        if not samples:
            engine.end(name)
            running.remove(name)
            continue
        cut = draw(st.integers(1, len(samples)))
        _publish(engine, name, samples[:cut])
        del samples[:cut]
    assert [view for view in engine.kpl() if view.failure] == []
    return engine


def play_in_order(draw, processes, sources, network, rows):
    """The network declared first, then the world told in order of available time."""
    engine = Engine(processes=processes)
    engine.add_kpl(sources + network)
    said = [(name, sample) for name, samples in rows.items() for sample in samples]
    for name, sample in sorted(draw(st.permutations(said)), key=lambda told: told[1][0]):
        _publish(engine, name, [sample])
    for name in draw(st.permutations(sorted(rows))):
        engine.end(name)
    assert [view for view in engine.kpl() if view.failure] == []
    return engine
