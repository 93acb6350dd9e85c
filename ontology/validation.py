"""Validates the stream space by SHACL shapes and pyshacl (SPEC §2)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pyoxigraph import Triple

from .shipped_files import shapes_text

if TYPE_CHECKING:
    import rdflib

_SHACL = "http://www.w3.org/ns/shacl#"


@dataclass(frozen=True, slots=True)
class Violation:
    """A node that violates a shape, and the reason; ``path`` is the property concerned, if there is
    one."""

    node: str
    path: str | None
    message: str


@dataclass(frozen=True, slots=True)
class ShaclReport:
    """Whether the data conforms, with a report for people."""

    conforms: bool
    text: str
    violations: tuple[Violation, ...] = ()


def validate(triples: Iterable[Triple]) -> ShaclReport:
    """Check closed triples against shapes.ttl. Nothing is fetched or inferred."""
    # Imported here: they take half a second, and only interactive requests need them.
    import pyshacl
    import rdflib

    from .entailment.owlrl_closure import to_rdflib

    data = rdflib.Graph()
    for triple in triples:
        data.add(to_rdflib(triple))
    shapes = rdflib.Graph().parse(data=shapes_text(), format="turtle")
    conforms, report, text = pyshacl.validate(
        data, shacl_graph=shapes, inference="none", do_owl_imports=False, advanced=False, js=False
    )
    return ShaclReport(bool(conforms), str(text), tuple(_violations(report)))


def _violations(report: rdflib.Graph) -> list[Violation]:
    from rdflib import RDF, Namespace

    sh = Namespace(_SHACL)
    found = []
    for result in report.subjects(RDF.type, sh.ValidationResult):
        node, path = report.value(result, sh.focusNode), report.value(result, sh.resultPath)
        message = report.value(result, sh.resultMessage)
        found.append(
            Violation(str(node), None if path is None else str(path), str(message or "refused"))
        )
    return sorted(found, key=lambda each: (each.node, each.message))
