"""How fast RDF comes in: texts of 10,000 statements over HTTP to a stream of RDF.

    python bench/service/rdf.py

Triples a second of processor time of service and client together, in one process. Each statement
is a speed in a timestamped graph of 1,000 statements; the speeds have three digits, or are all
different. *with a query*: C-SPARQL averages each object's speed over 10 s, every second.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import httpx
import numpy as np

from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.config.settings import Settings
from dyknow.service.server import running

OBJECTS, GRAPH, TEXT, TEXTS = 1_000, 1_000, 10_000, 60
XSD = "http://www.w3.org/2001/XMLSchema#"
PROV = "http://www.w3.org/ns/prov#generatedAtTime"
QUERY = """REGISTER QUERY mean AS SELECT ?o (AVG(?v) AS ?mean)
FROM STREAM dyknow:rdf [RANGE 10s STEP 1s]
WHERE { ?o <http://example.org/speed> ?v } GROUP BY ?o HAVING (?mean > 200)"""
RUNS = 3


def texts(*, quads: bool, distinct: bool) -> Iterator[bytes]:
    """Texts of N-Quads with a graph each 0.1 s, or of N-Triples."""
    random = np.random.default_rng(1)
    start = int(time.time()) - 3_600
    for text in range(TEXTS):
        speeds = random.uniform(50, 150, TEXT)
        spelled = map(repr, speeds.tolist()) if distinct else map("{:.1f}".format, speeds.tolist())
        lines = []
        for i, speed in enumerate(spelled):
            number = (text * TEXT + i) // GRAPH
            graph = f" <urn:g{number}>" if quads else ""
            subject = f"<http://example.org/car{random.integers(OBJECTS)}>"
            value = f'"{speed}"^^<{XSD}double>'
            lines.append(f"{subject} <http://example.org/speed> {value}{graph} .")
            if quads and i % GRAPH == 0:
                at = (start * 10 + number) * 10**8
                lines.append(f'<urn:g{number}> <{PROV}> "{at}"^^<{XSD}integer> .')
        yield ("\n".join(lines) + "\n").encode()


def run(name: str, *, quads: bool, distinct: bool, query: bool = False) -> None:
    bodies = list(texts(quads=quads, distinct=distinct))
    kind = "application/n-quads" if quads else "application/n-triples"
    least = float("inf")
    for _ in range(RUNS):
        settings = Settings(port=0, sse_ping=0)
        app = create_app(Engine(), settings, time.time_ns)
        with running(app, settings) as url, httpx.Client(base_url=url, trust_env=False) as http:
            assert http.put("/streams/rdf", json={"kind": "rdf"}).status_code == 201
            if query:
                assert http.post("/queries", content=QUERY).status_code == 201
            begun = time.process_time()
            for body in bodies:
                answer = http.post(
                    "/streams/rdf/samples", content=body, headers={"Content-Type": kind}
                )
                assert answer.status_code == 202, answer.text
            least = min(least, time.process_time() - begun)
    size = len(bodies[0]) / TEXT
    print(f"{name:45} {TEXT * TEXTS / least / 1e6:6.2f} M triples/s, {size:.0f} bytes a triple")


if __name__ == "__main__":
    run("N-Quads, timestamped graphs", quads=True, distinct=False)
    run("N-Quads, each speed another", quads=True, distinct=True)
    run("N-Quads, with a query", quads=True, distinct=False, query=True)
    run("N-Triples, stamped on arrival", quads=False, distinct=False)
