"""Adaptive subscriptions against their definition: which source is read when, and what the client
receives, over random histories of streams that pause, end, come back, and change their meaning
([Introspection15 §4.4], SPEC §7)."""

from adapting_world import OF_ALL, OF_UAV1, World, ns
from adaptive_definition import FAST, QUALITY, Subscription
from hypothesis import given, note, settings
from hypothesis import strategies as st

from dyknow.engine.model.views import Since

LAWS = settings(deadline=None, max_examples=80)
NAMES = ("a", "b", "c", "d")
UNITS = {"km.h-1": 1.0, "m.s-1": 3.6}


class History:
    """The same events told to an engine and to the definition.

    ``kind`` is what the streams hold: speeds of one object, or of every UAV. ``cuts``: every
    sample of a batch is published by itself.
    """

    def __init__(self, kind, strategy, bound, staleness, hold_off, since, cuts=False):
        self.world = World()
        self.text = OF_UAV1 if kind == "object" else OF_ALL
        self.cuts = cuts
        self.now = 0
        self.value = 0
        self.options = {
            "strategy": strategy,
            "quality": bound,
            "staleness": staleness,
            "hold_off": hold_off,
            "since": since,
        }
        if kind == "object":
            self.options["objects"] = ["uav1"]
        self.definition = Subscription(
            strategy,
            bound,
            None if staleness is None else ns(staleness),
            ns(hold_off),
            since is Since.START,
        )
        self.id = None

    def tell(self, event):
        kind, *rest = event
        getattr(self, f"_{kind}")(*rest)

    def _declare(self, name, quality):
        if name in self.definition.sources:
            return
        self.world.declare(name)
        self.definition.add(name)
        # The quality first: nobody is told of it while it means nothing.
        self._rate(name, quality)

    def _subscribe(self):
        self.id = self.world.subscribe(**self.options)
        self.definition.subscribe()

    def _wait(self, gap):
        self.now += ns(gap)

    def _tick(self, gap):
        self._wait(gap)
        self.world.engine.tick(self.now)
        self.definition.tick(self.now)

    def _say(self, name, count, own):
        """``own``: None, or the seconds by which what it says of itself is off."""
        if name not in self.definition.sources:
            return
        generator = self.world.engine.generator(name)
        before = generator.stream.last_number
        said = [("uav1" if self.value % 3 else "uav2", self.value + k) for k in range(count)]
        if self.text is OF_UAV1:
            said = [("uav1", value) for _, value in said]
        self.value += count
        at = self.now / 10**9
        for k, batch in enumerate([[one] for one in said] if self.cuts else [said]):
            # Samples of a batch are a nanosecond apart.
            offset = None if own is None else at + own + (k * 1e-9 if self.cuts else 0)
            self.world.say_all(name, at, batch, own=offset)
            samples = [
                (available, values["spd"])
                for segment in generator.stream.since(before + 1)
                for available, _, values in segment.batch.rows()
            ]
            before = generator.stream.last_number
            if self.id is None:
                self.definition.overhear(name, self.now, samples)
            else:
                self.definition.publish(name, self.now, samples)

    def _end(self, name):
        if name in self.definition.sources:
            self.world.engine.end(name)
            self.definition.end(name)

    def _remove(self, name):
        if name in self.definition.sources:
            self.world.engine.remove_stream(name)
            self.definition.remove(name)

    def _mean(self, name, unit):
        if name not in self.definition.sources:
            return
        if unit is None:
            text = self.text.replace("speed", "altitude").replace("km.h-1", "ft")
        else:
            text = self.text.replace("km.h-1", unit)
        self.world.engine.annotate(text.format(name))
        factor = None if unit is None else UNITS[unit]
        if self.id is None:
            self.definition.sources[name].factor = factor
        else:
            self.definition.annotate(name, factor)

    def _rate(self, name, quality):
        if name not in self.definition.sources:
            return
        # No two are as good as each other: which of them is taken then is nobody's promise.
        exact = quality + NAMES.index(name) / 100
        self.world.engine.set_quality(name, exact)
        if self.id is None:
            self.definition.sources[name].quality = exact
        else:
            self.definition.rate(name, exact)

    @property
    def told(self):
        reads = [(round(when * 10**9), after) for when, _, _, after in self.world.switches(self.id)]
        return reads, self.world.state(self.id), self.world.values(self.id)

    @property
    def defined(self):
        path = [(when, () if name is None else (name,)) for when, name in self.definition.path]
        return path, self.definition.state, self.definition.received


GAPS = st.sampled_from([0, 0.1, 0.5, 1, 1, 1, 2, 3, 7, 30])
QUALITIES = st.sampled_from([0.1, 0.3, 0.5, 0.8])


def events(names, offsets):
    name = st.sampled_from(names)
    one = st.one_of(
        st.tuples(st.just("tick"), GAPS),
        st.tuples(st.just("say"), name, st.integers(1, 3), offsets),
        st.tuples(st.just("end"), name),
        st.tuples(st.just("remove"), name),
        st.tuples(st.just("declare"), name, QUALITIES),
        st.tuples(st.just("mean"), name, st.sampled_from([None, *UNITS])),
        st.tuples(st.just("rate"), name, QUALITIES),
    )
    return st.lists(
        st.one_of(one.map(lambda event: [event]), goings_on(names, offsets)), max_size=25
    ).map(lambda parts: [event for part in parts for event in part])


@st.composite
def goings_on(draw, names, offsets):
    """Streams just go on, so that there is something to learn; then one of them may fall behind,
    and be lost."""
    gap, own = draw(st.sampled_from([0.2, 1, 2])), draw(offsets)
    speakers = draw(st.lists(st.sampled_from(names), unique=True, max_size=3))

    sizes = {name: draw(st.integers(1, 2)) for name in speakers}

    def turns(count, speakers):
        said = [("say", name, sizes[name], own) for name in speakers]
        return [("tick", gap), *said] * count

    if not speakers or draw(st.booleans()):
        return turns(8, speakers)
    lost, *others = speakers
    ends = [("end", lost), ("remove", lost), ("mean", lost, None), ("rate", lost, 0.1)]
    loss = draw(st.sampled_from([*ends, ("tick", 2 * gap), ("tick", 4 * gap)]))
    return [*turns(8, speakers), *turns(draw(st.integers(1, 6)), others), loss]


@st.composite
def histories(draw, offsets):
    """What the subscription is, and everything that happens, the subscribing among it."""
    names = NAMES[: draw(st.integers(2, 4))]
    subscription = {
        "kind": draw(st.sampled_from(["object", "sort"])),
        "strategy": draw(st.sampled_from([FAST, QUALITY])),
        "bound": draw(st.sampled_from([0, 0, 0.25, 0.4])),
        "staleness": draw(st.sampled_from([None, None, 1, 2.5])),
        "hold_off": draw(st.sampled_from([0, 1, 2, 5])),
        "since": draw(st.sampled_from(list(Since))),
    }
    begin = []
    for name in names:
        begin.append(("declare", name, draw(QUALITIES)))
        begin.append(("mean", name, draw(st.sampled_from([None, *UNITS, *UNITS]))))
    before = draw(st.lists(events(names, offsets), max_size=1))
    after = draw(events(names, offsets))
    return subscription, begin, [event for part in before for event in part], after


def played(history, **options):
    note(repr(history))
    subscription, begin, before, after = history
    played = History(**subscription, **options)
    for event in (*begin, *before, ("subscribe",), *after):
        played.tell(event)
    return played


# Streams bring times of their own kind, or are stamped; one that is both is refused.
STAMPED = st.none()
OWN = st.sampled_from([-31_536_000, -3, -0.5, 0, 0.25])


@LAWS
@given(histories(STAMPED))
def test_streams_that_are_stamped(history):
    found = played(history)
    assert found.told == found.defined


@LAWS
@given(histories(OWN))
def test_streams_that_bring_their_own_times(history):
    """What is available when is for each to say: some are behind, some are of another year."""
    found = played(history)
    assert found.told == found.defined


@LAWS
@given(histories(st.just(0)))
def test_batch_cuts_change_nothing(history):
    whole, cut = played(history), played(history, cuts=True)
    assert cut.told == whole.told
    assert cut.told == cut.defined
