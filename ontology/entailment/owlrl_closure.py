"""The OWL 2 RL closure by owlrl (SPEC §2). `closure` says when it is needed.

It takes 0.4 s for the shipped ontologies and seconds for thousands of triples. Their closure comes
with the package: `python -m dyknow.ontology.entailment.owlrl_closure` writes it, and prints size
and time.
"""

from __future__ import annotations

import time
from collections.abc import Collection
from decimal import Decimal, InvalidOperation
from typing import TypeAlias

import owlrl
import rdflib
from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from ...rdf.namespaces import OWL, RDFS, XSD
from ..errors import OntologyError
from ..shipped_files import SHIPPED_CLOSURE, shipped_hashes, shipped_ontologies
from .closure_key import closure_key
from .deep_hierarchies import MARKERS, is_standard
from .separation import Separation

_TOP = NamedNode(OWL + "Thing")
_REFLEXIVE = frozenset(
    {
        OWL + "sameAs",
        OWL + "equivalentClass",
        OWL + "equivalentProperty",
        RDFS + "subClassOf",
        RDFS + "subPropertyOf",
    }
)
RdflibTerm: TypeAlias = rdflib.URIRef | rdflib.BNode | rdflib.Literal


def closure_of(asserted: frozenset[Triple]) -> frozenset[Triple]:
    """Return the triples that OWL 2 RL adds to ``asserted``, without noise.

    Noise is: triples about literals; triples about terms of RDF, OWL and XSD, except those above
    ``owl:Thing``; and triples that state only that a thing equals or contains itself. Raises
    `OntologyError` for contradicting ontologies. Cost: quadratic in the triples and worse, for
    example for long lists and chains of ``owl:sameAs``. A service that accepts ontologies of
    strangers therefore runs it in a process that it can stop.
    """
    separation = Separation(asserted)
    closed = separation.merge_closure(owlrl_closure(separation.rest))
    if closed is None:
        closed = owlrl_closure(asserted)
    return frozenset(
        triple for triple in closed if triple not in asserted and not _is_noise(triple)
    )


def owlrl_closure(asserted: Collection[Triple]) -> set[Triple]:
    """Return ``asserted`` and the triples that owlrl adds, without noise."""
    graph = rdflib.Graph()
    for triple in asserted:
        graph.add(to_rdflib(triple))
    # Runs the semantics without owlrl's wrapper, which would replace rdflib's datatype tables for
    # the whole process.
    semantics = owlrl.OWLRL_Semantics(graph, False, False, False)
    try:
        semantics.closure()
    except ArithmeticError:
        # owlrl reports literals that are no values, except decimals: Decimal raises another error.
        wrong = next((each for each in asserted if _is_no_decimal(each.object)), None)
        if wrong is None:
            raise
        raise OntologyError(f"{wrong.object} is no decimal, in the triple {wrong}") from None
    if semantics.error_messages:
        raise OntologyError(f"the ontologies contradict themselves: {semantics.error_messages[0]}")
    return {
        triple
        for found in graph
        if not isinstance(found[0], rdflib.Literal) and isinstance(found[1], rdflib.URIRef)
        if not _is_noise(triple := from_rdflib(*found))
    }


def _is_no_decimal(term: object) -> bool:
    if not isinstance(term, Literal) or term.datatype.value != XSD + "decimal":
        return False
    try:
        Decimal(term.value)
    except InvalidOperation:
        return True
    return False


def to_rdflib(triple: Triple) -> tuple[RdflibTerm, RdflibTerm, RdflibTerm]:
    """Convert a triple to rdflib's terms; blank nodes keep their names."""
    return _term(triple.subject), _term(triple.predicate), _term(triple.object)


def from_rdflib(subject: object, predicate: object, object: object) -> Triple:
    """Convert a triple to Oxigraph's terms."""
    first, second, third = _node(subject), _node(predicate), _node(object)
    assert isinstance(first, NamedNode | BlankNode)
    assert isinstance(second, NamedNode)
    return Triple(first, second, third)


def _term(term: object) -> RdflibTerm:
    match term:
        case NamedNode():
            return rdflib.URIRef(term.value)
        case BlankNode():
            return rdflib.BNode(term.value)
        case Literal():
            if term.language is not None:
                return rdflib.Literal(term.value, lang=term.language)
            if term.datatype.value == XSD + "string":
                return rdflib.Literal(term.value)
            # normalize=False: "01" must stay "01".
            return rdflib.Literal(
                term.value, datatype=rdflib.URIRef(term.datatype.value), normalize=False
            )
        case _:
            raise OntologyError(f"not an RDF 1.1 term: {term}")


def _node(term: object) -> NamedNode | BlankNode | Literal:
    match term:
        case rdflib.URIRef():
            return NamedNode(str(term))
        case rdflib.BNode():
            return BlankNode(str(term))
        case rdflib.Literal():
            if term.language is not None:
                return Literal(str(term), language=term.language)
            if term.datatype is None:
                return Literal(str(term))
            return Literal(str(term), datatype=NamedNode(str(term.datatype)))
        case _:
            raise OntologyError(f"not an RDF 1.1 term: {term!r}")


def _is_noise(triple: Triple) -> bool:
    if triple.predicate in MARKERS:
        return False
    subject, object = triple.subject, triple.object
    if subject == object and triple.predicate.value in _REFLEXIVE:
        return True
    if is_standard(subject):
        is_top = subject == _TOP and triple.predicate.value in _REFLEXIVE
        return not is_top or is_standard(object)
    return False


def main() -> None:
    """Write the closure of the shipped ontologies; print its size and time."""
    asserted = frozenset().union(*(ontology.triples() for ontology in shipped_ontologies()))
    start = time.perf_counter()
    added = closure_of(asserted)
    seconds = time.perf_counter() - start
    lines = sorted(f"{triple} .\n" for triple in added)
    key = closure_key(shipped_hashes())
    SHIPPED_CLOSURE.write_text(f"# {key}\n{''.join(lines)}", encoding="utf-8")
    print(f"{len(asserted)} triples asserted, {len(added)} entailed, {seconds:.3f} s")


if __name__ == "__main__":
    main()
