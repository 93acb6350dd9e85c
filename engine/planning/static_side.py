"""The static side of queries and patterns: the ontologies and their entailments."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from pyoxigraph import NamedNode, Store

from ...continuous.operators.background import Background
from ...ontology.ontology import Ontology
from ...ontology.units import Conversion, UnitError, conversion
from ..model.errors import NoPlan


def closed_ontology(ontology: Ontology, named: Sequence[str] = ()) -> Background:
    """Return the static side of queries: the present ontologies and their entailments.

    ``named``: ontologies that a query names with FROM NAMED, which it sees as named graphs too.
    """
    if not named:
        return _background(ontology, ontology.closed_store)
    stores: list[tuple[int, Store]] = []

    def store() -> Store:
        if not stores or stores[0][0] != ontology.version:
            store_with_graphs = Store()
            store_with_graphs.extend(ontology.closed_store())
            for iri in named:
                store_with_graphs.extend(
                    ontology.static_store.quads_for_pattern(None, None, None, NamedNode(iri))
                )
            stores[:] = [(ontology.version, store_with_graphs)]
        return stores[0][1]

    return _background(ontology, store)


def _background(ontology: Ontology, store: Callable[[], Store]) -> Background:
    def change(source: str, target: str) -> Conversion | None:
        features = [ontology.vocabulary.feature(iri) for iri in (source, target)]
        units = [None if feature is None else feature.unit for feature in features]
        if units[0] is None or units[1] is None or units[0] == units[1]:
            return None
        try:
            return conversion(units[0], units[1])
        except UnitError:
            return None

    return Background(
        store, lambda: ontology.version, rules=lambda: ontology.rules, conversion=change
    )


def check_graphs(ontology: Ontology, static: Iterable[str], named: Iterable[str]) -> None:
    """Raise `NoPlan` unless the graphs of FROM and of FROM NAMED are loaded ontologies."""
    clauses = (("FROM", static), ("FROM NAMED", named))
    for clause, graph in ((clause, graph) for clause, graphs in clauses for graph in graphs):
        if not ontology.has_ontology(graph):
            loaded = ", ".join(f"<{iri}>" for iri in ontology.ontologies())
            raise NoPlan(
                f"{clause} <{graph}> names no loaded ontology",
                (graph,),
                "the service does not fetch graphs: load it (POST /ontologies), or leave "
                f"{clause} out; loaded are {loaded}",
            )
