"""Nothing is proved of a stream that a failed unit is behind, or whose grid is far too long."""

import pytest

from dyknow.converters.wire import Incoming
from dyknow.engine.kpl import verification
from dyknow.engine.processes.registry import Processes
from dyknow.languages.kpl import check_kpl, parse_kpl
from dyknow.ontology.ontology import Ontology
from dyknow.streams.sample import Field, FieldType, Schema, batch_from_rows
from dyknow.streams.time import MILLISECOND as MS

TEXT = """
sort pos = float
source pos pos_car1
compunit speed SpeedEst(pos)
strmgen pos[car1] = pos_car1
strmgen speed[car1] = SpeedEst(pos[car1] with %s)
stream out = speed[car1]
stream again = pos[car1] with %s
"""
GRID = "sample every 1, from 0 to 30000000, max delay 5, use most recent"


def proofs(inside, outside, unit):
    text = TEXT % (inside, outside)
    _, signature = check_kpl(parse_kpl(text), text, Ontology.open(None).vocabulary, unit="ms")
    processes = Processes()
    processes.computational_unit("speed", ["pos"], name="SpeedEst", on_error="stop")(unit)
    schema = Schema((Field("value", FieldType.FLOAT),))
    rows = [(t * MS, t * MS, {"value": 1.0}) for t in (1, 2, 3)]
    batch = batch_from_rows(schema, rows)
    recorded = [("pos_car1", Incoming(batch, False))]
    return {p.stream: p for p in verification.prove_specification(signature, processes, recorded)}


def echo(time, samples, state):
    return samples[0].value, state


def broken(time, samples, state):
    raise ValueError("no such speed")


@pytest.fixture
def attempts(monkeypatch):
    """How often a proof was attempted."""
    made = []

    def counted(*arguments):
        made.append(arguments)
        return prove(*arguments)

    prove = verification.prove_each
    monkeypatch.setattr(verification, "prove_each", counted)
    return made


def test_a_grid_that_could_not_be_made_is_no_proof(attempts):
    found = proofs("any update", GRID, echo)
    assert found["out"].holds
    assert not found["again"].holds
    assert "at once" in found["again"].failure
    assert found["again"].refutation is None
    assert len(attempts) == 1


def test_a_failed_unit_anywhere_behind_is_no_proof(attempts):
    found = proofs(GRID, "any change", echo)
    assert "at once" in found["out"].failure
    assert found["again"].holds
    found = proofs("any update", "any change", broken)
    assert "no such speed" in found["out"].failure
    assert found["again"].holds
    assert len(attempts) == 2


def test_a_grid_that_is_refused_to_what_proves_is_no_proof(monkeypatch):
    monkeypatch.setattr("dyknow.streams.policies.satisfaction.GRID_LIMIT", 2)
    grid = "sample every 1, from 0 to 5, max delay 5, use most recent"
    found = proofs("any update", grid, echo)
    assert "more than 2" in found["again"].failure
    assert not found["again"].holds
    assert found["out"].holds
