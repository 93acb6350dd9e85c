"""``dyknow ontology add-feature`` and ``add-sort``: one term, without a file of Turtle.

Each term is an ontology of its own: adding one keeps the others, and `remove` takes it back.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..config.media_types import TURTLE
from .output import DEFAULT_URL, Json, Url, connect, fail, show_json, show_text

if TYPE_CHECKING:
    from ..client.client import Client

Name = Annotated[
    str, typer.Argument(help="The term's name: temperature, dyknow:temperature or <IRI>.")
]
Comment = Annotated[str | None, typer.Option(help="What the term means, in a sentence.")]


_DATATYPES = ("string", "boolean", "integer", "decimal", "float", "double", "dateTime")
"""Datatypes that need no prefix, as no sort begins with a small letter."""


def add_feature(
    name: Name,
    sort: Annotated[
        str, typer.Option(help="Whatever has the feature is of this sort.")
    ] = "dyknow:Thing",
    unit: Annotated[
        str | None, typer.Option(help="The unit of its numbers, such as degC or m.s-1.")
    ] = None,
    range: Annotated[
        str,
        typer.Option(
            help="The datatype of its values (string, boolean, integer, double), or the sort "
            "of the objects that it names."
        ),
    ] = "xsd:double",
    comment: Comment = None,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Add a feature of one object. Adding it again replaces it."""
    from ...engine.catalog.name_resolution import iri_of
    from ...ontology.units import UnitError, format_unit, parse_unit
    from ...rdf.namespaces import OWL, RDFS, STREAM_SPACE, XSD, shorten

    try:
        unit = None if unit is None else format_unit(parse_unit(unit))
    except UnitError as error:
        raise fail(str(error)) from error
    iri, domain = iri_of(name), iri_of(sort)
    values = f"{XSD}{range}" if range in _DATATYPES else iri_of(range)
    is_datatype = values.startswith(XSD)
    kind = "DatatypeProperty" if is_datatype else "ObjectProperty"
    parts = [
        f"a <{STREAM_SPACE}UnaryFeature>, <{OWL}{kind}>",
        f"<{RDFS}domain> <{domain}>",
        f"<{RDFS}range> <{values}>",
    ]
    if unit is not None:
        parts.append(f'<{STREAM_SPACE}hasUnit> "{unit}"')
    with connect(url) as client:
        known = client.vocabulary()
        _check_sort(known, domain)
        if not is_datatype:
            _check_sort(known, values)
        there = {each["name"]: each for each in known["features"]}.get(shorten(iri))
        if there is not None and not _is_own(client, iri, "feature"):
            if (there["unit"], there["domain"]) == (unit, shorten(domain)):
                _report({"name": iri}, f"{shorten(iri)} is there already", as_json)
                return
            raise fail(
                f"there is a feature {shorten(iri)} already, in {there['unit'] or 'no unit'}, "
                f"of {there['domain'] or 'any object'}",
                "use it as it is, or give yours another name",
            )
        _check_free(known, iri, "feature")
        found = _load(client, iri, "feature", parts, comment)
    unit_text = "" if unit is None else f" [{unit}]"
    of = "" if values == f"{XSD}double" else f", whose values are {shorten(values)}"
    _report(found, f"added {shorten(iri)}{unit_text} of {shorten(domain)}{of}", as_json)


def add_sort(
    name: Name,
    under: Annotated[str, typer.Option(help="The sort that contains it.")] = "dyknow:Thing",
    comment: Comment = None,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Add a sort of objects. Adding it again replaces it."""
    from ...engine.catalog.name_resolution import iri_of
    from ...rdf.namespaces import OWL, RDFS, shorten

    iri, above = iri_of(name), iri_of(under)
    parts = [f"a <{OWL}Class>", f"<{RDFS}subClassOf> <{above}>"]
    with connect(url) as client:
        known = client.vocabulary()
        _check_sort(known, above)
        there = any(each["name"] == shorten(iri) for each in known["sorts"])
        if there and not _is_own(client, iri, "sort"):
            _report({"name": iri}, f"{shorten(iri)} is there already", as_json)
            return
        _check_free(known, iri, "sort")
        found = _load(client, iri, "sort", parts, comment)
    _report(found, f"added {shorten(iri)}, a {shorten(above)}", as_json)


def _ontology_name(iri: str, kind: str) -> str:
    """Return the name of the ontology of one term: ``feature-temperature`` under ``dyknow:``."""
    from ...ontology.graphs import ontology_graph
    from ...rdf.namespaces import DYKNOW

    local = iri.removeprefix(DYKNOW)
    return iri if local == iri else ontology_graph(f"{kind}-{local}").value


def _is_own(client: Client, iri: str, kind: str) -> bool:
    """Whether an earlier call of this command added the term."""
    return _ontology_name(iri, kind) in client.ontologies()


def _check_sort(known: Mapping[str, Any], iri: str) -> None:
    from ...rdf.namespaces import shorten

    if not any(each["name"] == shorten(iri) for each in known["sorts"]):
        raise fail(
            f"the ontology knows no sort {shorten(iri)}",
            f"add it first: dyknow ontology add-sort {shorten(iri)}",
        )


def _check_free(known: Mapping[str, Any], iri: str, kind: str) -> None:
    """Refuse a name that means something else."""
    from ...rdf.namespaces import shorten

    name = shorten(iri)
    taken = {
        "sort": [each["name"] for each in known["sorts"]],
        "feature": [each["name"] for each in known["features"]],
        "event": known["events"],
    }
    for other, names in taken.items():
        if other != kind and name in names:
            raise fail(f"the name {name} is taken: it means a known {other}", "choose another name")


def _load(
    client: Client, iri: str, kind: str, parts: list[str], comment: str | None
) -> dict[str, Any]:
    """Load the ontology of one term, described by predicates with objects in Turtle."""
    from pyoxigraph import Literal

    from ...rdf.namespaces import RDFS

    if comment is not None:
        parts = [*parts, f"<{RDFS}comment> {Literal(comment)}"]
    described = " ;\n    ".join(parts)
    return client.load_ontology(f"<{iri}> {described} .\n", _ontology_name(iri, kind), TURTLE)


def _report(found: Mapping[str, Any], text: str, as_json: bool) -> None:
    if as_json:
        show_json(found)
    else:
        show_text(text)
