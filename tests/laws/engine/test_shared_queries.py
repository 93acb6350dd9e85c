"""Law: registered queries that differ in constants and share one query are told, and keep, what
each would alone, from the first window on that begins after the registration."""

import re
from collections import Counter

import pytest
from feeding import feed, samples
from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow.engine.engine import Engine
from dyknow.engine.model.views import Since
from dyknow.engine.planning import query_sharing
from dyknow.languages.errors import LanguageError

RANGE = 3
S, T = (f"<http://www.ida.liu.se/dyknow/{name}.trdf>" for name in "st")
WINDOW = f"[RANGE {RANGE}s STEP 1s]"
BODIES = [
    f"""STREAM @name AS CONSTRUCT {{ ?o dyknow:speed ?a }} FROM STREAM {S} {WINDOW}
    WHERE {{ ?o a @kind . ?o dyknow:speed ?s }}
    AGGREGATE {{ (?a, AVG, {{?s}}) FILTER (?a > @limit) }}""",
    f"""STREAM @name AS CONSTRUCT {{ @one dyknow:speed ?s . ?o dyknow:heading @limit }}
    FROM STREAM {S} {WINDOW} WHERE {{ ?o dyknow:speed ?s FILTER (?s >= @limit) }}""",
    f"""QUERY @name AS SELECT ?o (COUNT(*) AS ?n) (MAX(?s) AS ?m) FROM STREAM {S} {WINDOW}
    WHERE {{ ?o dyknow:speed ?s }} GROUP BY ?o HAVING (COUNT(*) > @limit)""",
    f"""QUERY @name AS SELECT ?s ?h (?s > @other AS ?fast) FROM STREAM {S} [RANGE 2s STEP 2s]
    WHERE {{ @one dyknow:speed ?s ; dyknow:heading ?h . FILTER (?h < @limit) }}""",
    f"""QUERY @name AS SELECT ?o ?t FROM STREAM {S} {WINDOW} FROM STREAM {T} [RANGE 2s STEP 1s]
    WHERE {{ ?o dyknow:speed ?s . ?x dyknow:altitude ?t FILTER (?s > @limit && ?t != ?s) }}""",
    f"""RSTREAM @name AS SELECT ?s (COUNT(*) AS ?n)
    FROM NAMED WINDOW dyknow:w ON {S} [RANGE PT3S STEP PT1S]
    WHERE {{ WINDOW dyknow:w {{ @one dyknow:speed ?s }} }} GROUP BY ?s""",
    f"""QUERY @name AS ASK FROM STREAM {S} {WINDOW}
    WHERE {{ @one dyknow:speed ?s . FILTER (?s > @limit) }}""",
    f"""QUERY @name AS SELECT ?o ?s ?h FROM STREAM {S} {WINDOW} WHERE {{ ?o dyknow:speed ?s
    OPTIONAL {{ ?o dyknow:heading ?h FILTER (?h > @limit) }} }}""",
    f"""QUERY @name AS SELECT ?o ?s WHERE {{ ?o dyknow:speed ?s FILTER (?s > @limit) }}
    WINDOW {WINDOW}""",
    f"""QUERY @name AS SELECT ?s WHERE {{ @one dyknow:speed ?s FILTER (?s > @limit) }}
    WINDOW {WINDOW}""",
    # Alone: the operator, a window that counts, an order, Oxigraph's.
    f"""ISTREAM @name AS SELECT ?o ?s FROM NAMED WINDOW dyknow:w ON {S} [RANGE PT3S STEP PT1S]
    WHERE {{ WINDOW dyknow:w {{ ?o dyknow:speed ?s FILTER (?s > @limit) }} }}""",
    f"""QUERY @name AS SELECT ?o ?s FROM STREAM {S} {WINDOW}
    WHERE {{ ?o dyknow:speed ?s FILTER (?s > @limit) }} ORDER BY ?s ?o""",
]
SHARED = len(BODIES) - 2
OBJECTS = ["uav1", "uav2", "uav3"]
constants = st.fixed_dictionaries(
    {
        "kind": st.sampled_from(["dyknow:UAV", "dyknow:UAV", "dyknow:RMAX"]),
        "one": st.sampled_from([f"dyknow:{name}" for name in OBJECTS]),
        "limit": st.sampled_from(["0", "1", "1.0", "2.5", "4", "'4'"]),
        "other": st.sampled_from(["2", "3e0"]),
    }
)
manners = st.one_of(
    st.just({}),
    st.just({}),
    st.fixed_dictionaries(
        {},
        optional={
            "semantics": st.sampled_from(["bag", "set"]),
            "bounds": st.sampled_from(["(]", "[)"]),
            "origin": st.sampled_from([0, 250_000_000]),
            "report": st.sampled_from(["non-empty", "close", "change"]),
            "since": st.sampled_from([Since.NOW, Since.START]),
        },
    ),
)
queries = st.tuples(st.sampled_from(BODIES), constants, manners)
rows = st.lists(
    st.tuples(
        st.floats(0.01, 1.2).map(lambda x: round(x, 2)),
        st.sampled_from(OBJECTS),
        st.integers(0, 5).map(float),
        st.one_of(st.none(), st.integers(0, 5).map(float)),
    ),
    min_size=1,
    max_size=6,
)
steps = st.lists(
    st.one_of(rows, rows, queries, queries, queries, st.integers(0, 8), st.just("end")),
    min_size=4,
    max_size=16,
)
ANNOTATIONS = (
    "stream s contains speed(UAV) = v, heading(UAV) = h for every UAV = id\n"
    "stream t contains altitude(UAV) = a for every UAV = id"
)


class Run:
    """What an engine tells of queries that come and go."""

    def __init__(self, least):
        self.least = least
        self.engine = Engine(epoch="law")
        self.engine.annotate(ANNOTATIONS)
        self.now = 0.0
        self.running = {}
        self.told = {}
        self.shared = 0

    def step(self, number, step):
        match step:
            case tuple():
                body, given, manner = step
                name = f"q{number}"
                try:
                    self.engine.queries.register(text_of(body, given, name), **manner)
                except LanguageError as error:
                    # A head that gives a text where a number is due.
                    self.told[number] = error.message
                    return
                self.running[number] = (name, self.now, manner)
            case "end":
                for stream in "st":
                    self.engine.end(stream)
                for number, (name, since, manner) in self.running.items():
                    if self.now - since < RANGE:
                        # How far its windows have closed depends on when it began.
                        self.running[number] = (name, self.now + RANGE, manner)
            case int():
                if step in self.running:
                    self.remove(step)
            case _:
                self.publish(step)

    def publish(self, given):
        both, altitudes = [], []
        for wait, name, speed, heading in given:
            self.now = round(self.now + wait, 2)
            both.append((self.now, {"id": name, "v": speed, "h": heading}))
            altitudes.append((self.now, {"id": name, "a": heading}))
        feed(self.engine, "s", both)
        feed(self.engine, "t", altitudes)

    def remove(self, number):
        name, since, manner = self.running.pop(number)
        queries = self.engine.queries
        assert name in queries.explain_running(name)
        assert queries.explain_running(name) == self.engine.explain_running(name)
        view = queries.view(name)
        self.shared += view.plan.units[-1].transformation == "selectInstance"
        begins = since + (0.001 if manner.get("bounds") == "[)" else 0.0)
        kept = [
            (result.start, result.end, shown(result))
            for result in queries.results(name)
            if result.start >= begins * 1e9
        ]
        told = [
            (valid, sorted(values.items(), key=str))
            for valid, values in samples(self.engine, view.stream)
            if valid - RANGE >= begins
        ]
        # What is made for a query is numbered, and so is what is shared.
        reads = [re.sub(r"reserved\d+", "made", stream) for stream in view.reads]
        state = view.state, view.failure, view.fields, reads, view.users, view.watermark
        self.told[number] = state, view.waits_for, view.held_back_by, told, kept
        queries.remove(name)

    def finish(self):
        # Two windows close that are complete.
        self.publish([(1.0, "uav1", 3.0, 3.0)] * (RANGE + 2))
        for number in [*self.running]:
            self.remove(number)
        assert not self.engine._parts.configuration.units
        assert not self.engine.queries._starter._sharing._by_key


def text_of(body, given, name):
    for key, term in {**given, "name": name}.items():
        body = body.replace(f"@{key}", term)
    return f"REGISTER {body}"


def shown(result):
    """A result without the order of its rows."""
    if result.solutions is not None:
        return Counter(tuple(sorted(row.items(), key=str)) for row in result.solutions.rows())
    if result.triples is not None:
        return Counter((s, p, o) for _, s, p, o in result.triples)
    return result.answer


def run(given, least):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(query_sharing, "MIN_SHARED", least)
        # However large what is computed together is.
        patch.setattr("dyknow.engine.planning.query_units.break_even_count", lambda *_: 1)
        run = Run(least)
        for number, step in enumerate(given):
            run.step(number, step)
        run.finish()
        return run


@settings(deadline=None, max_examples=60)
@given(steps, st.sampled_from([1, 2]))
def test_sharing_changes_nothing(given, least):
    assert run(given, least).told == run(given, 10**9).told


SOME = {"kind": "dyknow:UAV", "one": "dyknow:uav1", "limit": "1", "other": "2"}


@pytest.mark.parametrize("body", BODIES[:SHARED])
def test_queries_are_shared_in_the_law(body):
    others = {"limit": "2"} if "@limit" in body else {"one": "dyknow:uav2"}
    given = [(body, SOME, {}), (body, SOME | others, {}), [(1.0, "uav1", 3.0, 3.0)] * 5]
    assert run(given, 1).shared == 2


@pytest.mark.parametrize("body", BODIES[SHARED:])
def test_others_stay_alone(body):
    assert run([(body, SOME, {}), (body, SOME | {"limit": "2"}, {})], 1).shared == 0
