"""Domains, values, sources and Example 5.6's interpretation, with the paper's own numbers
([DyKnow10 Def. 5.1, 5.2, 5.9, 5.27, Examples 5.1, 5.5, 5.6])."""

import pytest

from dyknow.converters.wire import Incoming
from dyknow.engine.kpl.verification import prove_specification, rehearse
from dyknow.engine.model.errors import UnknownStream
from dyknow.engine.processes.registry import Processes
from dyknow.languages.kpl import check_kpl, parse_kpl
from dyknow.ontology.ontology import Ontology
from dyknow.streams.policies.policy import Duration, Policy, SampleEvery
from dyknow.streams.policies.satisfaction import prove
from dyknow.streams.sample import Field, FieldType, Schema, batch_from_rows
from dyknow.streams.single_sample import Sample
from dyknow.streams.string_pool import StringPool

POSITIONS = {f"p{i}" for i in range(1, 11)}
SPEEDS = {f"s{i}" for i in range(1, 11)}
"""Example 5.1: the primitive values are positions and speeds."""
F1 = [(250, 200, "p1"), (325, 300, "p2"), (430, 400, "p3"), (505, 500, "p4")]
F3 = [(510, 400, "s3")]
F5 = [(345, 300, "p2"), (460, 400, "p3")]

EXAMPLE_5_5 = """unit ns
sort pos = string
sort speed = string
source pos pos_car1
source pos pos_o4
strmgen pos[car1] = pos_car1
strmgen pos[o4] = pos_o4
compunit speed SpeedEst(pos)
strmgen speed[car1] = SpeedEst(pos[car1] with sample every 200)
strmgen speed[o4] = SpeedEst(pos[o4] with sample every 200)
stream speed_car1 = speed[car1] with from 300 to 400
"""


def speed_est(time, samples, state):
    """K_C(SpeedEst): from the second position p_i on the speed s_i."""
    (sample,) = samples
    if state is None:
        return None, sample.value
    return Sample(sample.valid, {"value": f"s{sample.value[1:]}"}), sample.value


def processes():
    known = Processes()
    known.computational_unit("speed", ["pos"], name="SpeedEst", on_error="stop")(speed_est)
    return known


def stream(samples, pool=None):
    schema = Schema((Field("value", FieldType.STRING),))
    rows = [(available, valid, {"value": value}) for available, valid, value in samples]
    return batch_from_rows(schema, rows, {"value": pool or StringPool()})


def signature():
    return check_kpl(parse_kpl(EXAMPLE_5_5), EXAMPLE_5_5, Ontology.open(None).vocabulary)[1]


@pytest.fixture
def interpretation():
    """What each name stands for: `I_F` of a label, `I_N` of a stream, `I_S` of a source."""
    recorded = [("pos_car1", Incoming(stream(F1), False))]
    application = rehearse(signature(), processes(), recorded).application

    def stands_for(name):
        rows = application.samples_of(name).rows()
        return [(available, valid, values["value"]) for available, valid, values in rows]

    return stands_for


def test_example_5_1_the_domain_of_traffic_monitoring():
    """Objects, time-points and primitive values are symbols, integers with their order, and what
    a sort allows (Def. 5.1)."""
    found = {value for _, _, value in F1}
    times = {time for available, valid, _ in F1 for time in (available, valid)}
    batch = stream(F1)
    assert set(batch.columns["value"].tolist()) == found <= POSITIONS
    assert {*batch.available.tolist(), *batch.valid.tolist()} == times
    assert (batch.available - batch.valid).tolist() == [50, 25, 30, 5]
    (car1,) = [one.label for one in signature().declarations if one.key == "pos[car1]"]
    assert car1.objects == ("car1",)


def test_definition_5_2_values_are_simple_structured_or_none():
    schema = Schema(
        (
            *(Field("place", FieldType.STRING), Field("at", FieldType.INTEGER)),
            *(Field("speed", FieldType.FLOAT), Field("seen", FieldType.BOOLEAN)),
        )
    )
    state = {"place": "p1", "at": 200, "speed": 13.5, "seen": True}
    nothing = dict.fromkeys(state)
    rows = [(250, 200, state), (325, 300, nothing)]
    assert list(batch_from_rows(schema, rows, {"place": StringPool()}).rows()) == rows


def test_definition_5_9_a_source_is_a_function_of_time(interpretation):
    """Example 5.6: I_S(pos_car1) maps 250 to <250, 200, p1> …, and anything else to no_sample."""
    source = {sample[0]: sample for sample in interpretation("pos_car1")}
    expected = {250: F1[0], 325: F1[1], 430: F1[2], 505: F1[3]}
    assert [source.get(time) for time in range(600)] == [expected.get(t) for t in range(600)]


def test_example_5_6_features_of_objects_are_streams(interpretation):
    """I_F(pos) maps car1 to f1 and other objects to the empty stream; so does I_F(speed)."""
    assert interpretation("pos[car1]") == F1
    assert interpretation("pos[o4]") == interpretation("speed[o4]") == []
    speeds = interpretation("speed[car1]")
    assert [(valid, value) for _, valid, value in speeds] == [(400, "s3")]
    assert {value for *_, value in speeds} <= SPEEDS  # Def. 5.30-5.31: I_V(speed)
    with pytest.raises(UnknownStream):
        interpretation("pos[o5]")


def test_example_5_6_is_a_model_of_what_it_interprets(interpretation):
    """Def. 5.29: the streams as they were made, and those of the paper."""
    recorded = [("pos_car1", Incoming(stream(F1), False))]
    proofs = prove_specification(signature(), processes(), recorded)
    assert all(proof.holds for proof in proofs)
    assert len(proofs) == 3
    pool = StringPool()
    f1, f3, f5 = (stream(samples, pool) for samples in (F1, F3, F5))
    delayed = [(280, 200, "p1"), (510, 400, "p3")]
    assert prove(stream(delayed, pool), f1, Policy(SampleEvery(200))) is None
    state, made = None, []
    for available, valid, value in delayed:
        sample, state = speed_est(available, [Sample(valid, {"value": value})], state)
        made += [] if sample is None else [(available, sample.valid, sample.values["value"])]
    assert made == F3
    assert prove(f3, f3, Policy(duration=Duration(300, 400))) is None
    # I_N(speed_car1) is f5 in the paper, which has positions: a substream of f1, not of f3.
    assert prove(f5, f1, Policy(duration=Duration(300, 400))) is None
    assert prove(f5, f3, Policy(duration=Duration(300, 400))) is not None
