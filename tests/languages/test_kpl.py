"""KPL: what a specification says, and what stands on it ([DyKnow10 §5.2], SPEC §1)."""

import pytest
from pyoxigraph import RdfFormat, parse

from dyknow.languages.errors import LanguageError
from dyknow.languages.kpl import (
    CompunitDeclaration,
    Compute,
    FromSource,
    GeneratorDeclaration,
    Label,
    Signature,
    SourceDeclaration,
    StreamDeclaration,
    Synchronize,
    Term,
    ValueSort,
    check_kpl,
    format_kpl,
    format_policy,
    parse_kpl,
    parse_label,
    parse_policy,
)
from dyknow.ontology.vocabulary import Vocabulary
from dyknow.rdf.namespaces import DYKNOW, PREFIXES
from dyknow.streams.policy import (
    AnyChange,
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
    prefixes = "".join(f"@prefix {name}: <{iri}> .\n" for name, iri in PREFIXES.items())
    quads = parse(prefixes + ontology, format=RdfFormat.TURTLE)
    vocabulary = Vocabulary.from_triples(quad.triple for quad in quads)
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
