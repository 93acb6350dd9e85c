"""What a chronicle's plan finds is what the definition finds, however the samples are cut."""

from __future__ import annotations

from chronicle_definition import Match, Sample, matches
from chronicle_worlds import SORTS, ChronicleWorld, Evaluation, vocabulary
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from dyknow.languages.chronicle import check_chronicle, parse_chronicle
from dyknow.languages.errors import LanguageError
from dyknow.reasoning.patterns.chronicle_plans import chronicle_query

VOCABULARY = vocabulary()
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


@settings(deadline=None, max_examples=600)
@given(SEEDS)
def test_matches_are_those_of_the_definition(seed: int) -> None:
    world = ChronicleWorld(seed)
    checked = check_chronicle(parse_chronicle(world.text), world.text, VOCABULARY)
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
