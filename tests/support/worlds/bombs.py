"""Requests that are made to stop a service: each names the statuses that are right for it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Final
from urllib.parse import quote

DEEP: Final = 100_000
SSL: Final = "stream s5 contains speed(UAV) = spd [km.h-1] for every UAV = id"
TEXT, XML, TURTLE = "text/plain", "application/xml", "text/turtle"
JSON_LD, RDF_XML, NTRIPLES = "application/ld+json", "application/rdf+xml", "application/n-triples"
JSON, NDJSON, SPARQL = "application/json", "application/x-ndjson", "application/sparql-query"
FORM = "application/x-www-form-urlencoded"
_ONTOLOGY: Final = "/ontologies?name=urn:x:bomb"
_RDF: Final = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"


@dataclass(frozen=True)
class Bomb:
    name: str
    method: str
    path: str
    kind: str
    body: str
    statuses: tuple[int, ...] = (400,)


def nested(open: str, close: str, middle: str = "", depth: int = DEEP) -> str:
    return open * depth + middle + close * depth


def query(where: str, name: str = "bomb", head: str = "SELECT ?o ?v") -> str:
    return (
        f"REGISTER QUERY {name} COMPUTE EVERY 1s AS\n"
        "PREFIX dyknow: <http://www.ida.liu.se/dyknow/>\n"
        f"{head}\nFROM STREAM <http://www.ida.liu.se/dyknow/s5.trdf> [RANGE 5s STEP 1s]\n"
        f"WHERE {{ {where} }}"
    )


def template(where: str, tail: str = "") -> str:
    return (
        "REGISTER TEMPLATE dyknow:BombEvent(?o, ?type) COMPUTE EVERY 1s AS\n"
        "PREFIX dyknow: <http://www.ida.liu.se/dyknow/>\nCONSTRUCT { ?o dyknow:speed ?v }\n"
        f"WHERE {{ ?o a ?type . {where} }}\n{tail} WINDOW [RANGE 5s STEP 1s]"
    )


def _filter(condition: str) -> str:
    return f"?o dyknow:speed ?v . FILTER({condition})"


WHERES: Final = {
    "brackets": _filter(nested("(", ")", "?v")),
    "groups": nested("{", "}", "?o dyknow:speed ?v"),
    "nodes": "?o dyknow:p " + nested("[ dyknow:p ", "]", "1"),
    "lists": "?o dyknow:p " + nested("(", ")", "1"),
    "negations": _filter("!" * 20_000 + "?v"),
    # A scan that took `<1…2>` for an IRI did not see what stands in it.
    "negations after <": _filter("?v<" + "!" * 40_000 + "1&&2>1"),
    "sums after <": _filter("?v<" + "1+" * 10_000 + "1&&2>1"),
    "fewer negations after <": _filter("?v<" + "!" * 2_000 + "1&&2>1"),
    "fewer sums after <": _filter("?v<" + "1+" * 1_500 + "1&&2>1"),
    "calls": _filter(nested("ABS(", ")", "?v", 20_000) + " > 1"),
    "exists": nested("FILTER EXISTS { ?o ?p ?v ", "}", "", 10_000),
    "subselects": nested("{ SELECT * WHERE ", "}", "{ ?o ?p ?v }", 10_000),
    "sums": _filter("?v" + "+1" * 20_000),
    "steps": "?o dyknow:p" + "/dyknow:p" * 5_000 + " ?v",
    "alternatives": "?o dyknow:p" + "|dyknow:p" * 5_000 + " ?v",
    "inverses": "?o " + "^" * DEEP + "dyknow:p ?v",
    "chain of 400": " . ".join(f"?x{i} dyknow:p ?x{i + 1}" for i in range(400)),
    "unions": "{ ?o dyknow:p ?v }" + " UNION { ?o dyknow:p ?v }" * 2_000,
    "IN": _filter("?v IN (" + ",".join(map(str, range(DEEP))) + ")"),
    "VALUES": "VALUES ?v { " + " ".join(map(str, range(DEEP))) + " }",
    "quoted triples": "<<" * 20_000,
    "an open string": '?o dyknow:p "' + '\\"' * DEEP,
    "a number": _filter("?v > " + "1" * 1_000_000),
}


@cache
def members(count: int) -> str:
    """A JSON object with so many members."""
    return "{" + ",".join(f'"{number:x}":0' for number in range(count)) + "}"


def texts() -> Iterator[Bomb]:
    """What is refused by a look at it: nested, long, or made of a thousand pieces."""
    for name, where in WHERES.items():
        yield Bomb(f"query: {name}", "POST", "/queries", TEXT, query(where))
        yield Bomb(f"template: {name}", "POST", "/templates", TEXT, template(where))
        yield Bomb(f"sparql: {name}", "POST", "/sparql", SPARQL, f"SELECT * {{ {where} }}")
    aggregate = "AGGREGATE {(?a, AVG, {?v}) FILTER (" + nested("(", ")", "?a") + " > 1)}"
    yield Bomb(
        "template: AGGREGATE", "POST", "/templates", TEXT, template("?o dyknow:speed ?v", aggregate)
    )
    for sign, name in (("!", "negations"), ("1+", "sums")):
        where = _filter("?v<" + sign * (7_000 // len(sign)) + "1&&2>1")
        asked = f"/explain?query={quote(query(where))}"
        yield Bomb(f"explain: {name} after <", "GET", asked, TEXT, "")
    event = "dyknow:HighSpeedEvent("
    for name, body in {
        "brackets": event + nested("(", ")") + ")",
        "arguments": event + ", ".join(["?o"] * DEEP) + ")",
        "a number": f"{event}?o, dyknow:UAV, {'1' * 1_000_000})",
        "an exponent": f"{event}?o, dyknow:UAV, 1e{'9' * 50_000})",
    }.items():
        yield Bomb(f"request: {name}", "POST", "/events", TEXT, body, (400, 404))
    for path, method, key in (
        ("/events", "POST", "event"),
        ("/streams/x", "PUT", "fields"),
        ("/transformations", "POST", "inputs"),
        ("/subscriptions", "POST", "policy"),
        ("/match", "POST", "feature"),
        ("/streams/s5/quality", "PUT", "quality"),
    ):
        for name, value in {
            "lists": nested("[", "]"),
            "objects": nested('{"a":', "}", "1"),
        }.items():
            body = f'{{"{key}": {value}}}'
            yield Bomb(f"JSON {name}: {path}", method, path, JSON, body, (400, 422))
        for count, status in ((9_000, 422), (DEEP, 413), (700_000, 413)):
            name = f"JSON with {count:,} members: {path}"
            yield Bomb(name, method, path, JSON, members(count), (status,))
    for name, value in {"a sign": "%25", "no sign": "%zz", "a letter": "%41"}.items():
        body = "query=" + value * 2_600_000
        yield Bomb(f"form: {name}", "POST", "/sparql", FORM, body, (413,))
    for name, value in {
        "lists": nested("[", "]"),
        "objects": nested('{"a":', "}", "1"),
        "a number": "1" * 1_000_000,
        "an exponent": "1e400",
    }.items():
        line = f'{{"valid": 1, "id": "a", "spd": {value}}}\n'
        yield Bomb(f"NDJSON: {name}", "POST", "/streams/s5/samples", NDJSON, line)
        yield Bomb(f"live NDJSON: {name}", "POST", "/streams/s5/samples/live", NDJSON, line)
    for name, body in {
        "brackets": "stream x = s5 with " + nested("(", ")", "sample every 200"),
        "calls": "strmgen a = " + nested("f(", ")", "s5"),
        "open": "[" * DEEP,
        "foreach": "foreach x in y " * 50_000,
    }.items():
        yield Bomb(f"KPL: {name}", "POST", "/kpl", TEXT, body, (400, 413))
    for name, policy in {"brackets": "(" * DEEP, "parts": "sample every 1s, " * 50_000}.items():
        body = json.dumps({"stream": "s5", "policy": policy})
        yield Bomb(f"policy: {name}", "POST", "/subscriptions", JSON, body, (400, 413, 422))
    begin = "stream s5 contains speed"
    for name, body in {
        "brackets": begin + nested("(", ")") + " = spd",
        "arguments": begin + nested("(", ")", "UAV") + " = spd",
        "unit": f"{begin}(UAV) = spd [{'m.' * DEEP}m] for every UAV = id",
        "power": f"{begin}(UAV) = spd [m{'9' * DEEP}] for every UAV = id",
    }.items():
        yield Bomb(f"SSL: {name}", "POST", "/annotations", TEXT, body, (400, 413))


_LAUGHS: Final = (
    '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY l0 "ha">'
    + "".join(f'<!ENTITY l{n} "{f"&l{n - 1};" * 10}">' for n in range(1, 10))
    + "]><a>&l9;</a>"
)
_QUADRATIC: Final = (
    f'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY x "{"x" * 100_000}">]>'
    f'<rdf:RDF xmlns:rdf="{_RDF}"><rdf:Description rdf:about="urn:a">'
    f'<b xmlns="urn:">{"&x;" * 50_000}</b></rdf:Description></rdf:RDF>'
)


def documents() -> Iterator[Bomb]:
    """RDF and XML."""
    for name, body in {
        "elements": nested("<a>", "</a>"),
        "attributes": "<a " + " ".join(f'b{i}="1"' for i in range(DEEP)) + "/>",
        "entities in entities": _LAUGHS,
        "one long entity": _QUADRATIC,
        "an open comment": "<!--" * 500_000,
    }.items():
        yield Bomb(f"XML: {name}", "POST", "/specifications", XML, body, (400, 413))
        yield Bomb(f"RDF/XML: {name}", "POST", _ONTOLOGY, RDF_XML, body)
    for name, body in {
        "lists": nested("[", "]"),
        "objects": nested('{"urn:b":', "}", "1"),
        "@list": nested('{"@list":[', "]}"),
        "@graph": nested('{"@graph":[', "]}"),
        "contexts": '{"@context":' + nested('{"a":{"@id":"urn:a","@context":', "}}", "{}") + "}",
        "@json": '{"urn:b":{"@type":"@json","@value":' + nested("[", "]") + "}}",
    }.items():
        yield Bomb(f"JSON-LD: {name}", "POST", _ONTOLOGY, JSON_LD, body)
    for name, object in {
        "nodes": nested("[ <urn:b> ", "]", "1"),
        "lists": nested("(", ")", "1"),
        "quoted triples": nested("<<( <urn:a> <urn:b> ", " )>>", "1"),
        "an open string": '"' + '\\"' * 1_000_000,
    }.items():
        body = f"<urn:a> <urn:b> {object} ."
        yield Bomb(f"Turtle: {name}", "POST", _ONTOLOGY, TURTLE, body)
        yield Bomb(f"transformations: {name}", "POST", "/transformations", TURTLE, body)
        yield Bomb(f"N-Triples: {name}", "POST", _ONTOLOGY, NTRIPLES, body)
    rest = "".join(
        f"_:l{i} <{_RDF}first> <urn:x{i}> ; <{_RDF}rest> _:l{i + 1} .\n" for i in range(20_000)
    )
    for name, body in {
        "a long list": f"<urn:C> owl:intersectionOf _:l0 .\n{rest}",
        "owl:sameAs": "".join(f"<urn:a{i}> owl:sameAs <urn:a{i + 1}> .\n" for i in range(500)),
        "a transitive chain": "<urn:p> a owl:TransitiveProperty .\n"
        + "".join(f"<urn:a{i}> <urn:p> <urn:a{i + 1}> .\n" for i in range(3_000)),
        "many triples": "".join(f"<urn:a{i}> <urn:p> <urn:b{i}> .\n" for i in range(150_000)),
    }.items():
        yield Bomb(f"closure: {name}", "POST", _ONTOLOGY, TURTLE, body)


def doubled(function: str, rounds: int = 24) -> str:
    """A text of a thousand letters, doubled twice in each of some steps."""
    steps = " ".join(f"BIND({function.replace('X', f'?c{i}')} AS ?c{i + 1})" for i in range(rounds))
    return f"BIND('{'a' * 1000}' AS ?c0) {steps} BIND(STRLEN(?c{rounds}) AS ?z)"


_EVERY: Final = "?a ?b ?c . ?d ?e ?f . ?g ?h ?i"
_TEN: Final = "{ 1 2 3 4 5 6 7 8 9 0 }"
_TWELVE: Final = " ".join(f"VALUES ?v{i} {_TEN}" for i in range(12))


def evaluations() -> Iterator[Bomb]:
    """Queries that are small, right, and never end."""
    for name, (text, statuses) in {
        "a product, counted": (f"SELECT (COUNT(*) AS ?n) {{ {_EVERY} }}", (503,)),
        # Its rows are too many, or, on a machine that is busy, its time is over before they are.
        "a product, shown": (f"SELECT * {{ {_EVERY} }}", (422, 503)),
        "a product, constructed": (f"CONSTRUCT {{ ?a ?e ?i }} {{ {_EVERY} }}", (422, 503)),
        "a product, ordered": (f"SELECT * {{ {_EVERY} }} ORDER BY ?c", (422, 503)),
        "paths": (
            "SELECT (COUNT(*) AS ?n) "
            "{ ?a (!<urn:x>)* ?b . ?b (!<urn:y>)* ?c . ?c (!<urn:x>|^!<urn:x>)* ?d }",
            (422, 503),
        ),
        "CONCAT": (f"ASK {{ {doubled('CONCAT(X,X,X,X)')} FILTER(?z > 0) }}", (422, 503)),
        "REPLACE": (f"ASK {{ {doubled(_REPLACE)} FILTER(?z > 0) }}", (422, 503)),
        "VALUES, asked": (
            f"ASK {{ {_TWELVE} FILTER(?v0 + ?v5 + ?v11 < 0) }}",
            (422, 503),
        ),
        "a regular expression": (
            "SELECT * { ?s ?p ?o FILTER(REGEX(STR(?o), '((a{1,100}){1,100}){1,100}')) }",
            (200, 503),
        ),
    }.items():
        yield Bomb(f"sparql: {name}", "POST", "/sparql", SPARQL, text, statuses)


_REPLACE: Final = "REPLACE(X,'a','aaaa')"
_PRODUCT: Final = (
    "?a dyknow:speed ?b . ?c dyknow:speed ?d . ?e dyknow:speed ?f . ?g dyknow:speed ?h"
)
WINDOWS: Final = {
    "product": query(_PRODUCT, "product", "SELECT ?a ?e"),
    "product_filtered": query(
        f"{_PRODUCT} FILTER(?b + ?d + ?f + ?h < 0)", "product_filtered", "SELECT ?a"
    ),
    "product_counted": query(_PRODUCT, "product_counted", "SELECT (COUNT(*) AS ?n)"),
    "product_optional": query(
        "?a dyknow:speed ?b OPTIONAL { ?c dyknow:speed ?d . ?e dyknow:speed ?f }",
        "product_optional",
        "SELECT ?a",
    ),
    "product_constructed": query(
        _PRODUCT, "product_constructed", "CONSTRUCT { ?a dyknow:p ?c . ?c dyknow:q ?e }"
    ),
    "path": query(
        "?a dyknow:speed ?b . ?x (!<urn:x>)* ?y . ?y (!<urn:y>)* ?z", "path", "SELECT ?a ?x ?z"
    ),
    "concat": query(
        f"?a dyknow:speed ?b {doubled('CONCAT(X,X,X,X)', 16)}", "concat", "SELECT ?a ?z"
    ),
    "replace": query(f"?a dyknow:speed ?b {doubled(_REPLACE, 16)}", "replace", "SELECT ?a ?z"),
    "values": query(
        f"?a dyknow:speed ?b {_TWELVE}",
        "values",
        "SELECT ?a",
    ),
}
"""Continuous queries, by name, that no window of some hundred samples is small enough for."""
