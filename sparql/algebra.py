"""The parts of a group as SPARQL's algebra has them (SPARQL 1.1 §18.2.2.2, §18.2.2.5)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from pyoxigraph import BlankNode, Literal, NamedNode, Variable

from .ast import Element, Expression, Filter, Group, Triple, Triples


def split_group(group: Group) -> tuple[list[Element], list[Expression]]:
    """The parts of a group without its filters, and the conditions of these: they hold for all of
    the group. Triples are those of a whole basic graph pattern, which no filter ends."""
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
    """Triple patterns in the order in which they are joined where nothing else is known: few
    variables that are free after those before, and many that others have, too.

    The names of streams that are made for a request, and what GROUP_CONCAT and SAMPLE give, follow
    from this order. It stays what it was, for data directories that are replayed.
    """
    remaining = list(triples)
    counts = Counter(term for triple in remaining for term in _open_places(triple))
    bound: set[Variable | BlankNode] = set()
    found: list[Triple] = []

    def rank(triple: Triple) -> tuple[int, int, bool, tuple[tuple[int, str], ...]]:
        open = _open_places(triple)
        free = sum(1 for term in open if term not in bound)
        shared = -sum(counts[term] for term in open)
        places = (triple.subject, triple.predicate, triple.object)
        return free, shared, not isinstance(triple.object, Literal), tuple(map(_order, places))

    while remaining:
        remaining = [one for _, _, one in sorted((rank(t), n, t) for n, t in enumerate(remaining))]
        least = rank(remaining[0])[0]
        block = [triple for triple in remaining if rank(triple)[0] == least]
        bound.update(term for triple in block for term in _open_places(triple))
        found.append(remaining.pop(0))
    return found


def _open_places(triple: Triple) -> list[Variable | BlankNode]:
    places = (triple.subject, triple.predicate, triple.object)
    return [place for place in places if isinstance(place, Variable | BlankNode)]


def _order(term: object) -> tuple[int, str]:
    kinds = (BlankNode, Variable, NamedNode, Literal)
    kind = next((number for number, one in enumerate(kinds) if isinstance(term, one)), len(kinds))
    return kind, getattr(term, "value", "") or str(term)
