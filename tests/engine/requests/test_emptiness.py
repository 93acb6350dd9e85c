"""A request or query that has given nothing says why (`engine/requests/empty_reasons.py`)."""

import pytest
from feeding import feed

from dyknow.engine.model.views import StreamDeclaration
from dyknow.engine.requests import empty_reasons
from dyknow.languages.csparql import parse_query
from dyknow.streams.sample import Field, FieldType

FIELDS = (Field("id", FieldType.STRING), Field("spd", FieldType.FLOAT))
SSL = "stream s contains speed(UAV) = spd [km.h-1] for every UAV = id"
QUERY = """REGISTER QUERY q AS SELECT ?o ?v FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf>
[RANGE 2s STEP 1s] WHERE {{ {} }}"""
SPEED = "?o dyknow:speed ?v"


@pytest.fixture
def flying(engine):
    engine.declare(StreamDeclaration("s", FIELDS, lateness=0))
    engine.annotate(SSL)
    return engine


def registered(engine, where):
    return engine.queries.register(QUERY.format(where)).name


def fly(engine, speed=10.0, id="uav1", seconds=20):
    feed(engine, "s", [(second, {"id": id, "spd": speed}) for second in range(seconds)])


@pytest.mark.parametrize(
    ("where", "said"),
    [
        ("?o a dyknow:Car ; dyknow:speed ?v", "no member of dyknow:Car seen"),
        ("?o dyknow:altitude ?v", "no stream that it reads is annotated with dyknow:altitude"),
        (
            "?o a dyknow:Uavv ; dyknow:speed ?v",
            "dyknow:Uavv is not a known sort; did you mean dyknow:UAV?",
        ),
        (
            "?o dyknow:speeed ?v",
            "dyknow:speeed is neither a feature nor another known term; did you mean dyknow:speed?",
        ),
        (
            SPEED + " OPTIONAL { ?o dyknow:altitude ?a } FILTER (?a > 1)",
            "no stream that it reads is annotated with dyknow:altitude",
        ),
        (SPEED + " FILTER (?v > 100)", "windows satisfied the query's conditions"),
    ],
)
def test_what_is_lacking(flying, where, said):
    name = registered(flying, where)
    assert flying.queries.view(name).empty.startswith("no sample read yet from s")
    fly(flying)
    told = flying.queries.view(name).empty
    assert told.startswith("20 samples read, 20 triples: ")
    assert told.endswith(said)


def test_no_triples(flying):
    name = registered(flying, SPEED)
    fly(flying, speed=None)
    assert flying.queries.view(name).empty == (
        "20 samples read, 0 triples: no sample had both an annotated object and a value"
    )


def test_no_window_yet(flying):
    name = registered(flying, SPEED)
    fly(flying, seconds=1)
    assert flying.queries.view(name).empty == "1 samples read, 1 triples: no window has closed yet"


def test_nothing_is_said_of_what_has_given_something(flying, high_speed):
    name = registered(flying, SPEED)
    flying.register_template(high_speed)
    id = flying.request_event(flying.parse_request("dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)")).id
    fly(flying)
    assert flying.queries.view(name).empty is None
    assert "windows satisfied" in flying.event(id).empty


def test_what_a_policy_dropped(flying):
    flying.declare(StreamDeclaration("fixes", FIELDS))
    flying.add_kpl("source fix fixes\nstrmgen f = fixes\nstream few = f with sample every 10 s")
    flying.annotate(SSL.replace("stream s ", "stream few "))
    text = QUERY.format(SPEED + " FILTER (?v > 100)").replace("s.trdf", "few.trdf")
    name = flying.queries.register(text).name
    rows = [(second, {"id": "uav1", "spd": 1.0}) for second in range(21)]
    feed(flying, "fixes", rows)
    flying.end("fixes")
    told = flying.queries.view(name).empty
    assert told.startswith("3 samples read, 3 triples: ")
    assert told.endswith("18 dropped by `sample every 10000`")


def test_a_query_of_an_earlier_name_says_why_it_is_empty(flying):
    """Numbers of samples go on, so that they do not tell whether this query has given one."""
    name = registered(flying, SPEED)
    fly(flying)
    assert flying.queries.view(name).empty is None
    flying.queries.remove(name)
    assert registered(flying, "?o a dyknow:Car ; dyknow:speed ?v") == name
    assert flying.queries.view(name).empty == "no sample read yet from s"
    rows = [(second, {"id": "uav1", "spd": 1.0}) for second in range(20, 24)]
    feed(flying, "s", rows)
    assert flying.queries.view(name).empty.endswith("no member of dyknow:Car seen")
    assert flying.generator(name).stream.last_number > 0


def test_views_parse_no_query_but_after_a_change_of_the_ontology(flying, monkeypatch):
    parsed = []

    def parse(text):
        parsed.append(text)
        return parse_query(text)

    monkeypatch.setattr(empty_reasons, "parse_query", parse)
    texts = [QUERY.format(f"{SPEED} FILTER (?v > {limit})") for limit in (100, 200)]
    names = [
        flying.queries.register(text.replace("QUERY q", f"QUERY q{i}")).name
        for i, text in enumerate(texts)
    ]
    for name in names:
        assert flying.queries.view(name).empty == "no sample read yet from s"
    assert not parsed
    flying.load_ontology("dyknow:Kite rdfs:subClassOf dyknow:Thing .", name="kites")
    for name in [*names, *names]:
        assert flying.queries.view(name).empty == "no sample read yet from s"
    assert len(parsed) == len(names)
