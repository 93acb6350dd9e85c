"""Laws of applied specifications: what is inserted and removed leaves nothing behind, the running
configuration as a text gives itself again, and a text that is refused changes nothing."""

import re
from collections import Counter

from hypothesis import example, given, settings
from hypothesis import strategies as st
from specifying import state, text

from dyknow.engine.engine import Engine
from dyknow.engine.processes.registry import Processes
from dyknow.languages.errors import LanguageError
from dyknow.languages.specification import (
    StreamReference,
    UnitSpecification,
    parse_specification,
)
from dyknow.languages.specification.ast import elements_of, is_reserved
from dyknow.languages.specification.batches import Bounds, parts_of

LIMITS = settings(deadline=None, max_examples=40)
ANNOTATIONS = """
stream s contains speed(UAV) = v, heading(UAV) = h for every UAV = id
stream t contains speed(UAV) = v for every UAV = id
source gauge provides v:speed
compunit fast transforms v:speed to v:speed
compunit slow transforms v:speed to w:speed
compunit mix transforms a:speed, b:speed to v:speed
"""
PROCESSES = Processes()
PROCESSES.sampled("float", "1s", name="gauge")(lambda time: 1.0)
for name, inputs in (("slow", 1), ("mix", 2)):
    PROCESSES.computational_unit("float", ["float"] * inputs, name=name)(
        lambda time, samples, state: (samples[0].value, state)
    )


@PROCESSES.computational_unit("float", ["float"])
def fast(time, samples, state, *, by=1.0):
    return samples[0].value * by, state


def fresh():
    engine = Engine(epoch="law", processes=PROCESSES)
    engine.annotate(ANNOTATIONS)
    return engine


NAMES = ["a", "b", "c", "dyknow_reserved1", "dyknow_reserved2"]
streams = st.sampled_from(["s", "t"] * 3 + NAMES).map(lambda name: f'<stream name="{name}"/>')
parameters = {
    "fast": st.sampled_from(["", "1.0", "2"]).map(
        lambda by: f'<parameter name="by" value="{by}"/>' if by else ""
    ),
    "policy": st.sampled_from(["any change", "strict order"]).map(
        lambda policy: f'<parameter name="policy" value="{policy}"/>'
    ),
    "selectObject": st.just(
        '<parameter name="field" value="id"/><parameter name="object" value="uav1"/>'
    ),
}
SOMETIMES = st.sampled_from(["", "", *(f' name="{name}"' for name in NAMES)])


def unit(inner):
    def of(type, takes):
        given = parameters.get(type, st.just(""))
        inputs = st.lists(inner, min_size=takes, max_size=takes).map("".join)
        return st.builds(
            lambda name, given, inputs: f'<cu{name} type="{type}">{given}{inputs}</cu>',
            SOMETIMES, given, inputs,
        )  # fmt: skip

    kinds = [("gauge", 0), ("fast", 1), ("slow", 1), ("mix", 2), ("policy", 1)]
    return st.one_of(
        *(of(type, takes) for type, takes in kinds), of("selectObject", 1), of("synchronize", 2)
    )


insertions = st.lists(
    st.recursive(unit(streams), lambda inner: unit(inner | streams), max_leaves=6), max_size=3
).map("".join)
OBJECT = """<parameter name="field" value="id"/><parameter name="object" value="uav1"/>
<stream name="t"/>"""
removals = st.lists(
    st.sampled_from(
        [f'<cu name="{name}"/>' for name in NAMES]
        + [f'<cu type="{type}"/>' for type in ("fast", "slow", "mix", "policy", "gauge")]
    ),
    max_size=2,
    unique=True,
).map("".join)
texts = st.lists(st.builds(text, insertions, removals), min_size=1, max_size=5)


def attempt(engine, given):
    """Apply it, if it is not refused; what is refused changes nothing."""
    before = state(engine)
    try:
        engine.apply_specification(given)
    except LanguageError:
        assert state(engine) == before
        return False
    return True


def played(given):
    """An engine to which all texts were given that it takes, and how many it took."""
    engine = fresh()
    taken = sum([attempt(engine, one) for one in given])
    assert engine.ontology.validate().conforms
    return engine, taken


def canonical(given):
    """What a text inserts, with invented names numbered as they come."""
    numbers = {}

    def named(name):
        if name is None or not name.startswith("dyknow_reserved"):
            return name
        return f"#{numbers.setdefault(name, len(numbers))}"

    def renamed(one):
        if isinstance(one, StreamReference):
            return StreamReference(named(one.name), one.span)
        inputs = tuple(map(renamed, one.inputs))
        return UnitSpecification(one.type, named(one.name), one.parameters, inputs, one.span)

    return tuple(map(renamed, parse_specification(given).insertions))


def meaning(given):
    """What a text makes, and what it calls so, in whatever order it says it."""
    found = parse_specification(given).insertions
    named = {one.name: one for one in elements_of(found) if one.name}

    def written(one):
        if isinstance(one, StreamReference):
            return written(named[one.name]) if one.name in named else one.name
        return one.type, one.parameters, tuple(map(written, one.inputs))

    names = {name: written(one) for name, one in named.items() if not is_reserved(name)}
    return names, {written(one) for one in elements_of(found)}


def inserted(view):
    return None if is_reserved(view.name or "") else view.name, view.transformation


def without_users(seen):
    streams, units, *others = seen
    return (streams, [unit[:-1] for unit in units], *others)


def remove_all(engine):
    kinds = dict.fromkeys(view.transformation for view in engine.insertions())
    behind = [unit.transformation for unit in engine._parts.configuration.units.values()]
    wanted = {*kinds, *behind}
    if "synchronize" in wanted and not re.search(
        'type="synchronize"', engine.current_specification()
    ):
        wanted.remove("synchronize")
    if wanted:
        engine.apply_specification(text("", "".join(f'<cu type="{t}"/>' for t in sorted(wanted))))


@LIMITS
@given(texts)
def test_what_is_removed_leaves_nothing_behind(given):
    engine, _ = played(given)
    nothing = without_users(state(fresh()))
    remove_all(engine)
    # But for what was told.
    assert without_users(state(engine))[:-1] == nothing[:-1]
    assert engine._parts.configuration._shared == {}
    assert not engine._parts.plans.streams


GAUGE_TWICE = text(
    '<cu type="slow"><cu name="a" type="gauge"/></cu><cu name="b" type="gauge"/>', ""
)
GAUGE_READ_BY_ITS_SECOND_NAME = text(
    '<cu type="fast"><stream name="a"/></cu><cu name="b" type="gauge"/><cu name="a" type="gauge"/>',
    "",
)
OBJECT_TWICE = text(
    f"""<cu name="dyknow_reserved1" type="selectObject">{OBJECT}</cu>
    <cu type="fast"><cu name="a" type="selectObject">{OBJECT}</cu></cu>
    <cu name="b" type="selectObject">{OBJECT}</cu>""",
    "",
)


@LIMITS
@given(texts)
@example([GAUGE_TWICE])
@example([GAUGE_READ_BY_ITS_SECOND_NAME])
def test_the_running_configuration_gives_itself_again(given):
    engine, _ = played(given)
    current = engine.current_specification()
    before = without_users(state(engine))
    engine.apply_specification(current)
    after = without_users(state(engine))
    # What had two names, and stood in another unit, stands by itself now; nothing runs otherwise.
    assert (after[:4], after[6:]) == (before[:4], before[6:])
    other = fresh()
    other.apply_specification(current)
    assert canonical(other.current_specification()) == canonical(current)


SHARED = "".join(
    f'''<cu name="{name}" type="slow"><stream name="dyknow_reserved1"/></cu>''' for name in "abc"
)
SHARED_AND_INVENTED = text(
    SHARED
    + """<cu name="dyknow_reserved1" type="fast"><cu name="dyknow_reserved2"
    type="gauge"/></cu><cu type="slow"><stream name="dyknow_reserved2"/></cu>""",
    "",
)


@LIMITS
@given(texts, st.integers(1, 6))
@example([SHARED_AND_INVENTED], 3)
@example([GAUGE_TWICE], 2)
@example([GAUGE_READ_BY_ITS_SECOND_NAME], 1)
def test_parts_give_the_same_configuration(given, most):
    """Each part is within its bounds, unless there are no such parts."""
    engine, _ = played(given)
    current = engine.current_specification()
    whole, other = fresh(), fresh()
    whole.apply_specification(current)
    parts = parts_of(parse_specification(current), Bounds(most, 10 * most, 10_000))
    if parts is None:
        return
    for part in parts:
        assert part.count("<spec:cu") <= most
        other.apply_specification(part)
    assert meaning(other.current_specification()) == meaning(current)
    assert len(other._parts.configuration.units) == len(whole._parts.configuration.units)
    assert Counter(map(inserted, other.insertions())) == Counter(map(inserted, whole.insertions()))


def test_most_texts_have_parts():
    engine, _ = played([SHARED_AND_INVENTED])
    found = parse_specification(engine.current_specification())
    assert len(parts_of(found, Bounds(3, 100, 10_000))) > 1
    # What is invented is written again where another part reads it, and there is no room for it.
    assert parts_of(found, Bounds(2, 100, 10_000)) is None
    removing = parse_specification(text("", '<cu type="gauge"/>'))
    assert parts_of(removing, Bounds(100, 100, 10_000)) is None


@LIMITS
@given(texts)
@example([GAUGE_TWICE])
@example([OBJECT_TWICE, text("", '<cu name="a"/>')])
def test_what_is_kept_gives_the_same_insertions(given):
    engine, _ = played(given)
    kept = engine.ontology.registered.specifications()
    other = fresh()
    if kept:
        other.apply_specification(kept)
    assert other.ontology.registered.specifications() == kept
    assert canonical(other.current_specification()) == canonical(engine.current_specification())
    assert len(other.insertions()) == len(engine.insertions())


@LIMITS
@given(texts)
def test_everybody_is_counted(given):
    """A unit has as many users as insertions hold it and units read it."""
    engine, _ = played(given)
    units = engine._parts.configuration.units.values()
    for unit in units:
        held = sum(one.unit is unit for one in engine._parts.specifications._insertions.all)
        read = sum(reader.inputs.count(unit.output) for reader in units)
        assert unit.users == held + read > 0


def test_texts_are_taken_and_refused():
    """The strategy is of use: some of what it draws is taken, and some is not."""
    taken, all = [], []

    @settings(deadline=None, max_examples=40, database=None)
    @given(texts)
    def count(given):
        _, number = played(given)
        taken.append(number)
        all.append(len(given))

    count()
    assert 0 < sum(taken) < sum(all)
