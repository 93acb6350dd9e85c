"""From bytes to events: decoding, annotation, the windows of the paper's speed query.

    python bench/service/ingest.py

1,000 objects, [RANGE 5s STEP 1s], one thread. *Decode* is bytes to columns; *to events* goes on
through `SampleConverter` and `ContinuousEvaluator` to the events' triples; *engine* is decoding and
`Engine.publish` with a request for the same event. The first second of the stream is not timed: it
plans the query, meets the names, compiles the kernels. Least of several runs. The events are
counted, and must be those that numpy finds. CPU time of the process, as others use the machine.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pyoxigraph import NamedNode, Quad, Store

from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.operators.background import Background
from dyknow.converters import SampleConverter
from dyknow.converters.arrow.stream import decode_arrow
from dyknow.converters.ndjson import decode_ndjson
from dyknow.converters.rdf.ntriples import GENERATED, TripleReader
from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.languages.csparql import parse_query
from dyknow.languages.ssl import check_ssl, parse_ssl
from dyknow.languages.ssl.annotation import StreamAnnotation
from dyknow.ontology.ontology import Ontology
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.namespaces import DYKNOW, RDF_TYPE
from dyknow.rdf.timed import Kind, TimedTriples, number_text
from dyknow.streams.sample import Field, FieldType, Schema
from dyknow.streams.string_pool import StringPool
from dyknow.streams.time import format_time

ROOT = Path(__file__).parents[2]
SECOND = 10**9
START = 1_633_633_973 * SECOND
OBJECTS = 1_000
SECONDS = 12
RANGE = 5
THRESHOLD = 100
STREAM = DYKNOW + "flights"
QUERY = f"""REGISTER STREAM HighSpeedEvent COMPUTE EVERY 1s AS
PREFIX dyknow: <{DYKNOW}>
CONSTRUCT {{?uav dyknow:speed ?avgSpeed}}
FROM STREAM <{STREAM}> [RANGE {RANGE}s STEP 1s]
WHERE {{ ?uav a dyknow:UAV . ?uav dyknow:speed ?spd . }}
AGGREGATE {{(?avgSpeed, AVG, {{?spd}}) FILTER (?avgSpeed > {THRESHOLD})}}
"""
UAVS = [
    Quad(NamedNode(f"{DYKNOW}uav{n}"), RDF_TYPE, NamedNode(DYKNOW + "UAV")) for n in range(OBJECTS)
]
"""What rows of samples say by their sort, and plain triples do not."""
SSL = "stream flights contains speed(UAV) = speed, altitude(UAV) = altitude for every UAV = id"


@dataclass(frozen=True)
class Samples:
    """Columns by hand: times (one a sample, increasing), object numbers, speeds, altitudes."""

    time: np.ndarray
    number: np.ndarray
    speed: np.ndarray
    altitude: np.ndarray

    @classmethod
    def make(cls, rate: int, digits: int | None) -> Samples:
        """``rate`` samples a second; numbers of so many decimals (None: all that a float64 has)."""
        random = np.random.default_rng(7)
        count = (SECONDS + 1) * rate
        at = START + 1 + np.arange(count) * SECONDS * SECOND // (SECONDS * rate)
        speed, altitude = random.uniform(50, 150, count), random.uniform(0, 5000, count)
        if digits is not None:
            speed, altitude = speed.round(digits), altitude.round(digits)
        return cls(at, random.integers(0, OBJECTS, count), speed, altitude)

    def __len__(self) -> int:
        return len(self.time)

    def take(self, rows: slice) -> Samples:
        return Samples(self.time[rows], self.number[rows], self.speed[rows], self.altitude[rows])

    def events(self) -> int:
        """How many events the windows that close by the last sample have, by hand."""
        second = -(-(self.time) // SECOND)  # a window holds what is after its begin, up to its end
        first, last = int(second[0]), int(self.time[-1]) // SECOND
        last -= int(self.time[-1]) % SECOND == 0
        found = 0
        for end in range(first, last + 1):
            rows = (second > end - RANGE) & (second <= end)
            sums = np.bincount(self.number[rows], self.speed[rows], OBJECTS)
            counts = np.bincount(self.number[rows], minlength=OBJECTS)
            with np.errstate(all="ignore"):
                found += int(np.count_nonzero(sums / counts > THRESHOLD))
        return found


class Direct:
    """Bytes to events without the engine."""

    def __init__(self, id_type: FieldType, *, samples: bool) -> None:
        self.schema = _schema(id_type)
        self.pools: dict[str, StringPool] = {}
        self.dictionary = TermDictionary()
        self.reader = TripleReader(self.dictionary)
        vocabulary = Ontology.open().vocabulary
        (annotation,) = check_ssl(parse_ssl(SSL), SSL, vocabulary)
        assert isinstance(annotation, StreamAnnotation)
        self.converter = SampleConverter(annotation, self.schema, vocabulary, self.dictionary)
        store = Store()
        store.extend([] if samples else UAVS)
        self.evaluator = ContinuousEvaluator(
            parse_query(QUERY), self.dictionary, Background(store), [STREAM]
        )

    def take(self, decoded: Decoded) -> int:
        """The events that are known by the batch's end."""
        if isinstance(decoded, TimedTriples):
            triples, time = decoded, int(decoded.tables[0].time[-1])
        else:
            batch = decoded.batch
            triples, time = self.converter.convert(batch), int(batch.available[-1])
        self.evaluator.push(STREAM, triples)
        closed = self.evaluator.advance(STREAM, time)
        return sum(len(result.triples) for result in closed if result.triples is not None)


class Through:
    """The same through a running engine."""

    def __init__(self, id_type: FieldType) -> None:
        self.engine = Engine()
        self.schema = _schema(id_type)
        self.engine.declare(StreamDeclaration("flights", self.schema.fields))
        self.engine.annotate(SSL)
        template = (ROOT / "templates" / "library" / "high_speed.rq").read_text()
        self.engine.register_template(template)
        asked = f"dyknow:HighSpeedEvent(?o, dyknow:UAV, {THRESHOLD})"
        view = self.engine.request_event(self.engine.parse_request(asked))
        self.results = self.engine.generator(view.stream)
        self.pools = self.engine.generator("flights").stream.pools

    def take(self, incoming: Decoded) -> int:
        assert isinstance(incoming, Incoming)
        before = self.results.counters.accepted
        # Their valid times as available ones, so that the windows are the same.
        self.engine.publish("flights", Incoming(incoming.batch, False), 0)
        return self.results.counters.accepted - before


Way = Direct | Through
Decoded = Incoming | TimedTriples
Decode = Callable[[bytes, Way], Decoded]


@dataclass(frozen=True)
class Case:
    """A wire format: how samples are written, how the bytes are read."""

    name: str
    aim: float
    encode: Callable[[Samples], bytes]
    decode: Decode
    rate: int
    id_type: FieldType = FieldType.STRING
    digits: int | None = 3
    size: int = 10_000
    samples: bool = True
    """Else triples, which the engine does not take."""


def _schema(id_type: FieldType) -> Schema:
    return Schema(
        (
            Field("id", id_type),
            Field("speed", FieldType.FLOAT),
            Field("altitude", FieldType.FLOAT),
        )
    )


def ndjson(time: Callable[[int], str]) -> Callable[[Samples], bytes]:
    """``time`` writes the valid time as a JSON value."""

    def encode(part: Samples) -> bytes:
        columns = (part.time, part.number, part.speed, part.altitude)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        return b"".join(
            f'{{"valid":{time(t)},"id":"uav{n}","speed":{s},"altitude":{a}}}\n'.encode()
            for t, n, s, a in rows
        )

    return encode


def _decode_ndjson(data: bytes, way: Way) -> Incoming:
    return decode_ndjson(data, way.schema, way.pools)


def _decode_arrow(data: bytes, way: Way) -> Incoming:
    return decode_arrow(data, way.schema, way.pools)


def arrow(ids: str) -> Callable[[Samples], bytes]:
    """``ids``: how the objects are named (integers, text, IRIs, dictionary)."""

    def encode(part: Samples) -> bytes:
        import pyarrow as pa

        names: object = pa.array(part.number)
        if ids != "integers":
            names = pa.array([f"uav{n}" for n in part.number.tolist()])
        if ids == "IRIs":
            names = pa.array([f"{DYKNOW}uav{n}" for n in part.number.tolist()])
        if ids == "dictionary":
            names = names.dictionary_encode()  # type: ignore[attr-defined]
        table = pa.table(
            {
                "valid": pa.array(part.time).cast(pa.timestamp("ns", "UTC")),
                "id": names,
                "speed": part.speed,
                "altitude": part.altitude,
            }
        )
        sink = pa.BufferOutputStream()
        with pa.ipc.new_stream(sink, table.schema) as writer:
            writer.write_table(table)
        found: bytes = sink.getvalue().to_pybytes()
        return found

    return encode


def _decode_ntriples(data: bytes, way: Way) -> TimedTriples:
    assert isinstance(way, Direct)
    return way.reader.triples(data, int(data[1 : data.index(b"\n")]))


def _decode_nquads(data: bytes, way: Way) -> TimedTriples:
    assert isinstance(way, Direct)
    return way.reader.graphs(data)


def ntriples(part: Samples) -> bytes:
    """Speeds as N-Triples: their time, in a comment, is that of the batch's last sample."""
    return f"#{part.time[-1]}\n".encode() + _speeds(part)


def nquads(part: Samples) -> bytes:
    """The same as a graph with its time."""
    graph, at = f"<urn:g{part.time[-1]}>", format_time(int(part.time[-1]))
    told = f'{graph} {GENERATED} "{at}"^^<http://www.w3.org/2001/XMLSchema#dateTime> .\n'
    return told.encode() + _speeds(part, f"{graph} ")


def _speeds(part: Samples, graph: str = "") -> bytes:
    rows = zip(part.number.tolist(), part.speed.tolist(), strict=True)
    double = "http://www.w3.org/2001/XMLSchema#double"
    return b"".join(
        f"<{DYKNOW}uav{n}> <{DYKNOW}speed> "
        f'"{number_text(Kind.DOUBLE, s)}"^^<{double}> {graph}.\n'.encode()
        for n, s in rows
    )


CASES = (
    Case("NDJSON, time in ns", 2, ndjson(str), _decode_ndjson, 20_000),
    Case("NDJSON, ISO time", 2, ndjson(lambda t: f'"{format_time(t)}"'), _decode_ndjson, 20_000),
    Case("NDJSON, numbers of 17 digits", 2, ndjson(str), _decode_ndjson, 20_000, digits=None),
)
TRIPLES = (
    Case("N-Triples", 1, ntriples, _decode_ntriples, 20_000, samples=False),
    Case("N-Quads, timestamped graphs", 1, nquads, _decode_nquads, 20_000, samples=False),
    Case(
        "N-Triples, numbers of 17 digits", 1, ntriples, _decode_ntriples, 20_000, digits=None,
        samples=False,
    ),
)  # fmt: skip
ARROW = (
    Case(
        "Arrow, integer ids", 60, arrow("integers"), _decode_arrow, 200_000,
        FieldType.INTEGER, size=100_000,
    ),
    Case("Arrow, text ids", 10, arrow("text"), _decode_arrow, 200_000, size=100_000),
    Case("Arrow, IRIs", 10, arrow("IRIs"), _decode_arrow, 200_000, size=100_000),
    Case("Arrow, dictionary", 10, arrow("dictionary"), _decode_arrow, 200_000, size=100_000),
)  # fmt: skip


def speeds(case: Case, size: int, runs: int) -> tuple[float, float, float, bool]:
    """Samples a second: decoding, to events, through the engine; and whether the events agree."""
    # Small batches of a slower stream: fewer of them, the same windows.
    rate = min(case.rate, max(1_000, size * 20))
    samples = Samples.make(rate, case.digits)
    starts = range(0, len(samples), size)
    bodies = [case.encode(samples.take(slice(start, start + size))) for start in starts]
    first = -(-rate // size)
    timed = len(samples) - first * size
    if timed <= 0:
        raise ValueError("the first batch is the whole stream")
    if not case.samples:
        last = np.minimum(np.arange(len(samples)) // size * size + size, len(samples)) - 1
        samples = replace(samples, time=samples.time[last])
    wanted = samples.events()
    best, agree = [float("inf")] * 3, True
    for _ in range(runs):
        alone = Direct(case.id_type, samples=case.samples)
        best[0] = min(best[0], _timed(bodies, first, lambda b, w=alone: _only(case, b, w))[0])
        ways: list[Way] = [Direct(case.id_type, samples=case.samples)]
        if case.samples:
            ways.append(Through(case.id_type))
        for column, way in enumerate(ways, 1):
            seconds, events = _timed(bodies, first, lambda b, w=way: w.take(case.decode(b, w)))
            best[column] = min(best[column], seconds)
            agree &= events == wanted
    return timed / best[0], timed / best[1], timed / best[2], agree


def _only(case: Case, body: bytes, way: Way) -> int:
    case.decode(body, way)
    return 0


def _timed(bodies: Sequence[bytes], first: int, take: Callable[[bytes], int]) -> tuple[float, int]:
    """Seconds for all batches but the first ones, and the events of all."""
    events = sum(take(body) for body in bodies[:first])
    begin = time.process_time()
    for body in bodies[first:]:
        events += take(body)
    return time.process_time() - begin, events


def main(runs: int = 5, only: str = "") -> int:
    """Print the tables; the number says whether every way found the events that numpy finds."""
    cases = [case for case in (*CASES, *TRIPLES, *_arrow_cases()) if only in case.name]
    agree = True
    print(f"{'M samples/s':<32}{'aim':>6}{'decode':>10}{'to events':>11}{'engine':>9}")
    for case in cases:
        *found, same = speeds(case, case.size, runs)
        agree &= same
        line = "".join(f"{_shown(v, 2):>{w}}" for v, w in zip(found, (10, 11, 9), strict=True))
        missed = "" if found[1] >= case.aim * 1e6 else "  (aim missed)"
        print(f"{case.name:<32}{case.aim:>6}{line}{'' if same else ' DIFFERS'}{missed}", flush=True)
    print(f"\n{'to events, engine; batches of':<32}" + "".join(f"{n:>16,}" for n in SIZES))
    for case in cases:
        line = ""
        for size in SIZES:
            *found, same = speeds(case, size, max(1, runs // 2))
            agree &= same
            line += f"{_shown(found[1], 3):>9}{_shown(found[2], 3):>7}" + (
                "" if same else " DIFFERS"
            )
        print(f"{case.name:<32}{line}", flush=True)
    return 0 if agree else 1


def _shown(speed: float, digits: int) -> str:
    return f"{speed / 1e6:.{digits}f}" if speed else "-"


SIZES = (1, 10, 100, 1_000, 10_000)


def _arrow_cases() -> Sequence[Case]:
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        print("Arrow is not installed: its rows are left out")
        return ()
    return ARROW


if __name__ == "__main__":
    sys.exit(main(*(int(a) if a.isdigit() else a for a in sys.argv[1:])))
