"""An hour of names that are always new goes through the engine and leaves no terms behind."""

from functools import partial

import numpy as np
import pytest
from feeding import feed, samples

from dyknow.continuous.incremental import aggregation
from dyknow.engine.engine import Engine
from dyknow.engine.model.result_windows import KeptWindows
from dyknow.engine.model.views import StreamDeclaration
from dyknow.engine.planning import query_start
from dyknow.engine.units.merge import Whose, _Naming
from dyknow.rdf import dictionary as module
from dyknow.rdf.dictionary import TermDictionary
from dyknow.streams.sample import Column, Field, FieldType, SampleBatch
from dyknow.streams.string_pool import StringPool

DYKNOW = "http://www.ida.liu.se/dyknow/"
S5 = f"<{DYKNOW}s5.trdf>"
SSL = "stream s5 contains speed(UAV) = spd [km.h-1], altitude(UAV) = alt [ft] for every UAV = id"
WINDOW = "[RANGE 60s STEP 30s]"
QUERIES = {
    "groups": "SELECT ?o (AVG(?v) AS ?x) {} WHERE {{ ?o dyknow:speed ?v }} GROUP BY ?o",
    "mixed": "SELECT ?s ?p ?x {} WHERE {{ ?s ?p ?x }}",
    "texts": "SELECT ?o (CONCAT(STR(?o), ' at ', STR(?v)) AS ?x) {} WHERE {{ ?o dyknow:speed ?v }}",
}


@pytest.mark.parametrize("integers", [False, True])
def test_an_hour_of_new_names_is_flat(integers, monkeypatch) -> None:
    monkeypatch.setattr(module, "SWEEP_FLOOR", 256)
    monkeypatch.setattr(aggregation, "COMPACT", 16)
    monkeypatch.setattr(query_start, "KeptWindows", partial(KeptWindows, windows=2))
    engine = Engine(epoch="test")
    if integers:
        named = (
            Field("id", FieldType.INTEGER),
            *(Field(n, FieldType.FLOAT) for n in ("spd", "alt")),
        )
        engine.declare(StreamDeclaration("s5", named))
    engine.annotate(SSL)
    for name, query in QUERIES.items():
        text = query.format(f"FROM STREAM {S5} {WINDOW}")
        engine.queries.register(f"REGISTER QUERY {name} AS {text}")
    counts = []
    for second in range(0, 3600, 30):
        numbers = np.arange(second, second + 30, 2).tolist()
        rows = [
            (i, {"id": 10**7 + i if integers else f"uav{i}", "spd": i + 0.5, "alt": 100.0})
            for i in numbers
        ]
        feed(engine, "s5", rows)
        counts.append(engine.dictionary.count)
    assert len(samples(engine, "texts")) > 1800
    (row, *_) = engine.queries.latest("texts").solutions.rows()
    assert row["x"].value.startswith(row["o"].value)
    # Twice as many come as there are (the ontology and the windows), until they are looked at.
    assert max(counts) <= len(engine.dictionary) < 3.5 * counts[0] < 1800
    assert max(counts[60:]) <= max(counts[:60])


def test_merged_objects_keep_their_names() -> None:
    dictionary, own, pool = TermDictionary(), StringPool(), StringPool()
    naming = _Naming(Whose(None, "id"), dictionary, {"object": pool}, "object", None)
    for turn in range(6):
        names = [f"o{turn}", "always", f"o{turn - 2}"][:: 1 if turn % 2 else -1]
        times = np.arange(3, dtype=np.int64)
        column = Column(FieldType.STRING, own.encode(names), None, own)
        codes, known = naming.of(SampleBatch(times, times, {"id": column}))
        assert [pool[code] for code in codes.tolist()] == names
        assert known.all()
        dictionary._sweep()
