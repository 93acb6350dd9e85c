"""Patterns with `max delay`: the clock decides what did not happen."""

import pytest
from feeding import feed, samples

import dyknow
from dyknow.languages.errors import LanguageError
from dyknow.streams.time import SECOND

SSL = """stream speeds contains speed(UAV) = spd [km.h-1] for every UAV = id
stream heights contains altitude(UAV) = alt [ft] for every UAV = id"""
EP = "PREFIX dyknow: <http://www.ida.liu.se/dyknow/> "
CHRONICLE = (
    "chronicle {name}(?x) {{ event(speed[?x], t); noevent(altitude[?x], (t, t + 3s)); }} {delay}"
)
SASE = (
    "REGISTER STREAM {name} AS PATTERN SEQ(speed a, ~altitude b) WHERE {strategy} [id] "
    "WITHIN 3s RETURN a.id AS x {delay}"
)
OPTIONAL = (
    f"REGISTER STREAM {{name}} AS {EP} SELECT ?x ?w WHERE {{{{ ?x dyknow:speed ?v }}}} "
    "EQUALSOPTIONAL {{ ?x dyknow:altitude ?w }} WITHIN 3s {delay}"
)
# The text, and the last time (s after the sample) at which something may still come.
TEXTS = {
    "chronicle": (CHRONICLE, 3 - 1e-9),
    "any": (SASE.replace("{strategy}", ""), 3),
    "next": (SASE.replace("{strategy}", "skip_till_next_match"), 3),
    "optional": (OPTIONAL, 0),
}


@pytest.fixture
def flying(engine):
    engine.annotate(SSL)
    return engine


def publish(engine, stream, valid, now, **values):
    feed(engine, stream, [(valid, {"id": "uav1", **values})], now=int(now * SECOND))


def told(engine, name):
    return [(valid, values["x"]) for valid, values in samples(engine, name)]


@pytest.mark.parametrize("case", TEXTS)
def test_the_clock_decides_what_did_not_happen(flying, case):
    """No sample comes after the first second; without `max delay` nothing is decided."""
    text, wait = TEXTS[case]
    flying.queries.register(text.format(name="waits", delay=""))
    flying.queries.register(text.format(name="decides", delay="with max delay 2s"))
    publish(flying, "speeds", 1, 1.5, spd=5.0)
    publish(flying, "heights", 0.5, 1.5, alt=5.0)
    due = 1 + wait + 2
    flying.tick(int(due * SECOND))
    assert told(flying, "decides") == told(flying, "waits") == []
    flying.tick(int(due * SECOND) + 1)
    assert told(flying, "decides") == [(1, "uav1")]
    assert told(flying, "waits") == []
    (available,) = flying.generator("decides").stream.all().available
    assert available == due * SECOND
    for name in ("speeds", "heights"):
        flying.end(name)
    assert told(flying, "waits") == told(flying, "decides")


@pytest.mark.parametrize("case", TEXTS)
def test_a_sample_within_the_delay_counts(flying, case):
    text, _ = TEXTS[case]
    flying.queries.register(text.format(name="p", delay="with max delay 2s"))
    publish(flying, "speeds", 1, 1.5, spd=5.0)
    flying.tick(int(2.9 * SECOND))
    publish(flying, "heights", 1 if case == "optional" else 1.2, 3, alt=5.0)
    flying.tick(9 * SECOND)
    found = [] if case != "optional" else [(1.0, "uav1")]
    assert told(flying, "p") == found
    assert all(values.get("w", 5.0) == 5.0 for _, values in samples(flying, "p"))
    # Nothing waits for this one any more.
    publish(flying, "heights", 5, 10, alt=5.0)
    flying.tick(11 * SECOND)
    assert flying.queries.view("p").late == 1


def test_any_order_of_arrival_within_the_delay(flying):
    """Without it a sample behind a later one of its stream is late."""
    for name, delay in (("a", ""), ("b", "with max delay 4s")):
        flying.queries.register(
            f"chronicle {name}(?x) {{ event(speed[?x]:(?, > 3), t1); event(speed[?x]:(> 3, < 3), "
            f"t2); t2 - t1 in [0s, 9s]; }} {delay}"
        )
    for valid, now, speed in ((1, 1, 5.0), (3, 3, 2.0), (2, 4, 6.0)):
        publish(flying, "speeds", valid, now, spd=speed)
    flying.end("speeds")
    assert [len(told(flying, name)) for name in "ab"] == [1, 2]
    assert [flying.queries.view(name).late for name in "ab"] == [1, 0]
    assert "in order of valid time, at most 4s after it" in flying.queries.explain_running("b")


def test_recordings_are_read_by_available_time():
    rows = [
        {"valid": t * SECOND, "available": a * SECOND, "id": "uav1", "spd": v}
        for t, a, v in ((1, 1, 5.0), (2, 9, 6.0), (4, 4, 7.0))
    ]
    text = "PATTERN SEQ(speed a, speed b) WHERE skip_till_next_match [id] WITHIN 9s"
    found = {
        delay: [(r["start"] // SECOND, r["end"] // SECOND, r["available"] // SECOND)
                for r in dyknow.run(text + delay, streams={"speeds": rows}, ssl=SSL)]
        for delay in ("", " WITH MAX DELAY 1s", " WITH MAX DELAY 7s")
    }  # fmt: skip
    assert found == {
        "": [(1, 2, 2), (2, 4, 4)],
        " WITH MAX DELAY 1s": [(1, 4, 5)],
        " WITH MAX DELAY 7s": [(1, 2, 9), (2, 4, 9)],
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (CHRONICLE.format(name="c", delay="with max delay"), "unit, such as|ends too early"),
        (CHRONICLE.format(name="c", delay="with max 3s"), "`3s` is not allowed here"),
        (SASE.format(strategy="", name="c", delay="WITH MAX DELAY 5"), "`5` is not allowed here"),
        (OPTIONAL.format(name="c", delay="WITH DELAY 5s"), "DELAY"),
        (OPTIONAL.format(name="c", delay="WITH MAX DELAY 200 years"), "unit of the delay"),
    ],
)
def test_wrong_delays_are_refused(flying, text, message):
    with pytest.raises(LanguageError, match=message):
        flying.queries.register(text)
