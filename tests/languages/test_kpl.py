"""KPL: what a specification says, and what stands on it ([DyKnow10 §4.3, §5.2], SPEC §1)."""

import os
from pathlib import Path

import pytest
from places import TESTS
from vocabularies import vocabulary_of

from dyknow.languages.errors import LanguageError
from dyknow.languages.kpl import (
    Aggregate,
    CheckedDeclaration,
    CompunitDeclaration,
    Compute,
    ForeachDeclaration,
    FromSource,
    GeneratorDeclaration,
    JoinOf,
    Label,
    Select,
    SelectObject,
    Signature,
    SinkDeclaration,
    SourceDeclaration,
    StreamDeclaration,
    Synchronize,
    Term,
    ValueSort,
    check_kpl,
    format_kpl,
    format_policy,
    instantiate,
    parse_kpl,
    parse_label,
    parse_policy,
)
from dyknow.rdf.namespaces import DYKNOW
from dyknow.streams.policies.policy import (
    AnyChange,
    AnyUpdate,
    Approximation,
    Duration,
    Order,
    Policy,
    SampleEvery,
    SynchronizationPolicy,
)
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import MILLISECOND, SECOND, TIME_MAX, TIME_MIN

EXAMPLE = """
source pos pos_car1
strmgen pos[car1] = pos_car1
compunit speed SpeedEst(pos)
strmgen speed[car1] = SpeedEst(pos[car1] with sample every 200)
stream speed_car1 = speed[car1] with from 300 to 400
"""
CARS = """
source object cars_in_sight
strmgen cars = cars_in_sight
source pos everything
strmgen positions = everything
compunit speed SpeedEst(pos)
foreach car in cars with any change {
  strmgen pos[car] = selectObject(positions)
  strmgen speed[car] = SpeedEst(pos[car] with any change)
}
strmgen speeds = aggregate(speed[car] foreach car in cars)
sink Log(speeds)
"""
CASES = TESTS / "cases" / "kpl_dynamic"
POS, SPEED = ValueSort("pos", None), ValueSort("speed", None)


def signature(text: str, before: Signature | None = None) -> Signature:
    return check_kpl(parse_kpl(text), text, None, before or Signature())[1]


def refusal(text: str, before: Signature | None = None) -> LanguageError:
    with pytest.raises(LanguageError) as caught:
        signature(text, before)
    return caught.value


def test_example_5_5() -> None:
    pos, speed = Label("pos", ("car1",)), Label("speed", ("car1",))
    every = Policy(SampleEvery(200 * MILLISECOND))
    between = Policy(duration=Duration(300 * MILLISECOND, 400 * MILLISECOND))
    assert signature(EXAMPLE).declarations == (
        SourceDeclaration("pos_car1", POS),
        GeneratorDeclaration(pos, POS, FromSource("pos_car1")),
        CompunitDeclaration("SpeedEst", SPEED, (POS,)),
        GeneratorDeclaration(speed, SPEED, Compute("SpeedEst", (Term(pos, every),))),
        StreamDeclaration("speed_car1", SPEED, Term(speed, between)),
    )


def test_the_text_says_its_unit_before_the_caller_does() -> None:
    text = "source a s\nstrmgen a = s\nstream x = a with max delay 5"
    for head, unit, delay in (("", "s", 5 * SECOND), ("unit us\n", "s", 5000), ("", "ns", 5)):
        (*_, stream), _ = check_kpl(parse_kpl(head + text), head + text, unit=unit)
        assert isinstance(stream, StreamDeclaration)
        assert stream.term.policy == Policy(max_delay=delay)


def test_synchronization_in_the_notation_of_the_definition() -> None:
    text = """
    source float s1 source float s2 strmgen f1 = s1 strmgen f2 = s2
    strmgen state = sync(f1, f2; sample every 100, max delay 50, use most recent, from 0 to oo)
    """
    generator = signature(text).generator("state")
    assert generator is not None
    assert generator.process == Synchronize(
        (Term(Label("f1"), Policy()), Term(Label("f2"), Policy())),
        SynchronizationPolicy(
            SampleEvery(100 * MILLISECOND),
            50 * MILLISECOND,
            Duration(0, None, to_oo=True),
            approximation=Approximation.MOST_RECENT,
        ),
    )
    fields = (Field("f1", FieldType.FLOAT), Field("f2", FieldType.FLOAT))
    assert generator.sort == ValueSort("state", fields)


def test_a_later_text_stands_on_an_earlier_one() -> None:
    first = signature(EXAMPLE)
    more = "stream fast = speed[car1] with any change"
    second = signature(more, first)
    assert second.declarations[:-1] == first.declarations
    assert second.stream("fast") is not None
    # What is there already is there: nothing is new, and nothing is changed.
    new, third = check_kpl(parse_kpl(EXAMPLE + more), EXAMPLE + more, None, second)
    assert new == ()
    assert third is second
    assert "declared already" in refusal("source float pos_car1", second).message


def test_a_refused_text_changes_nothing() -> None:
    first = signature(EXAMPLE)
    before = first.declarations
    error = refusal("source pos pos_car2\nstrmgen pos[car2] = pos_car3", first)
    assert (error.line, error.column) == (2, 21)
    assert first.declarations == before
    assert first.source("pos_car2") is None


def test_dependents_are_all_that_cannot_be_without_it() -> None:
    there = signature("sort pos = (x float, y float)\n" + EXAMPLE)
    assert there.dependents("pos_car1") == ("speed_car1", "speed[car1]", "pos[car1]")
    assert there.dependents("SpeedEst") == ("speed_car1", "speed[car1]")
    assert there.dependents("sort pos") == there.dependents("pos")
    assert set(there.dependents("pos")) == {d.key for d in there.declarations} - {"sort pos"}
    assert there.dependents("speed_car1") == ()
    assert there.dependents("nothing") == ()


def test_nothing_is_left_without_what_it_needs() -> None:
    there = signature(EXAMPLE)
    with pytest.raises(ValueError, match="'speed\\[car1\\]' needs 'SpeedEst'"):
        there.without(["SpeedEst"])
    with pytest.raises(ValueError, match="'x' is not declared"):
        there.without(["x"])
    left = there.without(["SpeedEst", *there.dependents("SpeedEst")])
    assert left.declarations == there.declarations[:2]
    # Its place is free for another.
    assert signature("compunit float SpeedEst(pos)", left).compunit("SpeedEst") is not None


def test_sorts_are_declared_or_features_or_open() -> None:
    ontology = """
    dyknow:speed a dyknow-o:Feature ; rdfs:range xsd:double .
    dyknow:groundSpeed a dyknow-o:Feature ; rdfs:subPropertyOf dyknow:speed ;
      rdfs:range xsd:double .
    dyknow:course a dyknow-o:Feature .
    """
    vocabulary = vocabulary_of(ontology)
    text = """
    sort altitude = float
    source speed a  source dyknow:course b  source altitude c  source mood d
    source object e  source time f  source groundSpeed g
    strmgen ground = g
    compunit boolean Fast(speed)
    strmgen fast = Fast(ground)
    """
    _, there = check_kpl(parse_kpl(text), text, vocabulary)
    sorts = [there.source(name) for name in "abcdef"]
    value = {kind: (Field("value", kind),) for kind in FieldType}
    assert [source and source.sort for source in sorts] == [
        ValueSort("speed", value[FieldType.FLOAT], DYKNOW + "speed"),
        ValueSort("course", None, DYKNOW + "course"),
        ValueSort("altitude", value[FieldType.FLOAT]),
        ValueSort("mood", None),
        ValueSort("object", value[FieldType.STRING]),
        ValueSort("time", value[FieldType.INTEGER]),
    ]
    # Every ground speed is a speed, but not the other way round.
    wrong = text.replace("Fast(speed)", "Fast(groundSpeed)").replace("Fast(ground)", "Fast(sp)")
    wrong = wrong.replace("strmgen fast", "strmgen sp = a\nstrmgen fast")
    with pytest.raises(LanguageError, match="of sort `speed`"):
        check_kpl(parse_kpl(wrong), wrong, vocabulary)


@pytest.mark.parametrize(
    ("text", "policy"),
    [
        ("", Policy()),
        ("  # nothing", Policy()),
        ("any update, max delay oo, any order, no approximation", Policy()),
        ("sample every 1.5s", Policy(SampleEvery(1_500_000_000))),
        ("sample every 1500 us, strict order", Policy(SampleEvery(1_500_000), order=Order.STRICT)),
        ("any change, max delay 0", Policy(AnyChange(), 0)),
        ("from 1970-01-01T00:00:01Z to 2s", Policy(duration=Duration(SECOND, 2 * SECOND))),
        ("from -9223372036854775808ns", Policy(duration=Duration(TIME_MIN))),
        ("to +9223372036854775807ns", Policy(duration=Duration(None, TIME_MAX))),
        ("from 400 to 300", Policy(duration=Duration(400 * MILLISECOND, 300 * MILLISECOND))),
    ],
)
def test_policies_by_themselves(text: str, policy: Policy) -> None:
    assert parse_policy(text) == policy
    for unit in ("ns", "us", "ms", "s"):
        assert parse_policy(format_policy(policy, unit), unit) == policy


@pytest.mark.parametrize("text", ["to 9223372036854775808ns", "from -9223372036854775809ns"])
def test_times_end_where_64_bits_do(text: str) -> None:
    with pytest.raises(LanguageError, match="64 bits"):
        parse_policy(text)


def test_times_print_as_integers_where_that_is_exact() -> None:
    policy = Policy(SampleEvery(1500), 2 * SECOND, Duration(-1_000_001, None, to_oo=True))
    assert format_policy(policy) == "sample every 1500ns, max delay 2000, from -1000001ns to oo"
    assert format_policy(policy, "ns").startswith("sample every 1500, max delay 2000000000")
    assert format_policy(policy, "s").startswith("sample every 1500ns, max delay 2, ")


def test_labels_have_one_spelling() -> None:
    for text in ("pos[car1,car2]", " dyknow:pos [ car1 , # the first\n car2 ]"):
        assert parse_label(text) == Label("pos", ("car1", "car2"))
    assert str(parse_label("pos[car1,car2]")) == "pos[car1, car2]"
    assert str(parse_label("pos[]")) == "pos"
    assert parse_label("dyknow-o:x").identifier == "dyknow_o_x"


def test_another_unit_is_printed_with_the_text() -> None:
    there = signature(EXAMPLE).declarations
    text = format_kpl(there, "us")
    assert text.startswith("unit us\n")
    assert "sample every 200000)" in text
    assert check_kpl(parse_kpl(text), text)[0] == there


# -- configuration and mediation -------------------------------------------------------------------


def test_mediation_and_configuration_processes() -> None:
    there = signature(CARS + "strmgen focus_pos = select(pos[car] foreach car in cars)")
    cars, positions = (Term(Label(name), Policy()) for name in ("cars", "positions"))
    pos, speed = Label("pos", ("car",)), Label("speed", ("car",))
    changes = Policy(AnyChange())
    configuration = ForeachDeclaration(
        "car",
        Term(Label("cars"), changes),
        (
            GeneratorDeclaration(pos, POS, SelectObject(positions)),
            GeneratorDeclaration(speed, SPEED, Compute("SpeedEst", (Term(pos, changes),))),
        ),
    )
    key = "foreach car in cars: pos[car], speed[car]"
    assert there.find(key) == there.foreach(key) == configuration
    assert configuration.key == key
    # What it makes itself it does not read from outside.
    assert configuration.terms == (Term(Label("cars"), changes), positions)
    speeds, focus = there.generator("speeds"), there.generator("focus_pos")
    assert speeds is not None
    assert speeds.process == Aggregate("car", Term(speed, Policy()), cars)
    assert speeds.terms == (Term(speed, Policy()), cars)
    assert focus is not None
    assert focus.process == Select("car", Term(pos, Policy()), cars)
    assert there.sink("Log") == SinkDeclaration("Log", (Term(Label("speeds"), Policy()),))


def test_a_foreach_is_instantiated_for_an_object() -> None:
    foreach = signature(CARS).foreach("foreach car in cars: pos[car], speed[car]")
    assert foreach is not None
    assert format_kpl(instantiate(foreach, "car 7")).splitlines() == [
        'strmgen pos["car 7"] = selectObject(positions)',
        'strmgen speed["car 7"] = SpeedEst(pos["car 7"] with any change)',
    ]


def test_a_foreach_binds_its_variable_in_every_process() -> None:
    text = """
    source float f  strmgen x[a, b] = f  source object o  strmgen seen = o
    foreach v in seen {
      strmgen c[v] = f
      strmgen d[v] = join(c[v], x[a, b])
      strmgen e[v] = sync(c[v], c[v]; any update)
      strmgen g[v] = aggregate(x[v, w] foreach w in seen with any change)
      strmgen h[v] = select(x[w, v] foreach w in seen)
    }
    """
    foreach = signature(text).declarations[-1]
    assert isinstance(foreach, ForeachDeclaration)
    made = instantiate(foreach, "1")
    assert format_kpl(made).splitlines() == [
        "strmgen c[1] = f",
        "strmgen d[1] = join(c[1], x[a, b])",
        "strmgen e[1] = sync(c[1], c[1]; any update)",
        "strmgen g[1] = aggregate(x[1, w] foreach w in seen with any change)",
        "strmgen h[1] = select(x[w, 1] foreach w in seen)",
    ]
    # An object called like an inner variable is not taken for it.
    assert format_kpl(instantiate(foreach, "w")).splitlines()[3:] == [
        "strmgen g[w] = aggregate(x[w, w_] foreach w_ in seen with any change)",
        "strmgen h[w] = select(x[w_, w] foreach w_ in seen)",
    ]
    # All objects have the same fields, so that they can be aggregated.
    joined = made[1].process
    assert isinstance(joined, JoinOf)
    assert joined.identifiers == ("c_v", "x_a_b")
    assert [field.name for field in made[1].sort.fields or ()] == ["c_v", "x_a_b"]
    assert made[1].sort == foreach.generators[1].sort


def test_an_aggregate_says_whose_its_samples_are() -> None:
    # `speed` is open here, so nothing is known of its fields.
    speeds = signature(CARS).generator("speeds")
    assert speeds is not None
    assert speeds.sort == SPEED
    known = signature("sort speed = float\n" + CARS).generator("speeds")
    assert known is not None
    fields = (Field("object", FieldType.STRING), Field("value", FieldType.FLOAT))
    assert known.sort == ValueSort("speed", fields)
    assert known.sort.object_field == "object"


def test_a_mediation_stays_while_one_stream_of_its_feature_is_left() -> None:
    text = """
    source object o  strmgen cars = o  source pos p
    strmgen pos[car1] = p
    strmgen all = aggregate(pos[car] foreach car in cars)
    strmgen pos[car2] = p
    stream out = all
    """
    there = signature(text)
    mediation = there.generator("all")
    assert mediation is not None
    assert there.uses(mediation) == ("pos[car1]", "pos[car2]", "cars")
    assert there.dependents("pos[car1]") == there.dependents("pos[car2]") == ()
    assert there.dependents("p") == ("out", "pos[car2]", "all", "pos[car1]")
    # What is left stands behind what it uses, so that its text can be read again.
    left = there.without(["pos[car1]"])
    assert [d.key for d in left.declarations] == ["o", "cars", "p", "pos[car2]", "all", "out"]
    assert left.dependents("pos[car2]") == ("out", "all")
    with pytest.raises(ValueError, match="'all' needs 'pos\\[car2\\]'"):
        left.without(["pos[car2]"])


def test_a_foreach_makes_streams_of_a_feature() -> None:
    there = signature(CARS)
    key = "foreach car in cars: pos[car], speed[car]"
    assert there.dependents(key) == ("Log", "speeds")
    assert there.dependents("SpeedEst") == there.dependents("positions")
    assert there.dependents("SpeedEst") == ("Log", "speeds", key)
    foreach = there.foreach(key)
    assert foreach is not None
    assert there.uses(foreach) == ("cars", "positions", "SpeedEst")
    more = signature("source speed s strmgen speed[bus] = s", there)
    assert more.dependents(key) == ()
    assert more.without([key]).generator("speeds") is not None


def test_any_update_makes_states_as_any_change_does() -> None:
    text = "source float s strmgen a = s strmgen b = sync(a; any update)"
    generator = signature(text).generator("b")
    assert generator is not None
    assert generator.process == Synchronize(
        (Term(Label("a"), Policy()),), SynchronizationPolicy(AnyUpdate())
    )
    assert format_kpl(generator) == "strmgen b = sync(a; any update)"


@pytest.mark.parametrize(
    "text", ["pos", 'pos["a b", 3]', 'pos["to"]', 'pos["é", "7:x"]', 'pos[""]', "p:q[x:y, 3f2a]"]
)
def test_objects_have_one_spelling(text: str) -> None:
    text = text.replace("p:q", "dyknow-o:q")
    assert str(parse_label(text)) == text
    assert parse_label(text).identifier.isidentifier()
    assert parse_label('dyknow:pos["car1"]') == Label("pos", ("car1",))


def test_a_unit_of_time_is_one() -> None:
    with pytest.raises(ValueError, match="not a unit"):
        check_kpl(parse_kpl(EXAMPLE), EXAMPLE, unit="h")


def test_ten_thousand_generators() -> None:
    lines = ["source pos p", *(f"strmgen pos[car{n}] = p" for n in range(10_000))]
    there = signature("\n".join(lines))
    assert len(there.dependents("p")) == 10_000
    text = "stream s = pos[car9999]"
    assert format_kpl(check_kpl(parse_kpl(text), text, None, there)[0]) == text


@pytest.mark.parametrize("path", sorted(CASES.glob("*.case")), ids=lambda path: path.stem)
def test_case(path: Path) -> None:
    """Declarations that have no sort of their own: each with its key, and the sorts of what it
    makes. ``DYKNOW_REWRITE=1`` writes the files."""
    title, _, rest = path.read_text(encoding="utf-8").partition("\n")
    text, _, expected = rest.partition("----\n")
    new, _ = check_kpl(parse_kpl(text), text)
    printed = format_kpl(new)
    assert check_kpl(parse_kpl(printed), printed)[0] == new
    shown = "".join(f"{format_kpl(d)}\n  {d.key}\n{_made(d)}" for d in new)
    if os.environ.get("DYKNOW_REWRITE") == "1":
        path.write_text(f"{title}\n{text}----\n{shown}", encoding="utf-8")
        return
    assert shown == expected, title


def _made(declaration: CheckedDeclaration) -> str:
    if not isinstance(declaration, ForeachDeclaration):
        return ""
    made = ((g.key, g.sort.name, g.sort.fields) for g in declaration.generators)
    return "".join(
        f"  {key}: {name}, "
        + ("open" if fields is None else ", ".join(f"{f.name} {f.type}" for f in fields))
        + "\n"
        for key, name, fields in made
    )
