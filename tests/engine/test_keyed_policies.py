"""A policy on an annotated stream holds for each object by itself (SPEC §1, Policies)."""

import pytest
from feeding import feed, samples

from dyknow.engine.commands import Subscribe, SubscribeToFeature
from dyknow.engine.views import Since, StreamDeclaration
from dyknow.streams.sample import Field, FieldType

SSL = "stream s contains speed(UAV) = spd [km.h-1] for every UAV = id"
FIELDS = (Field("id", FieldType.STRING), Field("spd", FieldType.FLOAT))
# Two objects at the same times, stamped one after the other.
ROWS = [(i + j / 2, {"id": f"uav{j + 1}", "spd": 10.0 * j}) for i in range(5) for j in range(2)]


@pytest.fixture
def watched(engine):
    engine.declare(StreamDeclaration("s", FIELDS))
    return engine


def played(engine, subscription):
    for seconds, values in ROWS:
        feed(engine, "s", [(seconds, values)])
    engine.end("s")
    return [values["id"] for _, values in samples(engine, subscription.stream)]


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
