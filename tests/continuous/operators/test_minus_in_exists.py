"""MINUS inside EXISTS: the outer terms are put in first (SPARQL 1.1 §18.6)."""

from __future__ import annotations

import pytest
from pyoxigraph import Literal, NamedNode

from dyknow.continuous.evaluate import evaluate
from dyknow.rdf.namespaces import DYKNOW

X = "http://d.example/x"
A, B, C = (NamedNode(DYKNOW + name) for name in "abc")
P, Q, R = (NamedNode(DYKNOW + name) for name in "pqr")
ONE, TWO = Literal(1), Literal(2)
DATA = [(A, P, ONE), (B, P, TWO), (C, P, ONE), (A, Q, ONE), (B, Q, TWO), (A, R, ONE), (C, R, TWO)]


def subjects(exists: str) -> set[str]:
    text = (
        f"REGISTER QUERY q AS PREFIX d: <{DYKNOW}> SELECT ?s FROM STREAM <{X}> "
        f"[RANGE 10ns STEP 10ns] WHERE {{ ?s d:p ?v OPTIONAL {{ ?s d:r ?w }} FILTER {exists} }}"
    )
    (window,) = evaluate(text, {X: [(1, *triple) for triple in DATA]})
    return {row["s"].value.removeprefix(DYKNOW) for row in window.solutions}


@pytest.mark.parametrize(
    ("exists", "wanted"),
    [
        # ?s is a constant on both sides; ?x is what they share.
        ("EXISTS { ?s d:q ?x MINUS { ?s d:r ?x } }", "b"),
        ("NOT EXISTS { ?s d:q ?x MINUS { ?s d:r ?x } }", "ac"),
        # Of a constant nothing is shared, so nothing is removed.
        ("EXISTS { ?s d:q ?x MINUS { ?s d:r ?y } }", "ab"),
        ("EXISTS { ?y d:q ?x MINUS { ?s d:r ?x } }", "abc"),
        # Without a term outside, ?w stays a variable, which both sides share.
        ("EXISTS { ?s d:p ?w MINUS { ?y d:q ?w } }", "a"),
        ("EXISTS { ?x d:p ?w MINUS { ?y d:q ?w } }", "ac"),
        ("EXISTS { ?y d:q ?x MINUS { ?z d:r ?x FILTER(?v = 1) } }", "b"),
        ("EXISTS { ?y d:q ?x MINUS { ?x d:r ?z MINUS { ?s d:p ?z } } }", "abc"),
    ],
)
def test_outer_terms_are_no_shared_variables(exists: str, wanted: str) -> None:
    assert subjects(exists) == set(wanted)
