"""The order of triple patterns, which names of streams depend on, is that of its definition."""

from __future__ import annotations

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st
from pyoxigraph import BlankNode, Literal, NamedNode, Variable

from dyknow.sparql.algebra import most_bound_first
from dyknow.sparql.ast import Triple

KINDS = (BlankNode, Variable, NamedNode, Literal)
OPEN = st.sampled_from("abcde").map(Variable) | st.sampled_from("ab").map(BlankNode)
NAMES = st.sampled_from(["urn:a", "urn:b"]).map(NamedNode)
TRIPLES = st.builds(Triple, OPEN | NAMES, OPEN | NAMES, OPEN | NAMES | st.just(Literal("1")))


def definition(triples: list[Triple]) -> list[Triple]:
    """First the patterns with the fewest variables that no earlier one binds, then those whose
    variables occur most often, those with a literal, and by their terms; equal ones as they come.
    A pattern binds the variables of all that are as open as it is."""
    counts = Counter(term for triple in triples for term in open_terms(triple))
    bound: set[object] = set()
    found: list[Triple] = []
    remaining = list(triples)

    def rank(triple: Triple) -> tuple[object, ...]:
        terms = open_terms(triple)
        kinds = [next(n for n, kind in enumerate(KINDS) if isinstance(t, kind)) for t in of(triple)]
        return (
            sum(1 for term in terms if term not in bound),
            -sum(counts[term] for term in terms),
            not isinstance(triple.object, Literal),
            tuple(zip(kinds, [term.value for term in of(triple)], strict=True)),
        )

    while remaining:
        remaining = sorted(remaining, key=rank)
        least = rank(remaining[0])[0]
        alike = [triple for triple in remaining if rank(triple)[0] == least]
        bound.update(term for triple in alike for term in open_terms(triple))
        found.append(remaining.pop(0))
    return found


def of(triple: Triple) -> tuple[object, object, object]:
    return triple.subject, triple.predicate, triple.object


def open_terms(triple: Triple) -> list[object]:
    return [term for term in of(triple) if isinstance(term, Variable | BlankNode)]


@given(st.lists(TRIPLES, max_size=8))
def test_patterns_are_in_the_order_of_the_definition(triples):
    assert [*map(id, most_bound_first(triples))] == [*map(id, definition(triples))]
