"""Validates the stream space by SHACL shapes and pyshacl (SPEC §2)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import pyshacl
import rdflib
from pyoxigraph import Triple

from .entailment.owlrl_closure import to_rdflib
from .shipped_files import shapes_text

_SH = rdflib.Namespace("http://www.w3.org/ns/shacl#")


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
    data = rdflib.Graph()
    for triple in triples:
        data.add(to_rdflib(triple))
    shapes = rdflib.Graph().parse(data=shapes_text(), format="turtle")
    conforms, report, text = pyshacl.validate(
        data, shacl_graph=shapes, inference="none", do_owl_imports=False, advanced=False, js=False
    )
    return ShaclReport(bool(conforms), str(text), tuple(_violations(report)))


def _violations(report: rdflib.Graph) -> list[Violation]:
    found = []
    for result in report.subjects(rdflib.RDF.type, _SH.ValidationResult):
        node, path = report.value(result, _SH.focusNode), report.value(result, _SH.resultPath)
        message = report.value(result, _SH.resultMessage)
        found.append(
            Violation(str(node), None if path is None else str(path), str(message or "refused"))
        )
    return sorted(found, key=lambda each: (each.node, each.message))
