"""Answers that differ if a query runs whole on Oxigraph: docs/explanation/semantics.md."""

import pytest
from pyoxigraph import Literal, NamedNode

import dyknow

S = "urn:s"
XSD = "http://www.w3.org/2001/XMLSchema#"


def numbers(kind, *texts):
    return [Literal(str(text), datatype=NamedNode(XSD + kind)) for text in texts]


def answers(head, where, values):
    """What ``?x`` is in the solutions of the one window."""
    triples = [(10**9, NamedNode(f"urn:o{n}"), NamedNode("urn:p"), v) for n, v in enumerate(values)]
    triples.append((10**9, NamedNode("urn:o0"), NamedNode("urn:r"), Literal(1)))
    text = f"SELECT {head} FROM STREAM <{S}> [RANGE 1s STEP 1s] WHERE {{ ?o <urn:p> ?v {where} }}"
    (window, *_) = [*dyknow.evaluate(text, {S: triples}), None]
    if window is None:
        return []
    return [row["x"].value if "x" in row else None for row in window.solutions]


MINUS = "FILTER EXISTS { ?o <urn:p> ?y MINUS { ?o <urn:r> ?z } } BIND(1 AS ?x)"
OVERFLOW = numbers("double", "-1.2e308", "1e308", "1.1e308")
DIFFERENT = [
    ("(SUM(?v) AS ?x)", "", numbers("integer", 2**62, 2**62), [str(2**63)], [None]),
    ("?x", "BIND(?v * ?v AS ?x)", numbers("integer", 2**62), [str(2**124)], [None]),
    ("?x", "BIND(-?v AS ?x)", numbers("integer", -(2**63)), [str(2**63)], [None]),
    ("?x", "BIND(?v * 10 AS ?x)", numbers("decimal", f"0.{1:019}"), [f"0.{1:018}"], [None]),
    ("(SUM(?v) AS ?x)", "", OVERFLOW, ["9E307"], ["INF"]),
    ("(MIN(?v) AS ?x)", "", [*numbers("double", "NaN"), Literal(1)], ["NaN"], ["1"]),
    ("(COUNT(?v + 1) AS ?x)", "", [Literal(1), Literal("a")], ["1"], [None]),
    ("?x", "BIND(?v / 3 AS ?x)", [Literal(20)], ["6.66666666666667"], ["6.666666666666666666"]),
    ("?x", "BIND(?v / 3 AS ?x)", numbers("float", 1), ["0.3333333333333333"], ["0.33333334"]),
    ("?x", MINUS, [Literal(1)], ["1"], []),
]


@pytest.mark.parametrize(("head", "where", "values", "columns", "oxigraph"), DIFFERENT)
def test_answers_that_differ(head, where, values, columns, oxigraph):
    assert answers(head, where, values) == columns
    assert answers(head, f"{where} BIND(BNODE() AS ?new)", values) == oxigraph


@pytest.mark.parametrize("test", ["?v", "?v < true", "?v > 0 && ?v"])
def test_boolean_values_are_the_same(test):
    where = f"FILTER({test}) BIND(?v AS ?x)"
    values = [Literal("a", language="en"), Literal(False), Literal(2**53 + 1), Literal("")]
    whole = answers("?x", f"{where} BIND(BNODE() AS ?new)", values)
    assert sorted(answers("?x", where, values)) == sorted(whole) != []
