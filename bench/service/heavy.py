"""Requests as heavy as a service takes them, or just beyond: what bombs.py throws beside the bombs
of tests/support/worlds/bombs.py.

A row of them is a function of the client and of the round in which it is thrown: it prepares what
is needed, and gives the requests. In each round they are new to the service.
"""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import httpx

TEXT, XML, TURTLE = "text/plain", "application/xml", "text/turtle"
JSON, NDJSON, SPARQL = "application/json", "application/x-ndjson", "application/sparql-query"
ARROW = "application/vnd.apache.arrow.stream"
MEBIBYTE = 1 << 20
MOST = 128
"""Declarations of one text."""


@dataclass(frozen=True)
class Shot:
    """A request."""

    method: str
    path: str
    kind: str = ""
    body: bytes = b""


Row = Callable[[httpx.Client, int], Sequence[Shot]]


def post(path: str, kind: str, body: str | bytes) -> Shot:
    return Shot("POST", path, kind, body.encode() if isinstance(body, str) else body)


def get(path: str) -> Shot:
    return Shot("GET", path)


def declare(http: httpx.Client, name: str, **fields: str) -> None:
    http.put(f"/streams/{name}", json={"fields": fields}).raise_for_status()


# -- ontologies ------------------------------------------------------------------------------

PREFIXES = """@prefix : <http://www.dyknow.eu/ontology#> .
@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
"""


def ontology(lines: Iterator[str], end: str = "") -> list[Shot]:
    """Loaded, and replaced by one of next to nothing."""
    path = f"/ontologies?name=urn:x:heavy{end}"
    return [
        post(path, TURTLE, PREFIXES + "\n".join(lines)),
        post(path, TURTLE, PREFIXES + "dyknow:Ship a owl:Class ."),
    ]


def classes(_: httpx.Client, round: int) -> list[Shot]:
    """2,000 classes in a tree, with labels."""
    return ontology(
        f'dyknow:C{round}x{i} a owl:Class ; rdfs:label "class {i}"@en ; rdfs:subClassOf '
        + (f"dyknow:C{round}x{i // 5} ." if i else "dyknow:Vehicle .")
        for i in range(2_000)
    )


def individuals(_: httpx.Client, round: int) -> list[Shot]:
    """6,000 individuals, each with a label and a neighbour."""
    return ontology(
        f'dyknow:i{round}x{i} a dyknow:UAV ; rdfs:label "{i}" ; '
        f"dyknow:near{round} dyknow:i{round}x{i // 2} ."
        for i in range(6_000)
    )


def features(_: httpx.Client, round: int) -> list[Shot]:
    """2,000 features."""
    return ontology(
        f'dyknow:f{round}x{i} a :UnaryFeature ; rdfs:domain dyknow:UAV ; :hasUnit "m.s-1" .'
        for i in range(2_000)
    )


def plain(_: httpx.Client, round: int) -> list[Shot]:
    """20,000 triples from which nothing follows, and a literal of 7 MB."""
    lines = (f'<urn:p{round}:{i}> rdfs:comment "{i}" .' for i in range(20_000))
    long = iter([f'<urn:l{round}> rdfs:comment "{"x" * 7 * MEBIBYTE}" .'])
    return [*ontology(lines), *ontology(long)]


# -- declarations ----------------------------------------------------------------------------

TRANSFORMATION = """:t{} a :Transformation ; :hasAnnotation [
  :hasInputAnnotation [ :describesFeature dyknow:latitude ;
    :nextSegment [ :hasInputAnnotation [ :describesFeature dyknow:longitude ] ] ] ;
  :hasOutputAnnotation [ :describesFeature dyknow:speed ; :hasUnit "m.s-1" ] ] ;
  :hasImplementation [ :hasName "coordinatesToSpeed" ] .
"""


def transformations(_: httpx.Client, round: int) -> list[Shot]:
    several = (TRANSFORMATION.format(f"{round}x{i}") for i in range(MOST))
    return [post("/transformations", TURTLE, PREFIXES + "".join(several))]


def mesh(_: httpx.Client, round: int) -> list[Shot]:
    """Transformations in layers that rest on the same: matched by each strategy."""
    names = [f"mesh{round}x{i}" for i in range(66)]
    texts = (f"dyknow:{name} a :UnaryFeature ." for name in names)
    shots = [post("/ontologies?name=urn:x:mesh", TURTLE, PREFIXES + "\n".join(texts))]
    for number in range(60):
        below = 6 * (number // 6 + 1)
        inputs = [{"feature": f"dyknow:{names[below + (number + k) % 6]}"} for k in (0, 1)]
        body = {
            "name": f"m{round}x{number}",
            "implementation": "coordinatesToSpeed",
            "inputs": [{**each, "of": ["dyknow:UAV"]} for each in inputs],
            "output": {"feature": f"dyknow:{names[number]}", "of": ["dyknow:UAV"]},
        }
        shots.append(post("/transformations", JSON, json.dumps(body)))
    leaves = ", ".join(f"{name}(UAV) = v" for name in names[60:])
    shots.append(
        post("/annotations", TEXT, f"stream leaf{round} contains {leaves} for every UAV = id")
    )
    for strategy in ("fast", "cost", "quality"):
        body = {"feature": f"dyknow:{names[0]}", "sort": "dyknow:UAV", "strategy": strategy}
        shots.append(post("/match", JSON, json.dumps(body)))
    return shots


def large_match(_: httpx.Client, round: int) -> list[Shot]:
    objects = [f"dyknow:a{i}" for i in range(100_000)]
    bodies = [
        {"feature": "dyknow:speed", "objects": objects},
        {"feature": "dyknow:speed", "objects": objects[:100]},
        {"feature": "x" * 100_000},
    ]
    return [post("/match", JSON, json.dumps(body)) for body in bodies]


def annotations(http: httpx.Client, round: int) -> list[Shot]:
    """SSL and JSON of 128 streams each, and of one stream with some 290 features."""
    declare(http, f"wide{round}", id="string", v="float")
    many = (f"stream a{round}x{i} contains speed(UAV) = v for every UAV = id" for i in range(MOST))
    wide = ", ".join(f"speed(uav{i}) = v" for i in range(290))
    contents = [{"feature": "dyknow:speed", "field": "v", "of": [f"dyknow:uav{i}"]} for i in (1, 2)]
    streams = [{"stream": f"j{round}x{i}", "contents": contents} for i in range(MOST)]
    return [
        post("/annotations", TEXT, "\n".join(many)),
        post("/annotations", TEXT, f"stream wide{round} contains {wide}"),
        post("/annotations", JSON, json.dumps(streams)),
    ]


def kpl(_: httpx.Client, round: int) -> list[Shot]:
    """128 sources, 120 generators that rest on each other, and what is removed with the first."""
    chain = [
        f"source float k{round}",
        f"strmgen g{round}x0 = k{round}",
        *(
            f"strmgen g{round}x{i + 1} = join(g{round}x{i} with sample every {i + 1}, g{round}x0)"
            for i in range(100)
        ),
    ]
    return [
        post("/kpl", TEXT, "\n".join(f"source float s{round}x{i}" for i in range(MOST))),
        post("/kpl", TEXT, "\n".join(chain)),
        Shot("DELETE", f"/kpl/k{round}?cascade=true"),
    ]


def kpl_join(_: httpx.Client, round: int) -> list[Shot]:
    """A `join` of 300 policies; it is removed again."""
    terms = ", ".join(f"h{round} with sample every {i + 1}" for i in range(300))
    text = f"source float b{round}\nstrmgen h{round} = b{round}\nstrmgen j{round} = join({terms})"
    return [post("/kpl", TEXT, text), Shot("DELETE", f"/kpl/b{round}?cascade=true")]


def specifications(http: httpx.Client, round: int) -> list[Shot]:
    """128 policies, each of a stream; then they are removed."""
    declare(http, f"spec{round}", id="string", v="float")
    head = '<specification xmlns="http://www.dyknow.eu/ontology#Specification">'
    parts = "".join(
        f'<cu type="policy" name="u{round}x{i}"><parameter name="policy" '
        f'value="sample every {i + 1}"/><stream name="spec{round}"/></cu>'
        for i in range(MOST)
    )
    gone = "".join(f'<cu name="u{round}x{i}"/>' for i in range(MOST))
    return [
        post("/specifications", XML, f"{head}<insertions>{parts}</insertions></specification>"),
        get("/specifications/current"),
        post("/specifications", XML, f"{head}<removals>{gone}</removals></specification>"),
    ]


def fields(_: httpx.Client, round: int) -> list[Shot]:
    bodies = ({"fields": {f"f{i}": "float" for i in range(count)}} for count in (1_000, 20_000))
    path = f"/streams/fields{round}"
    return [Shot("PUT", path, JSON, json.dumps(body).encode()) for body in bodies]


# -- queries ---------------------------------------------------------------------------------


def query(where: str, name: str) -> str:
    return (
        f"REGISTER QUERY {name} AS PREFIX dyknow: <http://www.ida.liu.se/dyknow/> SELECT ?o ?v "
        f"FROM STREAM <http://www.ida.liu.se/dyknow/s5.trdf> [RANGE 5s STEP 1s] WHERE {{ {where} }}"
    )


def queries(_: httpx.Client, round: int) -> list[Shot]:
    """Continuous queries as large as they may be."""
    speed = "?o dyknow:speed ?v . "
    wheres = [
        f"{speed} FILTER({' || '.join(f'?v = {i}' for i in range(1_000))})",
        f"{speed} FILTER(?v IN ({','.join(map(str, range(1_900)))}))",
        f"{speed} FILTER({'?v' + '+1' * 120} > 1)",
        " UNION ".join(f"{{ ?o dyknow:speed ?v FILTER(?v > {i}) }}" for i in range(75)),
        f"{speed} VALUES ?v {{ {' '.join(map(str, range(3_500)))} }}",
        " ".join(f"?o dyknow:p{i} ?x{i} ." for i in range(120)) + speed,
        " ".join(f"OPTIONAL {{ ?o dyknow:p{i} ?x{i} }}" for i in range(60)) + speed,
        f"?o {'/'.join(['dyknow:speed'] * 120)} ?v",
        f"?o ({'|'.join(f'dyknow:p{i}' for i in range(120))})* ?v",
        f"{speed} FILTER(REGEX(STR(?o), '{'(a|b)*' * 4_000}'))",
        f"{speed} FILTER(?v < {'1' * 60_000})",
    ]
    shots = [
        post("/queries", TEXT, query(where, f"h{round}x{i}")) for i, where in enumerate(wheres)
    ]
    windows = " ".join(
        f"FROM STREAM <http://www.ida.liu.se/dyknow/s5.trdf> [RANGE {i + 1}s STEP 1s]"
        for i in range(120)
    )
    text = query(speed, f"w{round}").replace("FROM STREAM", windows + " FROM STREAM", 1)
    shots.append(post("/queries", TEXT, text))
    within = " ".join(f"WINDOW :w{i} {{ ?o dyknow:speed ?v{i} }}" for i in range(100))
    named = " ".join(
        f"FROM NAMED WINDOW :w{i} ON <http://www.ida.liu.se/dyknow/s5.trdf> "
        f"[RANGE PT{i + 1}S STEP PT1S]"
        for i in range(100)
    )
    rsp = (
        "PREFIX : <urn:w:> PREFIX dyknow: <http://www.ida.liu.se/dyknow/> "
        f"REGISTER RSTREAM <urn:r{round}> AS SELECT * {named} WHERE {{ {within} }}"
    )
    shots.append(post("/queries", TEXT, rsp))
    return [*shots, *(Shot("DELETE", f"/queries/h{round}x{i}") for i in range(len(wheres)))]


def templates(http: httpx.Client, round: int) -> list[Shot]:
    """The same as templates, asked for, and 100 requests of one that differ in constants."""
    text = (
        f"REGISTER TEMPLATE dyknow:H{round}(?o, ?type) COMPUTE EVERY 1s AS\n"
        "PREFIX dyknow: <http://www.ida.liu.se/dyknow/>\nCONSTRUCT { ?o dyknow:speed ?v }\n"
        f"WHERE {{ ?o a ?type . ?o dyknow:speed ?v FILTER(%s) }} WINDOW [RANGE 5s STEP 1s]"
    )
    ors = text % " || ".join(f"?v = {i}" for i in range(1_000))
    asked = [post("/events", TEXT, f"dyknow:H{round}(dyknow:u{i}, dyknow:UAV)") for i in range(100)]
    return [post("/templates", TEXT, ors), *asked, get("/events"), get("/metrics")]


# -- samples ---------------------------------------------------------------------------------


def lines(line: Callable[[int], str], size: int = 8 * MEBIBYTE - 1000) -> bytes:
    """As many lines as fit, from a thousand that are made."""
    parts, left, number = [], size, 0
    while left > 0:
        found = "".join(line(number + each) + "\n" for each in range(1000)).encode()
        parts.append(found)
        left -= len(found)
        number += 1000
    return b"".join(parts[:-1])


def samples(http: httpx.Client, round: int) -> list[Shot]:
    """8 MiB: alike, with escapes, of new texts, wrong at the end, nested, of many members."""
    declare(http, f"big{round}", id="string", v="float")
    escaped = r"\u00e5\n\"" * 20
    bodies = [
        lines(lambda n: f'{{"valid":{n},"id":"u{n % 100}","v":{n}.5}}'),
        lines(lambda n: f'{{"valid":{n},"id":"{escaped}{n % 100}","v":{n}.5}}'),
        lines(lambda n: f'{{"valid":{n},"id":"{random.getrandbits(64):x}","v":{n}.5}}'),
        lines(lambda n: f'{{"valid":{n},"id":"u","v":{n}.5}}') + b"x",
        lines(lambda n: f'{{"valid":{n},"id":"u","v":{"[" * 500}{"]" * 500}}}'),
        ("{" + ",".join(f'"k{i}":1' for i in range(500_000)) + "}").encode(),
        b"\n" * (8 * MEBIBYTE - 100) + b'{"valid":1,"id":"u","v":1}',
    ]
    path = f"/streams/big{round}/samples"
    return [*(post(path, NDJSON, body) for body in bodies), get(f"{path}?limit=1000000")]


def arrow(http: httpx.Client, round: int) -> list[Shot]:
    """8 MiB of Arrow, of few and of many texts, and what is much more once it is decompressed."""
    import pyarrow as pa

    declare(http, f"arrow{round}", id="string", v="float")

    def written(count: int, ids: Sequence[str], codec: str | None = None) -> bytes:
        table = pa.table(
            {
                "valid": pa.array(range(count), pa.int64()),
                "id": pa.array(ids[:count]),
                "v": pa.array([1.5] * count),
            }
        )
        sink = pa.BufferOutputStream()
        options = pa.ipc.IpcWriteOptions(compression=codec)
        with pa.ipc.new_stream(sink, table.schema, options=options) as writer:
            writer.write_table(table)
        return sink.getvalue().to_pybytes()

    few = [f"u{i % 100}" for i in range(300_000)]
    fresh = [f"{random.getrandbits(64):x}" for _ in range(220_000)]
    bodies = [written(300_000, few), written(220_000, fresh), written(300_000, few, "zstd")]
    bodies.append(written(1_500_000, ["x" * 50] * 1_500_000, "zstd"))
    return [post(f"/streams/arrow{round}/samples", ARROW, body) for body in bodies]


# -- what is asked where there is much ---------------------------------------------------------


def much(http: httpx.Client, streams: int, policies: int) -> None:
    """So many annotated streams, and units of policies."""
    for begin in range(0, streams, MOST):
        texts = (
            f"stream m{i} contains speed(UAV) = v for every UAV = id"
            for i in range(begin, min(begin + MOST, streams))
        )
        http.post("/annotations", content="\n".join(texts), headers={"Content-Type": TEXT})
    head = '<specification xmlns="http://www.dyknow.eu/ontology#Specification"><insertions>'
    for begin in range(0, policies, MOST):
        parts = "".join(
            '<cu type="policy"><parameter name="policy" '
            f'value="sample every {i + 1}"/><stream name="m{i}"/></cu>'
            for i in range(begin, begin + MOST)
        )
        text = f"{head}{parts}</insertions></specification>"
        http.post("/specifications", content=text, headers={"Content-Type": XML})


def looks(_: httpx.Client, __: int) -> list[Shot]:
    """What tells of all there is."""
    paths = [
        "/streams",
        "/streams/status/samples?limit=100000",
        "/specifications",
        "/specifications/current",
        "/annotations",
        "/transformations",
        "/templates",
        "/events",
        "/queries",
        "/kpl",
        "/metrics",
        "/status",
        "/openapi.json",
        "/ontologies/report",
        "/explain?feature=dyknow:speed&sort=dyknow:UAV&strategy=quality",
    ]
    match = {"feature": "dyknow:speed", "sort": "dyknow:UAV", "strategy": "cost"}
    return [
        *map(get, paths),
        post("/sparql", SPARQL, "SELECT (COUNT(*) AS ?n) { ?s ?p ?o }"),
        post("/sparql", SPARQL, "SELECT * { ?s a :Stream ; ?p ?o }"),
        post("/match", JSON, json.dumps(match)),
    ]


ROWS: dict[str, Row] = {
    "ontology of 2,000 classes": classes,
    "ontology of 6,000 individuals": individuals,
    "ontology of 2,000 features": features,
    "20,000 plain triples, 7 MB literal": plain,
    "128 transformations in Turtle": transformations,
    "60 transformations in a mesh": mesh,
    "matches of 100,000 objects": large_match,
    "128 streams in SSL and JSON": annotations,
    "128 declarations in KPL": kpl,
    "join of 300 policies in KPL": kpl_join,
    "128 units in a specification": specifications,
    "a stream of 20,000 fields": fields,
    "large query texts": queries,
    "a large template, 100 requests": templates,
    "batches of 8 MiB": samples,
    "batches of 8 MiB, Arrow": arrow,
}
