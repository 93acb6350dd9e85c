"""What a chronicle's plan finds is what the definition finds, however the samples are cut."""

from __future__ import annotations

from dataclasses import replace

from chronicle_definition import Match, Sample, matches
from chronicle_worlds import OBJECTS, SORTS, ChronicleWorld, Evaluation, vocabulary
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from dyknow.languages.chronicle import (
    CheckedChronicle,
    ast,
    check_chronicle,
    format_chronicle,
    parse_chronicle,
    with_arguments,
)
from dyknow.languages.errors import LanguageError
from dyknow.languages.mtl.checked import Kind
from dyknow.rdf.namespaces import DYKNOW
from dyknow.reasoning.patterns.compilation.chronicle_plans import chronicle_query

VOCABULARY = vocabulary()
EVERYTHING = {DYKNOW + each for each in OBJECTS}
SEEDS = st.integers(0, 2**32)


def evaluated(world: ChronicleWorld, samples: list[Sample], evaluation: Evaluation) -> list[Match]:
    draw = world.random
    cut = draw.choice([0.05, 0.3, 1.0])
    found: list[Match] = []
    batch: list[Sample] = []
    for sample in samples:
        batch.append(sample)
        if draw.random() < cut:
            found += evaluation.push(batch)
            batch = []
        if draw.random() < 0.05:
            evaluation.checkpoint()
    return found + evaluation.push(batch) + evaluation.end()


def check(world: ChronicleWorld, checked: CheckedChronicle) -> None:
    samples = world.samples(world.random.randint(1, 14))
    try:
        query = chronicle_query(checked, world.text, VOCABULARY)
    except LanguageError as error:
        assume("no stream tells which" not in error.message)
        if "contradict" not in error.message:
            raise
        in_order = sorted(samples, key=lambda sample: sample.time)
        assert not matches(checked, in_order, SORTS)
        return
    evaluation = Evaluation(query)
    late = evaluation.late(samples)
    wanted = matches(checked, [each for each in samples if each.number not in late], SORTS)
    found = evaluated(world, samples, evaluation)
    assert sorted(found, key=repr) == sorted(wanted, key=repr)


@settings(deadline=None, max_examples=500)
@given(SEEDS)
def test_matches_are_those_of_the_definition(seed: int) -> None:
    world = ChronicleWorld(seed)
    check(world, check_chronicle(parse_chronicle(world.text), world.text, VOCABULARY))


@settings(deadline=None, max_examples=300)
@given(SEEDS)
def test_matches_of_given_objects(seed: int) -> None:
    """Some variables stand for objects that a request gives."""
    world = ChronicleWorld(seed)
    checked = check_chronicle(parse_chronicle(world.text), world.text, VOCABULARY)
    fixed = {
        name: world.random.choice(sorted(SORTS.get(meaning.sort or "", EVERYTHING)))
        for name, meaning in checked.variables.items()
        if meaning.kind is Kind.OBJECT and world.random.random() < 0.6
    }
    assume(fixed)
    check(world, with_arguments(checked, {}, fixed))


@settings(deadline=None, max_examples=200)
@given(SEEDS)
def test_the_order_of_clauses_means_nothing(seed: int) -> None:
    """Except that of events, which the samples of a match follow."""
    world = ChronicleWorld(seed)
    checked = check_chronicle(parse_chronicle(world.text), world.text, VOCABULARY)
    written = parse_chronicle(world.text)
    events = [each for each in written.clauses if isinstance(each, ast.Event)]
    others = [each for each in written.clauses if not isinstance(each, ast.Event)]
    world.random.shuffle(others)
    again = format_chronicle(replace(written, clauses=(*others, *events)))
    other = check_chronicle(parse_chronicle(again), again, VOCABULARY)
    assert (other.events, other.variables) == (checked.events, checked.variables)
    assert set(other.probes) == set(checked.probes)
    assert set(other.distances) == set(checked.distances)
