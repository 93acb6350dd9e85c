"""The parts of a group, as SPARQL's algebra groups them (SPARQL 1.1 §18.2.2.2, §18.2.2.5)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from pyoxigraph import BlankNode, Literal, NamedNode, Variable

from .ast import Element, Expression, Filter, Group, Triple, Triples


def split_group(group: Group) -> tuple[list[Element], list[Expression]]:
    """Return the parts of a group without its filters, and the filters' conditions, which apply to
    the whole group. A filter does not end a basic graph pattern, so the triples around it become
    one part."""
    parts: list[Element] = []
    conditions: list[Expression] = []
    triples: list[Triple] = []
    for element in group.elements:
        if isinstance(element, Filter):
            conditions.append(element.condition)
        elif isinstance(element, Triples):
            triples += element.triples
        else:
            parts += _block(triples)
            triples = []
            parts.append(element)
    return [*parts, *_block(triples)], conditions


def _block(triples: Iterable[Triple]) -> list[Element]:
    return [Triples(tuple(most_bound_first(triples)))] if triples else []


def most_bound_first(triples: Iterable[Triple]) -> list[Triple]:
    """Order triple patterns for a join that knows no statistics: first those with the fewest
    variables that no earlier pattern binds, then those whose variables occur most often.

    The names of streams made for a request depend on this order, and so do the results of
    GROUP_CONCAT and SAMPLE. It must not change: replaying a log has to give the same names.
    """
    given = [(_open_places(triple), triple) for triple in triples]
    counts = Counter(term for open, _ in given for term in open)
    bound: set[Variable | BlankNode] = set()
    found: list[Triple] = []

    def free(open: list[Variable | BlankNode]) -> int:
        return sum(term not in bound for term in open)

    def order(each: tuple[list[Variable | BlankNode], Triple]) -> tuple[object, ...]:
        open, triple = each
        shared = sum(counts[term] for term in open)
        places = (triple.subject, triple.predicate, triple.object)
        return -shared, not isinstance(triple.object, Literal), tuple(map(_order, places))

    # What does not change decides among patterns with as few free variables.
    remaining = sorted(given, key=order)
    # Quadratic, but a query has at most some hundred patterns.
    while remaining:
        least = min(free(open) for open, _ in remaining)
        block = [each for each in remaining if free(each[0]) == least]
        bound.update(term for open, _ in block for term in open)
        found.append(block[0][1])
        remaining.remove(block[0])
    return found


def _open_places(triple: Triple) -> list[Variable | BlankNode]:
    places = (triple.subject, triple.predicate, triple.object)
    return [place for place in places if isinstance(place, Variable | BlankNode)]


def _order(term: object) -> tuple[int, str]:
    kinds = (BlankNode, Variable, NamedNode, Literal)
    kind = next((number for number, one in enumerate(kinds) if isinstance(term, one)), len(kinds))
    return kind, getattr(term, "value", "") or str(term)
