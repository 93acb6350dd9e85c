"""Adaptive subscriptions: every trigger, every promise ([Introspection15 §4.4], SPEC §7)."""

import pytest
from adapting_world import OF_ALL, OF_UAV1, World, ns

from dyknow.engine.model.errors import Conflict
from dyknow.engine.model.views import Since
from dyknow.engine.processes.registry import Processes
from dyknow.streams.history import Retention
from dyknow.streams.sample import Field, FieldType

OF_CARS = "stream {} contains speed(Car) = spd [km.h-1] for every Car = id"
IN_METRES = "stream {} contains speed(UAV) = spd [m.s-1] for every UAV = id"
ALTITUDE = "stream {} contains altitude(UAV) = spd [ft] for every UAV = id"
UAV2 = "stream {} contains speed(uav2) = spd [km.h-1]"


@pytest.fixture
def world():
    return World()


# -- loss ----------------------------------------------------------------------------------------


def test_a_stream_that_ends_is_replaced(world):
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe()
    world.run(0, 3, 1, "a", "b")
    world.engine.end("a")
    assert world.reads(id) == ("b",)
    world.run(3, 5, 1, "b")
    assert world.values(id) == [0, 1, 2, 3, 4]
    assert world.switches(id) == [
        (0, "requested", (), ("a",)),
        (2, "a ended", ("a",), ("b",)),
    ]
    assert world.mirrored(id) == ["b"]
    told = world.status("inputs changed")[-1]
    assert told["inputs"] == "b"
    assert told["specification"] == "dyknow:speed of every dyknow:UAV: a ended"


def test_what_the_new_source_held_and_the_lost_one_did_not(world):
    """No sample of the new source that follows the last one delivered is lost or repeated."""
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe()
    for time in range(6):
        world.say("b", time, 100 + time, own=time)
        if time < 3:
            world.say("a", time, time, own=time)
    world.engine.end("a")
    assert world.values(id) == [0, 1, 2, 103, 104, 105]
    assert not world.engine.rematches(id)[-1].lost


def test_the_rest_of_a_batch_that_was_cut(world):
    """It comes in the moment of the switch, and is no more than what was kept."""
    world.declare("a", meaning=OF_ALL)
    world.engine.set_quality("a", 0.5)
    id = world.subscribe(strategy="quality", hold_off=0)
    world.declare("b", meaning=OF_ALL)
    world.say("a", 1, 1, own=10)
    world.say("b", 1, 9, own=9)
    assert world.reads(id) == ("b",)
    world.say("b", 1, 10, own=10)
    world.say("b", 1, 11, own=11)
    assert world.values(id) == [1, 11]


def test_what_the_new_source_had_forgotten(world):
    world.declare("a", meaning=OF_ALL)
    world.declare("b", meaning=OF_ALL, retention=Retention(samples=2))
    id = world.subscribe()
    for time in range(6):
        world.say("b", time, 100 + time, own=time)
        if time < 3:
            world.say("a", time, time, own=time)
    world.engine.end("a")
    assert world.values(id) == [0, 1, 2, 104, 105]
    assert world.engine.rematches(id)[-1].lost


def test_two_streams_end_at_one_moment(world):
    world.declare("a", "b", "c", meaning=OF_ALL)
    id = world.subscribe()
    for name in ("a", "b", "c"):
        world.say(name, 1)
    world.engine.end("a")
    world.engine.end("b")
    assert world.path(id) == ["a", "b", "c"]


def test_the_last_stream_ends_and_goes_on(world):
    world.declare("a", meaning=OF_ALL)
    id = world.subscribe()
    world.say("a", 1)
    world.engine.end("a")
    assert world.state(id) == "stale"
    world.say("a", 2)
    assert world.state(id) == "running"
    assert world.values(id) == [1, 2]
    assert len(world.switches(id)) == 1


def test_a_removed_stream_is_replaced(world):
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe()
    world.run(0, 3, 1, "a", "b")
    world.engine.remove_stream("a")
    assert world.switches(id)[-1] == (2, "a is removed", ("a",), ("b",))
    world.say("b", 3)
    assert world.values(id) == [0, 1, 2, 3]
    assert world.mirrored(id) == ["b"]


def test_where_only_a_silent_one_is_left_that_is_read(world):
    """What was ahead of it is no matter: it goes on where the one that is lost had been."""
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe(staleness=2)
    for time in range(3):
        world.say("a", time, time, own=time)
        world.say("b", time, 100 + time, own=time + 1)
    world.engine.end("b")
    world.engine.remove_stream("a")
    assert (world.state(id), world.path(id)) == ("stale", ["a", "b"])
    assert world.values(id) == [0, 1, 2, 102]


def test_after_a_pause_it_goes_on_where_the_lost_one_had_been(world):
    """Another one had been further before that; what is its own time says nothing of others."""
    world.declare("a", "b", meaning=OF_ALL)
    world.declare("c")
    id = world.subscribe()
    world.say("a", 1, 1, own=50)
    world.engine.end("a")
    for time in range(2, 5):
        world.say("b", time, time, own=time)
        world.say("c", time, 100 + time, own=time)
    world.say("c", 5, 105, own=5)
    world.engine.annotate(ALTITUDE.format("a"))
    world.engine.remove_stream("b")
    assert world.state(id) == "waiting"
    world.engine.annotate(OF_ALL.format("c"))
    assert world.values(id) == [1, 2, 3, 4, 105]


def test_the_only_stream_is_removed_and_comes_again(world):
    world.declare("a", meaning=OF_ALL)
    id = world.subscribe()
    world.say("a", 1)
    world.engine.remove_stream("a")
    assert world.state(id) == "waiting"
    assert world.view(id).missing != ()
    assert world.mirrored(id) == []
    world.declare("a", meaning=OF_ALL)
    assert (world.state(id), world.reads(id)) == ("running", ("a",))
    world.say("a", 2)
    assert world.values(id) == [1, 2]


def test_a_stream_of_the_same_name_is_another(world):
    """A stream that was removed is not avoided when it comes again, and is taken if better."""
    world.declare("a", "b", meaning=OF_ALL)
    world.engine.set_quality("b", 0.5)
    id = world.subscribe(strategy="quality")
    world.run(0, 2, 1, "a", "b")
    world.engine.remove_stream("a")
    world.declare("a", meaning=OF_ALL)
    world.run(2, 6, 1, "a", "b")
    assert world.path(id) == ["a", "b", "a"]


def test_a_removal_that_is_refused_changes_nothing(world):
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe()
    world.run(0, 3, 1, "a", "b")
    other = world.engine.subscribe("a", "max delay 5")
    with pytest.raises(Conflict):
        world.engine.remove_stream("a")
    assert world.path(id) == ["a"]
    world.engine.unsubscribe(other.id)
    world.engine.remove_stream("a")
    assert world.path(id) == ["a", "b"]


# -- staleness -----------------------------------------------------------------------------------


def test_declared_staleness_begins_right_after_it(world):
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe(staleness=3)
    world.say("a", 1)
    world.say("b", 1)
    for time in (2, 3):
        world.say("b", time)
    world.engine.tick(ns(4) - 1)
    assert world.path(id) == ["a"]
    world.tick(4)
    assert world.path(id) == ["a", "b"]
    assert world.switches(id)[-1][:2] == (4, "a fell silent")
    assert world.values(id) == [1, 2, 3]


def test_a_stream_that_never_speaks_is_silent_where_that_is_declared(world):
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe(staleness=3)
    world.say("b", 2)
    world.tick(3)
    assert world.path(id) == ["a", "b"]
    assert world.values(id) == [2]


def test_one_that_was_silent_from_the_first_is_taken_when_it_speaks(world):
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe(staleness=3)
    world.run(0, 10, 1, "b")
    assert world.path(id) == ["a", "b"]
    world.run(10, 15, 1, "a", "b")
    assert world.path(id) == ["a", "b", "a"]


def test_a_stream_that_speeds_up_and_dies_is_not_waited_for_as_before(world):
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe()
    world.run(0, 100, 10, "a", "b")
    world.run(100, 110, 0.1, "a", "b")
    world.run(110, 114, 1, "b")
    assert world.path(id) == ["a", "b"]


def test_learned_staleness_is_five_times_the_usual_gap(world):
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe()
    world.run(0, 10, 0.5, "a", "b")  # the last at 9.5
    world.say("b", 11.5)
    world.engine.tick(ns(12) - 1)
    assert world.path(id) == ["a"]
    world.tick(12)
    assert world.path(id) == ["a", "b"]


def test_a_fast_stream_has_a_second(world):
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe()
    world.run(0, 1, 0.01, "a", "b")
    world.say("b", 1.5)
    world.engine.tick(ns(1.99) - 1)
    assert world.path(id) == ["a"]
    world.tick(1.99)
    assert world.path(id) == ["a", "b"]


def test_a_stream_that_slows_down_gradually_is_not_silent(world):
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe()
    time, gap = 0.0, 0.5
    while gap < 60:
        world.say("a", time)
        world.say("b", time)
        for k in range(1, 20):
            world.tick(time + gap * k / 20)
        time, gap = time + gap, gap * 1.2
    assert world.path(id) == ["a"]


def test_a_burst_is_one_arrival(world):
    """Many samples of one moment, in one batch or in many, and then a long pause."""
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe()
    for time in range(0, 100, 5):
        world.tick(time)
        world.say_all("a", time, [("uav1", k) for k in range(10)])
        for k in range(10):
            world.say("a", time, k)
        world.say("b", time)
    world.engine.tick(ns(95 + 25) - 1)
    assert world.path(id) == ["a"]


@pytest.mark.parametrize("staleness", [None, 7])
def test_bursts_that_come_one_by_one(world, staleness):
    """In the pauses between them a stream is silent unless it is declared that it is not; it is
    left once, and not taken back for a burst that is shorter than the hold-off."""
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe(staleness=staleness)
    for time in range(0, 60, 6):
        for k in range(10):
            world.tick(time + k / 10)
            world.say("a", time + k / 10)
        world.run(time + 1, time + 6, 1, "b")
    assert world.path(id) == (["a", "b"] if staleness is None else ["a"])


def test_own_times_of_another_year_do_not_matter(world):
    """When something came is what counts, not when it says that it was available."""
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe()
    year = 31_536_000
    for time in range(10):
        world.tick(50 * year + time)
        world.say("a", 50 * year + time, own=40 * year + time / 10)
        world.say("b", 50 * year + time, own=40 * year + time / 10)
    assert world.path(id) == ["a"]
    for time in range(10, 14):
        world.tick(50 * year + time)
        world.say("b", 50 * year + time, own=40 * year + time / 10)
    assert world.path(id) == ["a"]
    world.tick(50 * year + 14)
    assert world.path(id) == ["a", "b"]
    assert len(world.values(id)) == 14


def test_silent_without_another_it_is_stale(world):
    world.declare("a", meaning=OF_ALL)
    id = world.subscribe(staleness=2)
    world.run(0, 3, 1, "a")
    world.run(3, 10, 1)
    assert world.state(id) == "stale"
    assert world.path(id) == ["a"]
    world.say("a", 10)
    assert world.state(id) == "running"
    world.run(11, 20, 1)
    assert world.state(id) == "stale"


def test_nothing_comes_by_saying_nothing(world):
    """An empty batch is no sample, and so are samples that are too late."""
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe(staleness=3)
    world.say("a", 1, own=10)
    for time in range(2, 8):
        world.tick(time)
        world.say_all("a", time, [], own=10)
        world.say("a", time, own=time)
        world.say("b", time, own=time)
    assert world.path(id) == ["a", "b"]


def test_an_object_that_leaves_one_stream_for_another(world):
    """A stream goes on, and says nothing more of who is wanted."""
    world.declare("a", "b", meaning=OF_ALL)
    world.engine.load_ontology(
        "@prefix d: <http://www.ida.liu.se/dyknow/> . d:uav1 a d:UAV .", name="http://x/y"
    )
    id = world.subscribe(objects=["uav1"])
    for time in range(8):
        world.tick(time)
        world.say("a", time)
        world.say("b", time, id="uav2")
    for time in range(8, 36):
        world.tick(time)
        world.say("a", time, id="uav2")
        world.say("b", time)
    assert world.path(id) == ["a", "b"]
    assert world.values(id) == list(range(36))


def test_a_source_that_speaks_once_and_dies_is_left_again(world):
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe()
    world.run(0, 10, 1, "a", "b")
    world.run(10, 20, 1, "b")
    assert world.path(id) == ["a", "b"]
    world.say("a", 20)
    world.run(20, 60, 1, "b")
    assert world.reads(id) == ("b",)
    assert world.values(id) == list(range(60))


# -- quality -------------------------------------------------------------------------------------


def test_quality_below_the_bound(world):
    world.declare("a", "b", meaning=OF_ALL)
    world.engine.set_quality("b", 0.6)
    id = world.subscribe(quality=0.5)
    world.run(0, 2, 1, "a", "b")
    world.engine.set_quality("a", 0.5)
    assert world.path(id) == ["a"]
    world.engine.set_quality("a", 0.49)
    assert world.switches(id)[-1] == (1, "quality of a is 0.49", ("a",), ("b",))
    world.engine.set_quality("a", 0.9)
    world.run(2, 6, 1, "a", "b")
    assert world.path(id) == ["a", "b", "a"]
    assert world.values(id) == list(range(6))


def test_without_a_bound_quality_is_no_matter(world):
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe()
    world.run(0, 2, 1, "a", "b")
    world.engine.set_quality("a", 0)
    world.run(2, 8, 1, "a", "b")
    assert world.path(id) == ["a"]


def test_the_best_quality_is_lost(world):
    world.declare("a", "b", meaning=OF_ALL)
    world.engine.set_quality("b", 0.5)
    id = world.subscribe(strategy="quality")
    world.say("a", 1)
    world.say("b", 1)
    world.engine.set_quality("a", 0.4)
    assert world.path(id) == ["a", "b"]


def test_of_what_is_good_enough_the_strategy_chooses(world):
    world.declare("a", "b", "c", meaning=OF_ALL)
    world.engine.set_quality("a", 0.2)
    world.engine.set_quality("b", 0.6)
    id = world.subscribe(quality=0.5)
    assert world.reads(id) == ("b",)


def test_too_bad_and_nothing_better(world):
    world.declare("a", meaning=OF_ALL)
    id = world.subscribe(quality=0.5)
    world.say("a", 1)
    world.engine.set_quality("a", 0.2)
    assert (world.state(id), world.reads(id)) == ("stale", ("a",))
    world.say("a", 2)
    assert world.state(id) == "stale"
    world.engine.set_quality("a", 0.6)
    assert world.state(id) == "running"
    world.engine.set_quality("a", 0.3)
    world.declare("b", meaning=OF_ALL)
    assert (world.state(id), world.path(id)) == ("running", ["a", "b"])
    assert world.values(id) == [1, 2]


def test_quality_that_rises_does_not_shorten_the_hold_off(world):
    world.declare("a", meaning=OF_ALL)
    world.engine.set_quality("a", 0.5)
    id = world.subscribe(strategy="quality", quality=0.2)
    world.say("a", 0)
    world.declare("b", meaning=OF_ALL)
    world.say("b", 0)
    world.tick(1)
    world.engine.set_quality("a", 0.6)
    assert world.path(id) == ["a"]
    world.say("b", 2)
    assert world.path(id) == ["a", "b"]


def test_who_reports_its_quality_all_the_time_is_taken_all_the_same(world):
    world.declare("a", "b", meaning=OF_ALL)
    world.engine.set_quality("a", 0.5)
    world.engine.set_quality("b", 0.1)
    id = world.subscribe(strategy="quality")
    world.run(0, 3, 1, "a", "b")
    for time in range(3, 8):
        world.tick(time)
        world.say("a", time)
        world.say("b", time)
        world.engine.set_quality("b", 0.8 + 0.1 * (time % 2))
    assert world.path(id) == ["a", "b"]


# -- meaning -------------------------------------------------------------------------------------


def test_another_feature(world):
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe()
    world.run(0, 3, 1, "a", "b")
    world.engine.annotate(ALTITUDE.format("a"))
    assert world.switches(id)[-1] == (2, "a means something else", ("a",), ("b",))
    world.say("a", 3, 1000)
    world.say("b", 3)
    assert world.values(id) == [0, 1, 2, 3]


def test_another_feature_and_no_other_stream(world):
    """An altitude is never passed on as a speed."""
    world.declare("a", meaning=OF_ALL)
    id = world.subscribe()
    world.say("a", 1)
    world.engine.annotate(ALTITUDE.format("a"))
    world.say("a", 2, 1000)
    assert world.values(id) == [1]
    assert (world.state(id), world.reads(id), world.mirrored(id)) == ("waiting", (), [])
    world.engine.annotate(OF_ALL.format("a"))
    world.say("a", 3)
    assert world.state(id) == "running"
    assert world.values(id)[0] == 1
    assert world.values(id)[-1] == 3


def test_another_sort(world):
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe()
    world.say("a", 1)
    world.engine.annotate(OF_CARS.format("a"))
    world.say("a", 2, id="car1")
    assert world.path(id) == ["a", "b"]
    assert world.values(id) == [1]


def test_another_unit(world):
    world.declare("a", meaning=OF_ALL)
    id = world.subscribe()
    world.say("a", 1, 10)
    world.engine.annotate(IN_METRES.format("a"))
    world.say("a", 2, 10)
    assert world.values(id) == pytest.approx([10, 36])
    assert world.switches(id)[-1][1:] == ("a means something else", ("a",), ("a",))


def test_another_field(world):
    world.declare("a", meaning=OF_ALL)
    id = world.subscribe()
    world.say("a", 1, 10)
    world.engine.annotate("stream a contains speed(UAV) = other [km.h-1] for every UAV = id")
    world.say("a", 2, 20, field="other")
    assert world.values(id) == [10, 20]


def test_the_same_again_changes_nothing(world):
    world.declare("a", meaning=OF_ALL)
    id = world.subscribe()
    world.say("a", 1)
    world.engine.annotate(OF_ALL.format("a"))
    world.run(1, 5, 1)
    assert world.path(id) == ["a"]


def test_of_a_narrower_sort_others_are_meant(world):
    """A stream of all things gives only those that are known to be UAVs, one of UAVs gives all."""
    world.declare(
        "a", meaning="stream {} contains speed(Thing) = spd [km.h-1] for every Thing = id"
    )
    id = world.subscribe()
    world.say("a", 1, id="somebody")
    assert world.values(id) == []
    world.engine.annotate(OF_ALL.format("a"))
    world.say("a", 2, id="somebody")
    assert world.values(id) == [2]
    world.engine.annotate("stream a contains speed(Thing) = spd [km.h-1] for every Thing = id")
    world.say("a", 3, id="somebody")
    assert world.values(id) == [2]


def test_an_object_that_becomes_known(world):
    world.declare(
        "a", meaning="stream {} contains speed(Thing) = spd [km.h-1] for every Thing = id"
    )
    id = world.subscribe()
    world.say("a", 1)
    world.engine.load_ontology(
        "@prefix d: <http://www.ida.liu.se/dyknow/> . d:uav1 a d:UAV .", name="http://x/y"
    )
    world.say("a", 2)
    assert world.values(id) == [2]


def test_the_ontology_says_that_it_is_no_speed_any_more(world):
    turtle = """
        @prefix d: <http://www.ida.liu.se/dyknow/> . @prefix : <http://www.dyknow.eu/ontology#> .
        @prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
        d:pace a :Feature ; rdfs:range <http://www.w3.org/2001/XMLSchema#double> ;
            :hasUnit "km.h-1" """
    world.engine.load_ontology(turtle + "; rdfs:subPropertyOf d:speed .", name="http://x/y")
    world.declare("a", meaning="stream {} contains pace(UAV) = spd [km.h-1] for every UAV = id")
    id = world.subscribe()
    world.say("a", 1)
    world.engine.load_ontology(turtle + ".", name="http://x/y")
    world.say("a", 2)
    assert world.values(id) == [1]
    assert world.state(id) == "waiting"


# -- user-written units and sources --------------------------------------------------------------

ONTOLOGY = """
@prefix d: <http://www.ida.liu.se/dyknow/> . @prefix : <http://www.dyknow.eu/ontology#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
d:raw a :Feature ; rdfs:range <http://www.w3.org/2001/XMLSchema#double> .
d:cooked a :Feature ; rdfs:range <http://www.w3.org/2001/XMLSchema#double> .
"""
RAW = "stream {} contains raw(UAV) = spd for every UAV = id"
COOKED = "stream {} contains cooked(UAV) = spd for every UAV = id"


class Kitchen:
    """Units from raw to cooked: ``first`` and ``second`` do what ``does`` says of them."""

    def __init__(self):
        self.does = {"first": lambda x: x + 1000, "second": lambda x: x + 2000}
        self.calls = {"probe": 0}
        self.processes = Processes()
        for name in ("first", "second"):
            self._register(name)
        self.processes.sampled("x", "1s", name="probe")(self._read)
        self.processes.sampled("x", "1s", name="spare")(lambda time: time // ns(1) + 500.0)

    def _register(self, name):
        def cook(time, samples, state):
            return self.does[name](samples[0].value), state

        self.processes.computational_unit("x", ["x"], name=name, on_error="stop")(cook)

    def _read(self, time):
        self.calls["probe"] += 1
        return self.does.get("probe", lambda time: time // ns(1) + 0.0)(time)

    def world(self, *units):
        world = World(self.processes)
        world.engine.load_ontology(ONTOLOGY, name="http://x/y")
        for unit in units:
            world.engine.annotate(f"compunit {unit} transforms x:raw(UAV) to y:cooked(UAV)")
        return world


@pytest.fixture
def kitchen():
    return Kitchen()


def explode(x):
    raise ValueError(x)


def test_a_unit_that_fails_by_its_rule(kitchen):
    world = kitchen.world("first", "second")
    world.declare("a", meaning=RAW)
    id = world.subscribe("cooked")
    world.run(0, 3, 1, "a")
    assert world.values(id) == [1000, 1001, 1002]
    kitchen.does["first"] = explode
    world.say("a", 3)
    assert world.values(id) == [1000, 1001, 1002, 2003]
    assert world.switches(id)[-1] == (3, "dyknow_cu2 (first) failed", ("a",), ("a",))
    assert world.ask("?x :instantiationOf :second")
    assert not world.ask("?x :instantiationOf :first")


def test_a_unit_that_fails_on_the_past(kitchen):
    """It is built because another is lost, and fails on what there is to begin with."""
    world = kitchen.world("first")
    kitchen.does["first"] = explode
    world.declare("b", meaning=COOKED)
    world.declare("a", meaning=RAW)
    world.declare("c", meaning=COOKED)
    world.say("a", 1)
    world.say("b", 1)
    id = world.subscribe("cooked", strategy="fast")
    assert world.reads(id) == ("b",)
    world.engine.end("c")
    world.say("a", 2)
    world.engine.end("b")
    world.tick(3)
    assert world.state(id) == "stale"
    world.say("c", 4)
    assert (world.state(id), world.reads(id)) == ("running", ("c",))
    assert world.values(id) == [4]


def test_a_subscription_since_the_start_whose_unit_fails_on_the_past(kitchen):
    world = kitchen.world("first", "second")
    kitchen.does["first"] = explode
    world.declare("a", meaning=RAW)
    world.run(0, 3, 1, "a")
    id = world.subscribe("cooked", since=Since.START)
    assert world.values(id) == [2000, 2001, 2002]


def test_a_failed_unit_is_tried_again_after_a_while(kitchen):
    world = kitchen.world("first")
    world.declare("a", meaning=RAW)
    id = world.subscribe("cooked")
    world.say("a", 1)
    kitchen.does["first"] = explode
    world.say("a", 2)
    assert world.state(id) == "stale" or world.state(id) == "waiting"
    kitchen.does["first"] = lambda x: x
    world.run(3, 40, 1, "a")
    assert world.state(id) == "running"
    assert world.values(id) == [1001, *range(2, 40)]


def test_a_unit_that_makes_nothing(kitchen):
    world = kitchen.world("first", "second")
    world.declare("a", meaning=RAW)
    id = world.subscribe("cooked")
    world.run(0, 8, 1, "a")
    kitchen.does["first"] = lambda x: None
    world.run(8, 14, 1, "a")
    assert world.switches(id)[-1][1] == "first fell silent"
    assert world.values(id) == [1000 + k for k in range(8)] + [2000 + k for k in range(8, 14)]


def test_a_stream_behind_a_unit_falls_silent(kitchen):
    world = kitchen.world("first")
    world.declare("a", "b", meaning=RAW)
    id = world.subscribe("cooked")
    world.run(0, 8, 1, "a", "b")
    world.run(8, 14, 1, "b")
    assert world.switches(id)[-1][1:] == ("a fell silent", ("a",), ("b",))
    assert world.values(id) == [1000 + k for k in range(14)]


def test_one_unit_of_two_makes_nothing(kitchen):
    """The other, that works, is left alone."""
    world = kitchen.world()
    for unit, uav in (("first", "uav1"), ("second", "uav2")):
        world.engine.annotate(f"compunit {unit} transforms x:raw({uav}) to y:cooked({uav})")
    world.declare("a", meaning="stream {} contains raw(uav1) = spd")
    world.declare("b", meaning="stream {} contains raw(uav2) = spd")
    id = world.subscribe("cooked", sort="Thing")
    assert world.reads(id) == ("a", "b")
    world.run(0, 8, 1, "a", "b")
    kitchen.does["first"] = lambda x: None
    world.run(8, 20, 1, "a", "b")
    assert [row for row in world.received(id) if row[1] == "uav2"] == [
        (k, "uav2", 2000 + k) for k in range(20)
    ]
    assert world.reads(id) == ("b",)


def test_the_quality_of_a_transformation(kitchen):
    world = kitchen.world("first", "second")
    world.declare("a", meaning=RAW)
    id = world.subscribe("cooked", quality=0.5)
    world.say("a", 1)
    world.engine.transformations.change("first", quality=0.3)
    world.say("a", 2)
    world.say("a", 3)
    assert world.switches(id)[-1][1] == "quality of first"
    assert world.values(id) == [1001, 2002, 2003] or world.values(id) == [1001, 1002, 2003]


def test_another_meaning_of_a_transformation(kitchen):
    world = kitchen.world("first", "second")
    world.declare("a", meaning=RAW)
    id = world.subscribe("cooked")
    world.say("a", 1)
    world.engine.annotate("compunit first transforms x:raw(UAV) to y:altitude(UAV)")
    world.say("a", 2)
    assert world.values(id) == [1001, 2002]


def test_a_better_transformation_is_taken(kitchen):
    world = kitchen.world("first")
    world.declare("a", meaning=RAW)
    world.engine.transformations.change("first", quality=0.5)
    id = world.subscribe("cooked", strategy="quality")
    world.run(0, 2, 1, "a")
    world.engine.annotate("compunit second transforms x:raw(UAV) to y:cooked(UAV)")
    world.run(2, 6, 1, "a")
    assert world.switches(id)[-1][:2] == (4, "a better source appeared") or (
        world.switches(id)[-1][:2] == (3, "a better source appeared")
    )
    assert [value % 1000 for value in world.values(id)] == list(range(6))
    assert world.values(id)[-1] == 2005


def test_a_transformation_that_comes_between_two_subscriptions(kitchen):
    """What leads to a feature is not remembered from before."""
    world = kitchen.world()
    id = world.subscribe("cooked")
    world.declare("b", meaning=COOKED)
    world.engine.unsubscribe(id)
    world.engine.remove_stream("b")
    world.engine.annotate("compunit first transforms x:raw(UAV) to y:cooked(UAV)")
    id = world.subscribe("cooked")
    world.declare("a", meaning=RAW)
    world.say("a", 1)
    assert world.values(id) == [1001]


def test_source_units_start_and_stop_as_they_are_needed(kitchen):
    world = kitchen.world()
    world.engine.annotate("source probe provides y:cooked(self)")
    id = world.subscribe("cooked", sort="Thing")
    world.run(0, 3, 1)
    assert (world.reads(id), world.values(id)) == (("probe",), [0, 1, 2])
    kitchen.does["probe"] = explode
    world.engine.annotate("source spare provides y:cooked(self)")
    world.run(3, 12, 1)
    assert world.reads(id) == ("spare",)
    assert world.values(id)[:3] == [0, 1, 2]
    assert world.values(id)[-1] == 511
    world.engine.unsubscribe(id)
    calls = kitchen.calls["probe"]
    world.run(12, 15, 1)
    assert kitchen.calls["probe"] == calls


def test_a_source_that_goes_on_is_not_started_anew(kitchen):
    """The supply grows by another stream: what is read already goes on as it is."""
    world = kitchen.world()
    world.engine.annotate("source probe provides y:cooked(self)")
    id = world.subscribe("cooked", sort="Thing")
    world.run(0, 3, 1)
    world.declare("b", meaning="stream {} contains cooked(uav2) = spd")
    world.say("b", 2, 700)
    world.run(3, 8, 1, "b")
    assert set(world.reads(id)) == {"probe", "b"}
    assert [v for v in world.values(id) if v < 500][:3] == [0, 1, 2]
    assert kitchen.calls["probe"] == 8
    assert len(world.ask("?x :instantiationOf :probe")) == 1


def test_code_that_is_gone_costs_nobody_else_anything(kitchen):
    world = kitchen.world("first")
    world.declare("b", meaning=COOKED)
    world.declare("a", meaning=RAW)
    world.declare("s", "t", meaning=OF_ALL)
    poor = world.subscribe("cooked")
    other = world.subscribe()
    for name in ("a", "b", "s", "t"):
        world.say(name, 1)
    kitchen.processes.remove("first")
    world.engine.end("b")
    world.engine.end("s")
    assert world.path(other) == ["s", "t"]
    assert world.state(poor) == "stale"
    world.say("b", 2)
    assert world.values(poor) == [1, 2]


def test_the_plan_is_not_taken_for_a_better_one(kitchen):
    """The stream of its own unit is no better source."""
    world = kitchen.world("first")
    world.declare("a", meaning=RAW)
    id = world.subscribe("cooked", since=Since.START)
    world.run(0, 2, 1, "a")
    world.declare("b", meaning=RAW)
    world.run(2, 8, 1, "a", "b")
    assert world.path(id) == ["a"]


# -- units that run already ----------------------------------------------------------------------


def dear_and_cheap(kitchen):
    """``second`` is the better one and costs more; both want the stream a."""
    world = kitchen.world("first", "second")
    world.engine.transformations.change("first", cost=2.0, quality=0.5)
    world.engine.transformations.change("second", cost=3.0, quality=1.0)
    world.declare("a", meaning=RAW)
    return world


def test_a_unit_that_runs_for_somebody_else_costs_nothing(kitchen):
    world = dear_and_cheap(kitchen)
    best = world.subscribe("cooked", strategy="quality")
    cheap = world.subscribe("cooked", strategy="cost")
    world.say("a", 1)
    assert world.values(best) == world.values(cheap) == [2001]
    assert len(world.ask("?x :instantiationOf :second")) == 1
    assert not world.ask("?x :instantiationOf :first")
    assert world.reads(cheap) == ("a",)


def test_what_a_shared_unit_is_made_from_is_known_to_all_that_share_it(kitchen):
    world = dear_and_cheap(kitchen)
    world.declare("b", meaning=RAW)
    ids = [world.subscribe("cooked", strategy=strategy) for strategy in ("quality", "cost")]
    world.say("a", 1)
    world.say("b", 1)
    world.engine.end("a")
    world.say("b", 2)
    for id in ids:
        assert world.path(id) == ["a", "b"]
        assert world.values(id) == [2001, 2002]
    assert len(world.ask("?x :instantiationOf :second")) == 1


def test_of_one_object_from_a_unit_that_runs_for_all(kitchen):
    world = dear_and_cheap(kitchen)
    world.subscribe("cooked", strategy="quality")
    one = world.subscribe("cooked", sort=None, objects=["uav1"], strategy="cost")
    world.say("a", 1, id="uav2")
    world.say("a", 2)
    assert world.values(one) == [2002]
    assert not world.ask("?x :instantiationOf :first")


def test_a_unit_that_runs_for_nobody_else_any_more_is_paid_for(kitchen):
    world = dear_and_cheap(kitchen)
    best = world.subscribe("cooked", strategy="quality")
    world.engine.unsubscribe(best)
    cheap = world.subscribe("cooked", strategy="cost")
    world.say("a", 1)
    assert world.values(cheap) == [1001]


def test_tuples_for_somebody_else_are_no_source(kitchen):
    """They say again what one input said when the other one speaks."""
    kitchen.processes.computational_unit("x", ["x", "y"], name="third")(
        lambda time, samples, state: (samples[0].value, state)
    )
    world = dear_and_cheap(kitchen)
    salt = ONTOLOGY.replace("d:raw", "d:salt").replace("d:cooked", "d:dish")
    world.engine.load_ontology(salt, name="http://x/z")
    world.engine.annotate("compunit third transforms a:raw(UAV), b:salt(UAV) to y:dish(UAV)")
    world.declare("b", meaning="stream {} contains salt(uav1) = spd")
    world.subscribe("dish", sort=None, objects=["uav1"])
    ids = [
        world.subscribe("raw", sort=None, objects=["uav1"], strategy=strategy)
        for strategy in ("fast", "cost", "quality")
    ]
    for time, name in enumerate(("a", "a", "b", "b", "a", "b")):
        world.say(name, time)
    for id in ids:
        assert world.received(id) == [(0, "uav1", 0), (1, "uav1", 1), (4, "uav1", 4)]
        assert world.reads(id) == ("a",)


def test_a_unit_that_began_later_is_paid_for_by_who_wants_the_past(kitchen):
    world = kitchen.world("first")
    world.engine.transformations.change("first", cost=1.0, quality=0.9)
    world.declare("a", meaning=RAW)
    id = world.subscribe("cooked", strategy="weighted:cost=1,quality=1")
    world.run(0, 3, 1, "a")
    world.engine.annotate("compunit second transforms x:raw(UAV) to y:cooked(UAV)")
    world.engine.transformations.change("second", cost=0.5, quality=0.95)
    world.subscribe("cooked", strategy="quality")
    world.run(3, 12, 1, "a")
    assert len(world.switches(id)) == 1
    assert len(world.ask("?x :instantiationOf :second")) == 1


def test_a_shared_unit_that_takes_its_input_for_something_else_is_not_shared(kitchen):
    world = dear_and_cheap(kitchen)
    best = world.subscribe("cooked", strategy="quality")
    world.engine.annotate("stream a contains altitude(UAV) = spd [ft] for every UAV = id")
    assert world.state(best) == "waiting"
    cheap = world.subscribe("cooked", strategy="cost")
    assert world.state(cheap) == "waiting"


# -- better streams ------------------------------------------------------------------------------


def test_a_better_stream_that_stays_is_taken_after_the_hold_off(world):
    world.declare("a", meaning=OF_ALL)
    world.engine.set_quality("a", 0.5)
    id = world.subscribe(strategy="quality", hold_off=3)
    world.run(0, 2, 1, "a")
    world.declare("b", meaning=OF_ALL)
    world.say("b", 1.5)
    for time in (2, 3, 4):
        world.tick(time)
        world.say("a", time)
        world.say("b", time + 0.499, 100 + time)
    assert world.path(id) == ["a"]
    world.say("b", 4.5, 105)
    assert world.switches(id)[-1] == (4.5, "a better source appeared", ("a",), ("b",))
    assert world.values(id) == [0, 1, 2, 3, 4, 104, 105]
    assert world.mirrored(id) == ["b"]


def test_a_better_stream_that_vanishes_within_the_hold_off(world):
    world.declare("a", meaning=OF_ALL)
    world.engine.set_quality("a", 0.5)
    id = world.subscribe(strategy="quality", hold_off=3)
    world.run(0, 2, 1, "a")
    for vanish in (world.engine.remove_stream, world.engine.end):
        world.declare("b", meaning=OF_ALL)
        world.say("b", 2)
        world.run(2, 4, 1, "a", "b")
        vanish("b")
        world.run(4, 10, 1, "a")
    assert world.path(id) == ["a"]
    assert len(world.status("inputs changed")) == 1


def test_a_better_stream_that_flaps_is_not_taken_until_it_stays(world):
    world.declare("a", "b", meaning=OF_ALL)
    world.engine.set_quality("a", 0.5)
    world.engine.set_quality("b", 0.4)
    id = world.subscribe(strategy="quality", hold_off=3)
    world.run(0, 2, 1, "a", "b")
    for time in range(2, 20, 2):
        world.engine.set_quality("b", 0.9)
        world.run(time, time + 1, 1, "a", "b")
        world.engine.set_quality("b", 0.3)
        world.run(time + 1, time + 2, 1, "a", "b")
    assert world.path(id) == ["a"]
    world.engine.set_quality("b", 0.9)
    world.run(20, 30, 1, "a", "b")
    assert world.path(id) == ["a", "b"]


def test_the_lost_one_is_taken_back_when_it_stays(world):
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe(staleness=2, hold_off=3)
    world.run(0, 5, 1, "a", "b")
    world.run(5, 8, 1, "b")
    assert world.path(id) == ["a", "b"]
    world.run(8, 10, 1, "a", "b")
    world.run(10, 14, 1, "b")
    assert world.path(id) == ["a", "b"]
    world.run(14, 20, 1, "a", "b")
    assert world.path(id) == ["a", "b", "a"]
    assert world.values(id) == list(range(20))


def test_what_had_ended_has_not_been_there(world):
    world.declare("a", "b", meaning=OF_ALL)
    world.engine.set_quality("a", 0.5)
    world.engine.set_quality("b", 0.1)
    id = world.subscribe(strategy="quality", hold_off=3)
    world.run(0, 2, 1, "a", "b")
    world.engine.end("b")
    world.engine.set_quality("b", 0.9)
    world.run(2, 10, 1, "a")
    world.say("b", 10)
    assert world.path(id) == ["a"]
    world.say("b", 13)
    assert world.path(id) == ["a", "b"]


def test_another_that_flaps_does_not_keep_a_better_one_away(world):
    world.declare("a", "c", meaning=OF_ALL)
    world.engine.set_quality("a", 0.5)
    world.engine.set_quality("c", 0.1)
    id = world.subscribe(strategy="quality")
    world.run(0, 2, 1, "a", "c")
    world.declare("b", meaning=OF_ALL)
    for time in range(2, 8):
        world.run(time, time + 1, 1, "a", "b", "c")
        world.engine.set_quality("c", 0.1 + 0.1 * (time % 2))
    assert world.path(id) == ["a", "b"]


def test_what_has_never_spoken_is_not_better_yet(world):
    """Who only declares a stream takes nobody away from one that speaks."""
    world.declare("a", meaning=OF_ALL)
    world.engine.set_quality("a", 0.5)
    id = world.subscribe(strategy="quality")
    world.run(0, 2, 1, "a")
    world.declare("b", meaning=OF_ALL)
    world.run(2, 10, 1, "a")
    assert world.path(id) == ["a"]
    world.run(10, 15, 1, "a", "b")
    assert world.path(id) == ["a", "b"]
    assert world.values(id) == list(range(15))


# -- waiting -------------------------------------------------------------------------------------


def test_what_cannot_be_met_waits_and_starts(world):
    id = world.subscribe()
    assert (world.state(id), world.reads(id)) == ("waiting", ())
    assert world.view(id).missing != ()
    world.declare("a", meaning=OF_CARS)
    assert world.state(id) == "waiting"
    world.declare("b", meaning=OF_ALL)
    assert (world.state(id), world.reads(id), world.view(id).missing) == ("running", ("b",), ())
    world.say("b", 1)
    assert world.values(id) == [1]
    assert world.mirrored(id) == ["b"]


def test_nothing_is_told_while_it_goes_on_waiting(world):
    """Streams come that might help and do not: nothing has been switched."""
    id = world.subscribe()
    told = len(world.status("inputs changed"))
    for name in ("p", "q"):
        world.declare(
            name, meaning="stream {} contains latitude(UAV) = spd [deg] for every UAV = id"
        )
    world.run(0, 5, 1, "p", "q")
    assert world.state(id) == "waiting"
    assert len(world.switches(id)) == 1
    assert len(world.status("inputs changed")) == told


def test_since_now_a_waiting_one_begins_with_what_comes(world):
    world.declare("a")
    world.run(0, 3, 1, "a")
    id = world.subscribe()
    world.engine.annotate(OF_ALL.format("a"))
    assert world.values(id) == []
    world.say("a", 3)
    assert world.values(id) == [3]


def test_since_start_a_waiting_one_begins_with_the_past(world):
    world.declare("a")
    world.run(0, 3, 1, "a")
    id = world.subscribe(since=Since.START)
    world.engine.annotate(OF_ALL.format("a"))
    world.say("a", 3)
    assert world.values(id) == [0, 1, 2, 3]


def test_since_now_the_past_of_another_is_not_told_either(world):
    """Nothing was delivered yet, and the second source remembers what the first did, too."""
    world.declare("a", "b", meaning=OF_ALL)
    world.run(0, 5, 1, "a", "b")
    id = world.subscribe()
    world.engine.end("a")
    world.say("b", 5)
    assert world.values(id) == [5]


def test_since_start_goes_on_with_the_other(world):
    world.declare("a", "b", meaning=OF_ALL)
    for time in range(6):
        world.say("b", time, 100 + time, own=time)
        if time < 3:
            world.say("a", time, time, own=time)
    id = world.subscribe(since=Since.START)
    world.engine.end("a")
    assert world.values(id) == [0, 1, 2, 103, 104, 105]


# -- parts ---------------------------------------------------------------------------------------


def test_a_supply_of_parts_grows_and_shrinks(world):
    world.engine.load_ontology(
        "@prefix d: <http://www.ida.liu.se/dyknow/> . d:uav1 a d:UAV . d:uav2 a d:UAV .",
        name="http://x/y",
    )
    world.declare("one", meaning=OF_UAV1)
    id = world.subscribe()
    world.run(0, 2, 1, "one")
    world.declare("two", meaning=UAV2)
    world.run(2, 8, 1, "one", "two")
    assert world.reads(id) == ("one", "two")
    assert world.mirrored(id) == ["one", "two"]
    world.engine.end("one")
    assert world.reads(id) == ("two",)
    world.run(8, 12, 1, "two")
    world.run(12, 20, 1, "one", "two")
    assert world.reads(id) == ("one", "two")
    received = world.received(id)
    assert [t for t, who, _ in received if who == "uav1"] == [*range(8), *range(12, 20)]
    assert len(received) == len(set(received))
    world.engine.end("two")
    assert world.reads(id) == ("one",)
    world.declare("all", meaning=OF_ALL)
    world.run(20, 25, 1, "one", "all")
    assert world.reads(id) == ("all",)


def test_only_a_part_falls_silent(world):
    world.engine.load_ontology(
        "@prefix d: <http://www.ida.liu.se/dyknow/> . d:uav1 a d:UAV . d:uav2 a d:UAV .",
        name="http://x/y",
    )
    world.declare("one", meaning=OF_UAV1)
    world.declare("two", meaning=UAV2)
    id = world.subscribe(staleness=2)
    world.run(0, 4, 1, "one", "two")
    world.run(4, 10, 1, "two")
    assert world.reads(id) == ("two",)
    world.run(10, 20, 1, "one", "two")
    assert world.reads(id) == ("one", "two")
    received = world.received(id)
    assert [t for t, who, _ in received if who == "uav2"] == list(range(20))
    assert [t for t, who, _ in received if who == "uav1"] == [*range(4), *range(10, 20)]


# -- how it is delivered -------------------------------------------------------------------------


def test_units_are_converted_at_the_switch(world):
    world.declare("a", meaning=IN_METRES)
    world.declare("b", meaning=OF_ALL)
    id = world.subscribe()
    world.say("a", 1, 10)
    world.say("b", 2, 36)
    world.engine.end("a")
    world.say("b", 3, 72)
    assert world.values(id) == pytest.approx([36, 36, 72])


def test_one_object_is_selected(world):
    world.engine.load_ontology(
        "@prefix d: <http://www.ida.liu.se/dyknow/> . d:uav1 a d:UAV .", name="http://x/y"
    )
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe(objects=["uav1"])
    for time in range(3):
        world.say_all("a", time, [("uav1", time), ("uav2", -1)])
    for time in range(2, 6):
        world.say_all("b", time, [("uav2", -1), ("uav1", time)])
    world.engine.end("a")
    world.say_all("b", 6, [("uav1", 6), ("uav2", -1)])
    assert [(who, value) for _, who, value in world.received(id)] == [
        ("uav1", value) for value in (0, 1, 2, 3, 4, 5, 6)
    ]
    assert len(world.ask("?x :instantiationOf :selectObject")) == 1


def test_a_policy_holds_over_a_switch(world):
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe(policy="any change, strict order")
    for time in range(5):
        world.say("b", time, own=time)
        if time < 3:
            world.say("a", time, own=time)
    world.engine.end("a")
    world.say("b", 5, own=5)
    assert world.values(id) == [0, 1, 2, 3, 4, 5]
    assert world.engine.rematches(id)[-1].position == 3


def test_two_subscriptions_one_affected(world):
    world.declare("a", "b", meaning=OF_ALL)
    world.declare("c", meaning=ALTITUDE)
    world.declare("d", meaning=ALTITUDE)
    speed = world.subscribe()
    altitude = world.subscribe("altitude")
    world.run(0, 2, 1, "a", "b", "c", "d")
    world.engine.end("a")
    assert world.path(speed) == ["a", "b"]
    assert world.path(altitude) == ["c"]


def test_of_a_thousand_only_the_affected_are_matched_again(world, monkeypatch):
    names = [f"uav{k}" for k in range(1000)]
    text = (f"stream s_{name} contains speed({name}) = spd [km.h-1]" for name in names)
    world.engine.annotate("\n".join(text))
    ids = [world.subscribe(objects=[name]) for name in names]
    plans, matched = world.engine._parts.plans, []
    match = plans.match

    def counted(wants, *rest, **options):
        matched.extend(wants)
        return match(wants, *rest, **options)

    monkeypatch.setattr(plans, "match", counted)
    for name in names[:50]:
        generator = world.engine.generator(f"s_{name}")
        assert generator.subscribers == 1
        world.tick(1)
    assert matched == []
    world.engine.annotate("stream better contains speed(uav7) = spd [km.h-1]")
    assert matched == []
    world.engine.end("s_uav7")
    assert {want.object.split("/")[-1] for want in matched} == {"uav7"}
    assert len(matched) <= 3
    assert world.path(ids[7]) == ["s_uav7", "better"]
    matched.clear()
    world.engine.remove_stream("s_uav8")
    world.engine.set_quality("s_uav9", 0.1)
    assert {want.object.split("/")[-1] for want in matched} == {"uav8"}


# -- leaving -------------------------------------------------------------------------------------


def _stages(kitchen):
    world = kitchen.world("first", "second")
    world.declare("a", "b", meaning=RAW)
    world.run(0, 2, 1, "a", "b")
    return world


@pytest.mark.parametrize("stage", range(7))
@pytest.mark.parametrize("policy", ["", "any change"])
def test_nothing_is_left_behind(kitchen, stage, policy):
    """Whenever one leaves: before anything came, while it is running, switched, silent, waiting."""
    world = _stages(kitchen)
    world.tick(3)  # the subscribers are counted
    before = world.everything()
    id = world.subscribe("cooked", policy=policy, since=Since.START if stage % 2 else Since.NOW)
    steps = [
        lambda: None,
        lambda: world.run(3, 10, 1, "a"),
        lambda: kitchen.does.update(first=explode),
        lambda: world.run(10, 12, 1, "a"),
        lambda: world.run(12, 30, 1),
        lambda: world.run(30, 33, 1, "b"),
        lambda: world.run(33, 80, 1),
    ]
    for step in steps[: stage + 1]:
        step()
    world.engine.unsubscribe(id)
    world.tick(90)
    after = world.everything()
    assert after[0] == before[0]
    assert after[1] == before[1]
    counts = {triple for triple in before[2] ^ after[2] if "SubscriberCount" in str(triple)}
    assert before[2] ^ after[2] == counts


def test_nothing_is_remembered_of_those_who_left(world):
    """However many come and go, and however much their sources flap."""
    world.declare("a", "b", meaning=OF_ALL)
    world.run(0, 1, 1, "a", "b")
    rematching = world.engine._parts.rematching
    kept = [world.subscribe(staleness=1000) for _ in range(3)]
    for time in range(1, 200):
        world.tick(time)
        id = world.subscribe(staleness=1000, hold_off=1000)
        world.say("a", time)
        world.engine.end("a")
        world.say("a", time)
        world.engine.unsubscribe(id)
    for id in kept:
        world.engine.unsubscribe(id)
    world.run(200, 400, 1, "b")
    sizes = {
        name: len(value)
        for name, value in vars(rematching).items()
        if isinstance(value, dict | list | set)
    }
    assert sizes == dict.fromkeys(sizes, 0)


def test_what_is_removed_is_forgotten_with_no_subscription_there(world):
    world.declare("a", meaning=OF_ALL)
    id = world.subscribe()
    world.run(0, 10, 0.1, "a")
    world.engine.unsubscribe(id)
    world.engine.remove_stream("a")
    silences = world.engine._parts.rematching._silences
    assert not silences.has_arrivals("a")
    assert not list(silences.take_all_back())
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe()
    world.tick(12)
    assert world.reads(id) == ("a",)
    assert world.state(id) == "running"


class Watcher:
    """Whoever reads the status stream, and asks what the subscription reads while it is told."""

    knows_codes = False

    def __init__(self, world, id):
        self.world, self.id, self.seen = world, id, []

    def receive(self, source, batch):
        for _, _, values in batch.rows():
            if values["change"] == "inputs changed":
                self.seen.append((values["inputs"], self.world.reads(self.id)))

    def advance(self, source, watermark):
        pass


def test_who_reads_the_status_during_a_switch_sees_it_done(world):
    world.declare("a", "b", meaning=OF_ALL)
    id = world.subscribe()
    watcher = Watcher(world, id)
    world.engine.generator("status").subscribe(watcher)
    world.say("a", 1)
    world.engine.end("a")
    world.engine.remove_stream("b")
    assert watcher.seen == [("b", ("b",)), ("a", ("a",))]
    assert [each["inputs"] for each in world.status("inputs changed")] == ["a", "b", "a"]


def test_a_transformation_that_flaps_is_remembered_once(kitchen):
    world = kitchen.world("first", "second")
    world.declare("a", meaning=RAW)
    world.engine.transformations.change("first", quality=0.5)
    world.engine.transformations.change("second", quality=0.1)
    id = world.subscribe("cooked", strategy="quality", hold_off=100)
    for time in range(50):
        world.engine.transformations.change("second", quality=0.9 if time % 2 else 0.1)
        world.run(time, time + 1, 1, "a")
    assert len(world.engine._parts.rematching._alarms._alarms) < 5
    assert world.values(id) == [1000 + time for time in range(50)]


def test_a_text_feature(world):
    fields = (Field("id", FieldType.STRING), Field("call", FieldType.STRING))
    text = "stream {} contains callsign(UAV) = call for every UAV = id"
    world.declare("a", "b", meaning=text, fields=fields)
    id = world.subscribe("callsign")
    world.say("a", 1, "SAS1", field="call")
    world.engine.end("a")
    world.say("b", 2, "SAS2", field="call")
    assert world.values(id) == ["SAS1", "SAS2"]


def test_a_feature_without_a_range(world):
    world.declare("a", meaning="stream {} contains position(UAV) = spd for every UAV = id")
    id = world.subscribe("position")
    world.say("a", 1)
    assert world.view(id).failure is None
    assert world.values(id) == ["1.0"]
    made = world.engine.generator(world.engine.subscription(id).stream)
    assert "1.0" in world.engine.rdf_of(made.name, made.stream.all())[0]
