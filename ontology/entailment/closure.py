"""The closures of the loaded ontologies that are known, or else computed (SPEC §2).

A closure changes when an ontology does, never for an event. That of the shipped ontologies comes
with the package. `rules` maintain the closure of the live stream space instead.
"""

from __future__ import annotations

from functools import cache, lru_cache

from pyoxigraph import RdfFormat, Triple, parse

from ..shipped_files import SHIPPED_CLOSURE


@lru_cache(maxsize=4)
def cached_closure(asserted: frozenset[Triple]) -> frozenset[Triple]:
    """`owlrl_closure.closure_of` with a cache of four closures. Many engines of one process, as in
    tests, start from the same ontologies."""
    # Imported here: rdflib takes a tenth of a second, and most starts compute no closure.
    from .owlrl_closure import closure_of

    return closure_of(asserted)


def shipped_closure(key: str) -> frozenset[Triple] | None:
    """Return the closure of the shipped ontologies; None if it does not have this key, as with
    another version of owlrl."""
    first, triples = _shipped()
    return triples if first == f"# {key}" else None


@cache
def _shipped() -> tuple[str, frozenset[Triple]]:
    """The first line of the file, and its triples."""
    first, _, lines = SHIPPED_CLOSURE.read_text(encoding="utf-8").partition("\n")
    return first, frozenset(quad.triple for quad in parse(lines, RdfFormat.N_TRIPLES))
