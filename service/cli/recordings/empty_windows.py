"""Why no window of ``dyknow run`` has a result: what of the query no triple speaks of."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from pyoxigraph import NamedNode, QuerySolutions, Store

from ....continuous.evaluate import TimedTerm
from ....continuous.operators.background import Background
from ....languages.csparql import body_tree, parse_query
from ....rdf.namespaces import OWL, RDF_TYPE, RDFS, shorten
from ....rdf.timed import TimedTriples
from ....templates.patterns import patterns

_PROPERTIES: Final = (
    f"<{RDFS}subPropertyOf>|<{OWL}equivalentProperty>|^<{OWL}equivalentProperty>"
    f"|<{OWL}inverseOf>|^<{OWL}inverseOf>"
)
_CLASSES: Final = f"<{RDFS}subClassOf>|<{OWL}equivalentClass>|^<{OWL}equivalentClass>"
_SCHEMA: Final = f"<{RDFS}domain>|<{RDFS}range>"


class Traffic:
    """The predicates and sorts of the triples of all streams, and how many triples there were."""

    def __init__(self) -> None:
        self.triples = 0
        self._predicates: set[str] = set()
        self._sorts: set[str] = set()

    def watch(self, given: Any) -> Any:
        """``given``, whose triples are counted, at once or as they are read."""
        if isinstance(given, TimedTriples):
            self._count_columns(given)
            return given
        if not isinstance(given, list):
            return self._counted(given)
        for _ in self._counted(given):
            pass
        return given

    def _counted(self, given: Iterable[TimedTerm]) -> Iterator[TimedTerm]:
        for triple in given:
            self.triples += 1
            self._note(triple[2], triple[3])
            yield triple

    def _count_columns(self, given: TimedTriples) -> None:
        term = given.dictionary.term
        for table in given.tables:
            self.triples += table.triples
            if table.sort is not None and len(table):
                self._note(RDF_TYPE, term(table.sort))
            for id, column in table.objects.items():
                predicate = term(id)
                if predicate == RDF_TYPE:
                    for sort in np.unique(column.held_ids).tolist():
                        self._note(predicate, term(sort))
                elif bool(column.present.any()):
                    self._note(predicate, None)

    def _note(self, predicate: object, object: object) -> None:
        assert isinstance(predicate, NamedNode)
        self._predicates.add(predicate.value)
        if predicate == RDF_TYPE and isinstance(object, NamedNode):
            self._sorts.add(object.value)

    def why_empty(self, text: str, static: list[Path] | Mapping[str, Path]) -> str:
        """``40 triples read: no member of dyknow:Car seen``, of a query without a result."""
        store = Background.from_files(static).store
        lacking: dict[str, None] = {}
        for pattern in patterns(body_tree(parse_query(text))):
            predicate, object = pattern.predicate, pattern.object
            if not isinstance(predicate, NamedNode):
                continue
            if predicate != RDF_TYPE:
                if not self._has_triple(store, predicate):
                    lacking[f"no triple of {shorten(predicate.value)}"] = None
            elif isinstance(object, NamedNode) and not self._has_member(store, object):
                lacking[f"no member of {shorten(object.value)} seen"] = None
        reason = "; ".join(lacking) or "no window satisfied the query's conditions"
        return f"{self.triples:,} triples read: {reason}"

    def _has_triple(self, store: Store, predicate: NamedNode) -> bool:
        """Whether some triple has the predicate, or one that may entail it."""
        return any(
            name in self._predicates or _holds(store, None, NamedNode(name), None)
            for name in _below(store, predicate, _PROPERTIES)
        )

    def _has_member(self, store: Store, sort: NamedNode) -> bool:
        """Whether something is of the sort, or may be by what the schema says."""
        for name in _below(store, sort, _CLASSES):
            node = NamedNode(name)
            if name in self._sorts or _holds(store, None, RDF_TYPE, node):
                return True
            stated = _column(store, f"SELECT ?q {{ ?q {_SCHEMA} {node} }}")
            if any(self._has_triple(store, NamedNode(each)) for each in stated):
                return True
        return False


def _below(store: Store, term: NamedNode, path: str) -> set[str]:
    return {term.value, *_column(store, f"SELECT ?q {{ ?q ({path})+ {term} }}")}


def _column(store: Store, query: str) -> list[str]:
    found = store.query(query, use_default_graph_as_union=True)
    assert isinstance(found, QuerySolutions)
    return [row[0].value for row in found if isinstance(row[0], NamedNode)]


def _holds(store: Store, *pattern: NamedNode | None) -> bool:
    subject, predicate, object = pattern
    return next(store.quads_for_pattern(subject, predicate, object, None), None) is not None
