"""Static joins of patterns, answered from a store."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pyoxigraph import Literal, NamedNode, Quad, Store

from dyknow.continuous.operators.background import Background
from dyknow.languages.mtl.checked import Kind
from dyknow.rdf.namespaces import DYKNOW
from dyknow.reasoning.patterns.plans.query import Keys, StaticJoin, object_key, text_key
from dyknow.reasoning.patterns.recognition.static_tables import StaticTables
from dyknow.sparql import ast, parse_sparql

A, B, C = (NamedNode(f"urn:{name}") for name in "abc")
P, Q = NamedNode("urn:p"), NamedNode("urn:q")


def join(text: str, *variables: tuple[str, Kind], graph: str | None = None) -> StaticJoin:
    """The join of the triples of a text."""
    (triples,) = parse_sparql(f"SELECT * {{ {text} }}", {"": "urn:"}).where.elements
    assert isinstance(triples, ast.Triples)
    named = tuple((name, f"static {name}", kind) for name, kind in variables)
    return StaticJoin(tuple((each, graph) for each in triples.triples), named)


def store(*triples: tuple[NamedNode, NamedNode, NamedNode | Literal]) -> Store:
    found = Store()
    found.extend(Quad(*triple) for triple in triples)
    return found


def counts(tables: StaticTables, asked: StaticJoin, *columns: list[float]) -> list[int]:
    values = {
        name: np.array(column, np.float64 if kind is Kind.NUMBER else np.int64)
        for (name, _, kind), column in zip(asked.variables, columns, strict=True)
    }
    count = len(columns[0]) if columns else 2
    rows, _ = tables(asked, values, count)
    return np.bincount(rows, minlength=count).tolist()


def test_solutions_are_counted_by_the_shared_variables() -> None:
    keys = Keys()
    a, b, c = (keys.number(object_key(each.value)) for each in (A, B, C))
    x = keys.number(text_key("x"))
    tables = StaticTables(
        Background(store((A, P, B), (A, P, C), (B, Q, Literal("x")), (C, Q, Literal(5)))), keys
    )
    assert counts(tables, join("?s :p ?o", ("s", Kind.OBJECT)), [a, b, c]) == [2, 0, 0]
    both = join("?s :p ?o", ("s", Kind.OBJECT), ("o", Kind.OBJECT))
    assert counts(tables, both, [a, a], [b, a]) == [1, 0]
    assert counts(tables, join("?s :q ?o", ("o", Kind.TEXT)), [x, a]) == [1, 0]
    assert counts(tables, join("?s :q ?o", ("o", Kind.NUMBER)), [5.0, 4.0]) == [1, 0]
    assert counts(tables, join("?s :p/:q ?o", ("s", Kind.OBJECT)), [a, b]) == [2, 0]
    assert counts(tables, join("?s :p ?o . ?o :q 5", ("s", Kind.OBJECT)), [a, b]) == [1, 0]
    assert counts(tables, join("?s :p ?o")) == [2, 2]


def test_values_have_the_kind_of_the_sample() -> None:
    keys = Keys()
    moment = Literal(
        "1970-01-01T00:00:01Z", datatype=NamedNode("http://www.w3.org/2001/XMLSchema#dateTime")
    )
    tables = StaticTables(Background(store((A, P, Literal(True)), (A, P, moment))), keys)
    assert counts(tables, join("?s :p ?o", ("o", Kind.TRUTH)), [1, 0]) == [1, 0]
    assert counts(tables, join("?s :p ?o", ("o", Kind.TIME)), [10**9, 1]) == [1, 0]


def test_a_new_version_is_looked_up_anew() -> None:
    keys = Keys()
    a = keys.number(object_key(A.value))
    version = 0
    facts = store((A, P, B))
    tables = StaticTables(Background(facts, lambda: version), keys)
    asked = join("?s :p ?o", ("s", Kind.OBJECT))
    assert counts(tables, asked, [a]) == [1]
    facts.add(Quad(A, P, C))
    assert counts(tables, asked, [a]) == [1]
    version = 1
    assert counts(tables, asked, [a]) == [2]


def test_a_graph_is_read_by_its_name() -> None:
    keys = Keys()
    a = keys.number(object_key(A.value))
    facts = Store()
    facts.add(Quad(A, P, B, NamedNode("urn:g")))
    facts.add(Quad(A, P, C, NamedNode("urn:h")))
    tables = StaticTables(Background(facts, default=["urn:h"]), keys, ["urn:g"])
    named = join("?s :p :b", ("s", Kind.OBJECT), graph="urn:g")
    assert counts(tables, named, [a]) == [1]
    assert counts(tables, join("?s :p :b", ("s", Kind.OBJECT)), [a]) == [0]


def test_solutions_are_told_in_order() -> None:
    keys = Keys()
    a, b, c = (keys.number(object_key(each.value)) for each in (A, B, C))
    facts = store(
        (A, P, C), (A, P, B), (A, P, Literal(5)), (A, P, NamedNode(DYKNOW + "uav1")), (B, P, A)
    )
    asked = replace(join("?s :p ?o", ("s", Kind.OBJECT)), results=(("o", "what"), ("s", "whose")))
    tables = StaticTables(Background(facts), keys)
    rows, results = tables(asked, {"s": np.array([b, c, a])}, 3)
    assert rows.tolist() == [0, 2, 2, 2, 2]
    texts = {name: [keys.key(each) for each in found.tolist()] for name, found in results.items()}
    assert texts == {
        "what": ['"urn:a', '"5', '"uav1', '"urn:b', '"urn:c'],
        "whose": ['"urn:b', *['"urn:a'] * 4],
    }
