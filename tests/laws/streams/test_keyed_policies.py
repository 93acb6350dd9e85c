"""The law of policies that hold for each object by itself: what is sent and dropped of an object is
what `adapt` gives for a stream of this object alone (SPEC §1, Policies)."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from policies_drawn import policies

from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.kpl.verification import prove_specification
from dyknow.engine.model.views import StreamDeclaration
from dyknow.engine.processes.registry import Processes
from dyknow.languages.kpl import check_kpl, format_policy, parse_kpl, parse_policy
from dyknow.languages.ssl import check_ssl, parse_ssl
from dyknow.languages.ssl.annotation import StreamAnnotation
from dyknow.ontology.ontology import Ontology
from dyknow.ontology.vocabulary import Vocabulary
from dyknow.streams.policies.adaptation import Dropped
from dyknow.streams.policies.keyed_adaptation import KeyedAdapting
from dyknow.streams.policies.policy import Approximation, Policy
from dyknow.streams.policies.satisfaction import prove, prove_each, satisfies
from dyknow.streams.policies.select_adaptation import adapt
from dyknow.streams.sample import (
    Field,
    FieldType,
    SampleBatch,
    Schema,
    batch_from_rows,
)
from dyknow.streams.string_pool import StringPool
from dyknow.streams.time import TIME_MIN

SCHEMA = Schema(
    (
        Field("id", FieldType.STRING),
        Field("part", FieldType.INTEGER),
        Field("x", FieldType.INTEGER),
    )
)
Row = tuple[int, int, str | None, int | None, int]


@st.composite
def streams(draw: st.DrawFn) -> list[Row]:
    times = sorted(draw(st.sets(st.integers(0, 40), max_size=20)))
    return [
        (
            time,
            draw(st.one_of(st.integers(-2, 42), st.just(time), st.integers(time - 6, time))),
            draw(st.sampled_from(["a", "b", None])),
            draw(st.sampled_from([1, 1, 7, None])),
            draw(st.integers(0, 3)),
        )
        for time in times
    ]


def batch_of(rows: list[Row], pool: StringPool) -> SampleBatch:
    named = [(ta, tv, {"id": id, "part": part, "x": x}) for ta, tv, id, part, x in rows]
    return batch_from_rows(SCHEMA, named, {"id": pool})


def told(batches: list[SampleBatch]) -> list[Row]:
    return [
        (ta, tv, v["id"], v["part"], v["x"])  # type: ignore[misc]
        for batch in batches
        for ta, tv, v in batch.rows()
    ]


def alone(policy: Policy, rows: list[Row], last: int) -> tuple[list[Row], list[Row]]:
    """What is sent and dropped of one object, all at once; time passes until ``last``, when the
    last sample of any object comes."""
    dropped: list[SampleBatch] = []
    adaptation = adapt(policy, lambda each: dropped.append(each.batch))
    batch = batch_of(rows, StringPool())
    sent = adaptation.push(batch) + adaptation.advance(last) + adaptation.end()
    return told(sent), told(dropped)


@settings(deadline=None, max_examples=300)
@given(streams(), policies(), st.lists(st.integers(0, 4), max_size=20), st.booleans())
def test_each_object_is_adapted_by_itself(
    rows: list[Row], policy: Policy, cuts: list[int], by_both: bool
) -> None:
    dropped: list[SampleBatch] = []

    def drop(each: Dropped) -> None:
        dropped.append(each.batch)

    adaptation = KeyedAdapting(policy, ["id", "part"] if by_both else ["id"], drop)
    sent: list[Row] = []
    known, rest = TIME_MIN, rows
    for cut in [*cuts, len(rows)]:
        # Codes of texts may be others in each batch.
        piece, rest = rest[:cut], rest[cut:]
        given = adaptation.push(batch_of(piece, StringPool(["x"] * (cut % 2))))
        if piece:
            known = piece[-1][0]
        if cut == 0 and rest:
            known = rest[0][0]
            given += adaptation.advance(known)
        found = told(given)
        sent += found
        assert sent == sorted(sent, key=lambda row: row[0])
    sent += told(adaptation.end())
    objects = {(row[2], row[3] if by_both else 0) for row in rows}
    received = sent_number = 0
    for object in objects:
        own = [row for row in rows if (row[2], row[3] if by_both else 0) == object]
        wanted, refused = alone(policy, own, rows[-1][0])
        assert [r for r in sent if (r[2], r[3] if by_both else 0) == object] == wanted
        mine = [r for r in told(dropped) if (r[2], r[3] if by_both else 0) == object]
        assert sorted(mine, key=repr) == sorted(refused, key=repr)
        received += len(own)
        sent_number += len(wanted)
    counters = adaptation.counters
    assert (counters.received, counters.sent) == (received, sent_number)
    assert sum(counters.dropped.values()) == len(told(dropped))


# -- in KPL, in specifications, in proofs ------------------------------------------------------

SSL = "stream s contains speed(UAV) = x for every UAV = id"
SPECIFICATION = """<specification xmlns="http://www.dyknow.eu/ontology#Specification"><insertions>
<cu name="specified" type="policy"><parameter name="policy" value="%s"/><stream name="s"/></cu>
</insertions></specification>"""
KPL = """unit ns
sort fix = (id string, part integer, x integer)
source fix s
strmgen f = s
strmgen all = join(f with %s)
stream declared = f with %s
"""


@st.composite
def instants(draw: st.DrawFn) -> list[Row]:
    """Samples of which several may be available at one time."""
    rows = draw(streams())
    times = sorted(draw(st.lists(st.integers(0, 30), min_size=len(rows), max_size=len(rows))))
    return [(time, *row[1:]) for time, row in zip(times, rows, strict=True)]


def annotated(vocabulary: Vocabulary) -> list[StreamAnnotation]:
    """What `SSL` says."""
    checked = check_ssl(parse_ssl(SSL), SSL, vocabulary)
    return [each for each in checked if isinstance(each, StreamAnnotation)]


def substream(batch: SampleBatch, object: object) -> SampleBatch:
    """The samples of one object."""
    ids = [values["id"] for _, _, values in batch.rows()]
    return batch.take(np.array([id == object for id in ids], np.bool_))


@settings(deadline=None, max_examples=150)
@given(
    instants(),
    policies().filter(lambda each: not each.is_default),
    st.lists(st.integers(1, 6), max_size=20),
)
def test_policies_of_texts_are_the_definition_of_each_substream(
    rows: list[Row], policy: Policy, cuts: list[int]
) -> None:
    engine = Engine()
    engine.declare(StreamDeclaration("s", SCHEMA.fields))
    engine.annotate(SSL)
    written = format_policy(policy)
    engine.add_kpl(KPL % (written, written))
    engine.apply_specification(SPECIFICATION % written)
    subscribed = engine.subscribe("s", written).stream
    inner = next(unit.inputs[0].name for unit in engine.units() if unit.output.name == "all")
    rest = rows
    for cut in [*cuts, len(rows)]:
        piece, rest = rest[:cut], rest[cut:]
        if piece:
            source = engine.generator("s")
            named = [(ta, tv, {"id": id, "part": p, "x": x}) for ta, tv, id, p, x in piece]
            batch = batch_from_rows(source.schema, named, source.stream.pools)
            engine.publish("s", Incoming(batch, stamped=False), 0)
    engine.end("s")
    whole = engine.generator("s").stream.all()
    for name in ("declared", "specified", subscribed, inner):
        made = engine.generator(name).stream.all()
        for object in ("a", "b", None):
            assert prove(substream(made, object), substream(whole, object), policy) is None, name


@settings(deadline=None, max_examples=150)
@given(instants(), policies().filter(lambda each: not each.is_default))
def test_each_object_is_proved(rows: list[Row], policy: Policy) -> None:
    """`kpl prove` finds that the policy holds, and what it finds of the recording is the first
    sample of an object that breaks the policy."""
    text = KPL % (format_policy(policy), format_policy(policy))
    vocabulary = Ontology.open(None).vocabulary
    _, signature = check_kpl(parse_kpl(text), text, vocabulary)
    recorded = batch_of(list(dict.fromkeys(rows)), StringPool())
    proofs = prove_specification(
        signature,
        Processes(),
        [("s", Incoming(recorded, stamped=False))],
        annotations=annotated(vocabulary),
    )
    assert [proof.refutation for proof in proofs] == [None] * 3
    assert all(proof.holds for proof in proofs)
    adapted = [proof for proof in proofs if proof.term.startswith("f with ")]
    assert len(adapted) == 2
    for proof in adapted:
        kept = [satisfies(substream(recorded, object), policy) for object in ("a", "b", None)]
        assert (proof.as_recorded is None) == (kept == [None] * 3)


@settings(deadline=None, max_examples=300)
@given(streams(), st.sets(st.integers(0, 19)), policies())
def test_a_proof_of_each_object_is_one_of_every_substream(
    rows: list[Row], kept: set[int], policy: Policy
) -> None:
    pool = StringPool()
    whole = batch_of(rows, pool)
    part = whole.take(np.array([row in kept for row in range(len(rows))], np.bool_))
    found = prove_each(part, whole, policy, ["id"])
    alone = {
        object: prove(substream(part, object), substream(whole, object), policy)
        for object in ("a", "b", None)
    }
    refuted = {object for object, each in alone.items() if each is not None}
    assert (found is None) == (not refuted)
    if found is not None:
        object, message = found.message.removeprefix("of ").split(": ", 1)
        each = alone[{"no name": None}.get(object, object)]
        assert each is not None
        assert (each.message, each.is_missing) == (message, found.is_missing)
        if policy.approximation is Approximation.MOST_RECENT and found.is_missing:
            assert found.row == each.row
        else:
            # The row is one of the object, in the stream that it is counted in.
            rows_of_it = list((whole if found.is_missing else part).rows())
            assert (rows_of_it[found.row][2]["id"] or "no name") == object


def test_what_is_missing_of_a_grid_is_counted_in_the_grid_of_its_object() -> None:
    """A grid may be longer than what it is made from."""
    policy = parse_policy("from 0 to 4, sample every 1, max delay 0, use most recent", "ns")
    whole = batch_of([(0, 0, "b", 1, 7), (0, 0, "a", 1, 7)], StringPool())
    rows: list[Row] = [(time, time, id, 1, 7) for time in range(5) for id in ("a", "b")]
    made = batch_of(rows[:-2] + rows[-1:], StringPool())
    found = prove_each(made, whole, policy, ["id"])
    assert found is not None
    assert (found.row, found.is_missing) == (4, True)
    assert found.message == "of a: a sample valid at 4 could be sent at 4"
    assert prove_each(batch_of(rows, StringPool()), whole, policy, ["id"]) is None


def test_a_source_that_is_silent_has_no_objects() -> None:
    """Nor has it fields, if it is open."""
    text = "source things s\nstrmgen f = s\nstream out = f with any change"
    vocabulary = Ontology.open(None).vocabulary
    _, signature = check_kpl(parse_kpl(text), text, vocabulary)
    (proof,) = prove_specification(signature, Processes(), [], annotations=annotated(vocabulary))
    assert (proof.holds, proof.received) == (True, 0)
