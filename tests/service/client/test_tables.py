"""Results of SPARQL and of queries, as Jupyter shows them."""

from __future__ import annotations

import pandas

from dyknow.service.client.client import Client, History, SparqlResult
from dyknow.service.client.tables import MOST_ROWS


def test_a_select_is_a_table(client: Client) -> None:
    question = """SELECT ?s ?text ?none {
      VALUES (?s ?text) { (dyknow:UAV "<b> & co") } OPTIONAL { ?s <urn:nothing> ?none } }"""
    found = client.sparql(question)
    assert isinstance(found, SparqlResult)
    # It is the JSON as before, too.
    assert found["head"]["vars"] == ["s", "text", "none"]
    assert found._repr_html_() == (
        "<table><thead><tr><th>s</th><th>text</th><th>none</th></tr></thead><tbody>"
        "<tr><td>http://www.ida.liu.se/dyknow/UAV</td><td>&lt;b&gt; &amp; co</td><td></td></tr>"
        "</tbody></table>"
    )


def test_an_ask_is_a_word_and_a_graph_is_text(client: Client) -> None:
    yes = client.sparql("ASK { dyknow:UAV a owl:Class }")
    assert isinstance(yes, SparqlResult)
    assert yes._repr_html_() == "<p>true</p>"
    graph = client.sparql("CONSTRUCT { dyknow:UAV a owl:Class } WHERE {}")
    assert isinstance(graph, str)


def test_results_of_a_query_are_a_table(client: Client) -> None:
    client.put_stream("s", {"id": "string", "v": "float"})
    client.annotate("stream s contains speed(UAV) = v [km.h-1] for every UAV = id")
    client.register_query("""REGISTER QUERY fast AS SELECT ?v
      FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf> [RANGE 1s STEP 1s]
      WHERE { ?o dyknow:speed ?v }""")
    seconds = (second * 10**9 for second in range(1, 5))
    client.publish("s", [{"valid": t, "available": t, "id": "u", "v": 2.5} for t in seconds])
    client.end("s")
    list(client.events("fast", since="start"))
    found = client.query_results("fast", limit=2)
    assert isinstance(found, SparqlResult)
    assert found._repr_html_().count("<tr><td>") == 2


def test_a_history_is_a_table_and_a_frame(client: Client) -> None:
    client.put_stream("s", {"id": "string", "v": "float"})
    client.publish("s", [{"valid": 10**9, "available": 2 * 10**9, "id": "<u>", "v": 2.5}])
    client.publish("s", [{"valid": 3 * 10**9, "available": 3 * 10**9, "id": "w", "v": None}])
    found = client.history("s")
    assert isinstance(found, History)
    assert found[0]["v"] == 2.5
    assert found._repr_html_() == (
        "<table><thead><tr><th>available</th><th>valid</th><th>id</th><th>v</th></tr></thead><tbody>"
        "<tr><td>1970-01-01T00:00:02Z</td><td>1970-01-01T00:00:01Z</td><td>&lt;u&gt;</td>"
        "<td>2.5</td></tr><tr><td>1970-01-01T00:00:03Z</td><td>1970-01-01T00:00:03Z</td><td>w</td>"
        "<td></td></tr></tbody></table>"
    )
    frame = found.to_pandas()
    assert frame["valid"][0] == pandas.Timestamp(1, unit="s", tz="UTC")
    assert frame["id"].tolist() == ["<u>", "w"]


def test_a_long_table_says_how_long_it_is() -> None:
    rows = [{"n": {"type": "literal", "value": str(i)}} for i in range(MOST_ROWS + 3)]
    html = SparqlResult(head={"vars": ["n"]}, results={"bindings": rows})._repr_html_()
    assert html.count("<td>") == MOST_ROWS
    assert html.endswith("<p>and 3 more rows</p>")
