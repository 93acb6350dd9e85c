"""Nothing that is sent makes the service open a connection: a listener watches."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator

import httpx
import pytest
from asking import asking

from dyknow.continuous.columns.oxigraph_port import NO_QUADS
from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.config.settings import Settings
from dyknow.service.server import running
from dyknow.service.workers.services import Windows

SSL = "stream s5 contains speed(UAV) = spd [km.h-1] for every UAV = id"
RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
SPEC = "http://www.dyknow.eu/ontology#Specification"


class Listener:
    """Counts who comes, and lets them go again."""

    def __init__(self) -> None:
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._socket.getsockname()[1]}/x"
        self.came: list[str] = []
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        while True:
            connection, _ = self._socket.accept()
            with connection:
                connection.settimeout(1)
                said = connection.recv(4096).decode(errors="replace")
                if said.startswith("STOP"):
                    return
                self.came.append(said)  # before whoever came sees the end

    def say(self, text: str) -> None:
        with socket.create_connection(self._socket.getsockname()) as connection:
            connection.sendall(text.encode())
            connection.recv(1)

    def close(self) -> None:
        self.say("STOP")
        self._thread.join()
        self._socket.close()


@pytest.fixture
def listener() -> Iterator[Listener]:
    made = Listener()
    yield made
    made.close()


@pytest.fixture
def http(settings: Settings) -> Iterator[httpx.Client]:
    """A service whose continuous queries have a worker, too."""
    windows = Windows(settings)
    engine = Engine(epoch="e1", budget=windows.budget)
    try:
        with (
            running(create_app(engine, settings, lambda: 10**18), settings) as url,
            asking(url) as client,
        ):
            fields = {"id": "string", "spd": "float"}
            client.put("/streams/s5", json={"fields": fields}).raise_for_status()
            client.post("/annotations", content=SSL, headers={"Content-Type": "text/plain"})
            yield client
    finally:
        windows.close()


def sparql(url: str) -> list[str]:
    return [
        f"SELECT * {{ SERVICE <{url}> {{ ?s ?p ?o }} }}",
        f"SELECT * {{ SERVICE SILENT <{url}> {{ ?s ?p ?o }} }}",
        f"SELECT * {{ BIND(<{url}> AS ?g) SERVICE ?g {{ ?s ?p ?o }} }}",
        f"SELECT * {{ \\u0053ERVICE <{url}> {{ ?s ?p ?o }} }}",
        f"LOAD <{url}>",
        f"LOAD SILENT <{url}> INTO GRAPH <urn:g>",
        f"SELECT * FROM <{url}> {{ ?s ?p ?o }}",
        f"SELECT * FROM NAMED <{url}> {{ GRAPH ?g {{ ?s ?p ?o }} }}",
        f"SELECT * {{ GRAPH <{url}> {{ ?s ?p ?o }} }}",
        f"DESCRIBE <{url}>",
    ]


def continuous(url: str) -> list[str]:
    stream = "FROM STREAM <http://www.ida.liu.se/dyknow/s5.trdf> [RANGE 5s STEP 1s]"
    body = "{ ?o dyknow:speed ?v }"
    heads = [
        f"SELECT ?o FROM <{url}> {stream} WHERE {body}",
        f"SELECT ?o FROM NAMED <{url}> {stream} WHERE {body}",
        f"SELECT ?o FROM STREAM <{url}> [RANGE 5s STEP 1s] WHERE {body}",
        f"SELECT ?o {stream} WHERE {{ SERVICE <{url}> {body} }}",
        f"SELECT ?o {stream} WHERE {{ ?o ?p ?v FILTER EXISTS {{ SERVICE <{url}> {body} }} }}",
        f"SELECT ?o ?w {stream} WHERE {{ ?o dyknow:speed ?v BIND(IRI('{url}') AS ?w) }}",
        f"SELECT ?o {stream} WHERE {{ ?o dyknow:speed ?v . ?x (!<{url}>)* ?o }}",
    ]
    return [f"REGISTER QUERY q{i} COMPUTE EVERY 1s AS {head}" for i, head in enumerate(heads)]


def jsonld(url: str) -> list[str]:
    return [
        f'{{"@context": "{url}", "@id": "urn:a", "urn:b": 1}}',
        f'{{"@context": ["{url}", {{}}], "@id": "urn:a", "urn:b": 1}}',
        f'{{"@context": {{"@import": "{url}"}}, "@id": "urn:a", "urn:b": 1}}',
        f'{{"@context": {{"p": {{"@id": "urn:b", "@context": "{url}"}}}}, "p": {{"urn:c": 1}}}}',
        f'{{"@id": "urn:a", "urn:b": {{"@context": "{url}", "c": 1}}}}',
        f'{{"@context": {{"@vocab": "{url}#"}}, "@type": "{url}", "b": 1}}',
    ]


def rdfxml(url: str) -> list[str]:
    inside = f'<rdf:Description rdf:about="{url}"><b xmlns="urn:">&e;</b></rdf:Description>'
    body = f'<rdf:RDF xmlns:rdf="{RDF}" xml:base="{url}">{inside}</rdf:RDF>'
    include = f'<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" href="{url}"/>'
    return [
        f'<!DOCTYPE a [<!ENTITY e SYSTEM "{url}">]>{body}',
        f'<!DOCTYPE a SYSTEM "{url}" [<!ENTITY e "x">]>{body}',
        f'<!DOCTYPE a PUBLIC "-//a//b" "{url}">{body.replace("&e;", "")}',
        f'<!DOCTYPE a [<!ENTITY % e SYSTEM "{url}"> %e;]>{body.replace("&e;", "")}',
        f'<?xml-stylesheet href="{url}"?>{body.replace("&e;", "")}',
        body.replace("&e;", include),
        f'<rdf:RDF xmlns:rdf="{RDF}" xmlns:owl="http://www.w3.org/2002/07/owl#">'
        f'<owl:Ontology rdf:about="urn:o"><owl:imports rdf:resource="{url}"/></owl:Ontology>'
        "</rdf:RDF>",
    ]


def turtle(url: str) -> list[str]:
    return [
        f"<urn:o> a owl:Ontology ; owl:imports <{url}> .",
        f"@base <{url}> . <a> <b> <c> .",
        f"@prefix x: <{url}#> . x:a a owl:Class ; rdfs:seeAlso <{url}> .",
        f"<{url}> a owl:Class ; rdfs:isDefinedBy <{url}> .",
    ]


def specifications(url: str) -> list[str]:
    xsi = 'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"'
    inner = "<spec:insertions/>"

    def spec(attributes: str, inside: str = inner) -> str:
        return f'<spec:specification xmlns:spec="{SPEC}" {attributes}>{inside}</spec:specification>'

    include = f'<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" href="{url}"/>'
    return [
        spec(f'{xsi} xsi:schemaLocation="{SPEC} {url}"'),
        spec(f'{xsi} xsi:noNamespaceSchemaLocation="{url}"'),
        f'<!DOCTYPE a SYSTEM "{url}">{spec("")}',
        f'<!DOCTYPE a [<!ENTITY e SYSTEM "{url}">]>{spec("", "&e;")}',
        f'<?xml-stylesheet type="text/xsl" href="{url}"?>{spec("")}',
        f'<?xml-model href="{url}"?>{spec("")}',
        spec("", include),
        spec(f'xml:base="{url}"'),
    ]


def test_nobody_is_asked(http: httpx.Client, listener: Listener) -> None:
    url, ontology = listener.url, "/ontologies?name=urn:x:o"
    sent = [
        *(("/sparql", "application/sparql-query", text) for text in sparql(url)),
        *(("/queries", "text/plain", text) for text in continuous(url)),
        *((ontology, "application/ld+json", text) for text in jsonld(url)),
        *((ontology, "application/rdf+xml", text) for text in rdfxml(url)),
        *((ontology, "text/turtle", text) for text in turtle(url)),
        *(("/transformations", "text/turtle", text) for text in turtle(url)),
        *(("/specifications", "application/xml", text) for text in specifications(url)),
        ("/annotations", "text/plain", SSL.replace("[km.h-1]", f"[<{url}>]")),
        ("/annotations", "text/plain", SSL.replace("UAV", f"<{url}>")),
        ("/kpl", "text/plain", f"source x {url}"),
        ("/events", "text/plain", f"<{url}>(?o, <{url}>, 1)"),
        ("/match", "application/json", f'{{"feature": "{url}"}}'),
    ]
    for path, kind, body in sent:
        # A server of contexts or schemas might also be named beside the document.
        link = f'<{url}>; rel="http://www.w3.org/ns/json-ld#context"; type="application/ld+json"'
        answer = http.post(path, content=body, headers={"Content-Type": kind, "Link": link})
        assert answer.status_code < 500, (path, body, answer.text)
    for name in ("default-graph-uri", "named-graph-uri", "using-graph-uri"):
        http.get("/sparql", params={"query": "ASK { ?s ?p ?o }", name: url})
    template = (
        "REGISTER TEMPLATE dyknow:AwayEvent(?o) COMPUTE EVERY 1s AS "
        f"CONSTRUCT {{ ?o dyknow:speed ?v }} FROM <{url}> "
        "WHERE { ?o dyknow:speed ?v } WINDOW [RANGE 5s STEP 1s]"
    )
    http.post("/templates", content=template, headers={"Content-Type": "text/plain"})
    http.put("/streams/away", json={"fields": {"id": "string"}, "namespace": url})
    line = f'{{"valid": 1, "available": 1, "id": "{url}", "spd": 1}}\n'
    kind = {"Content-Type": "application/x-ndjson"}
    http.post("/streams/s5/samples", content=line, headers=kind).raise_for_status()
    http.post("/streams/s5/end")
    assert http.get("/ontologies/report").status_code == 200
    assert listener.came == []
    # The watch works: somebody who comes is seen.
    listener.say("GET /x")
    assert listener.came == ["GET /x"]


def test_a_worker_cannot_open_anything() -> None:
    """Not by our checks alone: Oxigraph's own SERVICE finds no descriptor for a socket."""
    listening = Listener()
    windows = Windows(Settings())
    try:
        asking = windows.budget.oxigraph
        with pytest.raises(ValueError, match=r"(?i)service|open files|connect"):
            asking.ask(f"SELECT * {{ SERVICE <{listening.url}> {{ ?s ?p ?o }} }}", NO_QUADS, ())
        assert asking.ask("ASK { }", NO_QUADS, ()) is True
        assert listening.came == []
    finally:
        windows.close()
        listening.close()
