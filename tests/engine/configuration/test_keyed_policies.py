"""A policy on an annotated stream holds for each object by itself (SPEC §1, Policies)."""

import pytest
from feeding import feed, samples
from specifying import apply, text

from dyknow.converters.wire import Incoming
from dyknow.engine.durability.commands import Subscribe, SubscribeToFeature
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import Since, StreamDeclaration
from dyknow.languages.specification import parse_specification
from dyknow.ontology.ontology import Ontology
from dyknow.streams.sample import Field, FieldType, batch_from_rows
from dyknow.streams.stream_rules import UNIQUE_TIMES

SSL = "stream s contains speed(UAV) = spd [km.h-1] for every UAV = id"
FIELDS = (Field("id", FieldType.STRING), Field("spd", FieldType.FLOAT))
# Two objects at the same times, stamped one after the other.
ROWS = [(i + j / 2, {"id": f"uav{j + 1}", "spd": 10.0 * j}) for i in range(5) for j in range(2)]


@pytest.fixture
def watched(engine):
    engine.declare(StreamDeclaration("s", FIELDS))
    return engine


KPL = """sort fix = (id string, spd float)
source fix s
strmgen f = s
"""
EVERY = """<cu{name} type="policy"><parameter name="policy" value="sample every 1s"/>
{input}</cu>"""


def declared(engine, term="f with sample every 1s"):
    """The stream of a policy in KPL."""
    engine.add_kpl(f"{KPL}stream out = {term}")
    return "out"


def specified(engine):
    """The stream of a policy in a specification."""
    apply(engine, EVERY.format(name=' name="out"', input='<stream name="s"/>'))
    return "out"


def subscribed(engine):
    """The stream of a subscription with a policy."""
    return engine.subscribe("s", "sample every 1s").stream


WAYS = pytest.mark.parametrize("way", [declared, specified, subscribed])


def played(engine, subscription):
    return ids_of(engine, subscription.stream)


def ids_of(engine, stream):
    """Whose samples a stream has, in order, once all rows are played."""
    for seconds, values in ROWS:
        feed(engine, "s", [(seconds, values)])
    engine.end("s")
    return [values["id"] for _, values in samples(engine, stream)]


@pytest.mark.parametrize("policy", ["sample every 1s", "sample every 1s, max delay 1s"])
def test_a_period_is_each_objects_own(watched, policy):
    watched.annotate(SSL)
    found = watched.subscribe("s", policy)
    assert sorted(played(watched, found)) == ["uav1"] * 5 + ["uav2"] * 5
    counters = watched.subscription(found.id).counters
    assert (counters["received"], counters["sent"], counters["dropped"]) == (10, 10, {})


def test_most_recent_samples_of_all_objects_at_one_time(watched):
    watched.annotate(SSL)
    policy = "from 1970-01-01T00:00:01Z to 1970-01-01T00:00:04Z, sample every 1s, max delay 1s"
    found = watched.subscribe("s", f"{policy}, use most recent")
    assert sorted(played(watched, found)) == ["uav1"] * 4 + ["uav2"] * 4


def test_a_stream_without_annotation_is_adapted_as_a_whole(watched):
    assert played(watched, watched.subscribe("s", "sample every 1s")) == ["uav1"] * 5


def test_a_subscription_of_an_earlier_version_stays_what_it_was(watched):
    """Its command in the journal says nothing of keys."""
    watched.annotate(SSL)
    found = Subscribe("s", "sample every 1s").apply(watched)
    keyed = Subscribe("s", "sample every 1s", keyed=True).apply(watched)
    assert found.stream != keyed.stream
    assert played(watched, found) == ["uav1"] * 5
    assert len(samples(watched, keyed.stream)) == 10


@pytest.mark.parametrize(("keyed", "ids"), [(True, {"uav1", "uav2"}), (None, {"uav1"})])
def test_a_subscription_to_a_feature(watched, keyed, ids):
    watched.annotate(SSL)
    found = SubscribeToFeature(
        "speed", "UAV", policy="sample every 1s", since=Since.START, keyed=keyed
    ).apply(watched)
    for seconds, values in ROWS:
        feed(watched, "s", [(seconds, values)])
    objects = {values["object"] for _, values in samples(watched, found.stream)}
    assert {each.rpartition("/")[2].rpartition(":")[2] for each in objects} == ids


# -- in KPL and in specifications --------------------------------------------------------------


@WAYS
def test_whoever_asks_a_policy_holds_for_each_object(watched, way):
    watched.annotate(SSL)
    assert ids_of(watched, way(watched)) == ["uav1", "uav2"] * 5


@WAYS
def test_the_annotation_counts_that_there_is_when_a_policy_begins(watched, way):
    stream = way(watched)
    watched.annotate(SSL)
    assert ids_of(watched, stream) == ["uav1"] * 5


@WAYS
def test_an_annotation_without_id_field_names_no_objects(watched, way):
    watched.annotate("stream s contains speed(uav1) = spd [km.h-1]")
    assert ids_of(watched, way(watched)) == ["uav1"] * 5


@WAYS
def test_by_the_rules_of_before_a_policy_is_of_the_whole_stream(way):
    engine = Engine(rules=UNIQUE_TIMES)
    engine.declare(StreamDeclaration("s", FIELDS))
    engine.annotate(SSL)
    assert ids_of(engine, way(engine)) == ["uav1"] * 5


@WAYS
def test_a_policy_on_what_a_policy_makes(watched, way):
    watched.annotate(SSL)
    found = watched.subscribe(way(watched), "sample every 2s")
    assert played(watched, found) == ["uav1", "uav2"] * 3


def test_a_policy_on_late_samples(watched):
    watched.annotate(SSL)
    stream = watched.subscribe("s_late", "sample every 1s").stream
    feed(watched, "s", [(9, {"id": "uav1", "spd": 1.0})])
    for seconds, id in [(1, "uav1"), (1.5, "uav2"), (2, "uav1")]:
        feed(watched, "s", [(seconds, {"id": id, "spd": 1.0})])
    assert [values["id"] for _, values in samples(watched, stream)] == ["uav1", "uav2", "uav1"]


def test_terms_in_processes(watched):
    """Equal terms share a stream as long as the annotation names the same objects."""
    watched.add_kpl(f"{KPL}strmgen whole = join(f with sample every 1s)")
    watched.annotate(SSL)
    watched.add_kpl("strmgen a = join(f with sample every 1s)")
    watched.add_kpl("strmgen b = join(f with sample every 1s)")
    units = watched.units()
    assert sum(unit.transformation == "policy" for unit in units) == 2
    for seconds, values in ROWS:
        feed(watched, "s", [(seconds, values)])
    watched.end("s")
    for name, ids in [("whole", ["uav1"] * 5), ("a", ["uav1", "uav2"] * 5)]:
        assert [values["f_id"] for _, values in samples(watched, name)] == ids


def test_an_order_of_each_object_is_none_of_the_stream_to_a_synchronization(watched):
    """A state waits for the sample of the object that is behind."""
    watched.annotate(SSL)
    watched.add_kpl(
        f"""{KPL}source float x
strmgen g = x
strmgen states = sync(f with monotone order, g; any change, max delay 10s)"""
    )
    feed(watched, "x", [(3, {"value": 1.0})])
    feed(watched, "s", [(4, {"id": "uav1", "spd": 1.0})])
    assert samples(watched, "states") == []
    generator = watched.generator("s")
    rows = [(5 * 10**9, 3 * 10**9, {"id": "uav2", "spd": 2.0})]
    batch = batch_from_rows(generator.schema, rows, generator.stream.pools)
    watched.publish("s", Incoming(batch, stamped=False), 0)
    watched.end("s")
    watched.end("x")
    states = [(valid, values["f_id"]) for valid, values in samples(watched, "states")]
    assert (3.0, "uav2") in states


# -- what stands over a restart, and as a text ---------------------------------------------------


def restarted(engine):
    """An engine of another program: what was asked for begins anew."""
    return Engine(ontology=Ontology.of_quads(engine.ontology.quads()))


@pytest.mark.parametrize("is_declared", [True, False])
def test_declarations_restored_find_the_annotations_of_their_sources(is_declared):
    """Where KPL makes the source, its annotation cannot be there before."""
    first = Engine()
    if is_declared:
        first.declare(StreamDeclaration("s", FIELDS))
    first.add_kpl(KPL)
    first.annotate(SSL)
    first.add_kpl("stream out = f with sample every 1s")
    assert ids_of(first, "out") == ["uav1", "uav2"] * 5
    again = restarted(first)
    assert again.stream("s").annotation == SSL
    assert ids_of(again, "out") == ["uav1", "uav2"] * 5


def test_a_specification_restored_finds_the_annotations():
    first = Engine()
    first.declare(StreamDeclaration("s", FIELDS))
    first.annotate(SSL)
    specified(first)
    assert ids_of(restarted(first), "out") == ["uav1", "uav2"] * 5


@pytest.mark.parametrize("way", [specified, subscribed])
def test_the_running_configuration_gives_the_same_again(watched, way):
    watched.annotate(SSL)
    stream = way(watched)
    current = watched.current_specification()
    assert [one.type for one in parse_specification(current).insertions] == ["policy"]
    before = [unit.name for unit in watched.units()]
    assert watched.apply_specification(current).started == ()
    assert [unit.name for unit in watched.units()] == before
    other = Engine()
    other.declare(StreamDeclaration("s", FIELDS))
    other.annotate(SSL)
    (made,) = other.apply_specification(current).started
    assert ids_of(watched, stream) == ids_of(other, made.output) == ["uav1", "uav2"] * 5


@pytest.mark.parametrize("way", [specified, subscribed])
def test_what_began_before_the_annotation_is_no_specification_any_more(watched, way):
    """Sent again the text would give another policy: it stands in the comment, and the same
    insertion makes a unit of its own."""
    stream = way(watched)
    watched.annotate(SSL)
    current = watched.current_specification()
    assert parse_specification(current).insertions == ()
    assert f"(policy) makes {stream}" in current
    apply(watched, EVERY.format(name=' name="each"', input='<stream name="s"/>'))
    assert ids_of(watched, "each") == ["uav1", "uav2"] * 5
    assert len(samples(watched, stream)) == 5


def test_an_insertion_is_made_anew_with_the_annotation_of_now(watched):
    specified(watched)
    watched.annotate(SSL)
    again = EVERY.format(name=' name="out"', input='<stream name="s"/>')
    watched.apply_specification(text(again, '<cu name="out"/>'))
    assert ids_of(watched, "out") == ["uav1", "uav2"] * 5
