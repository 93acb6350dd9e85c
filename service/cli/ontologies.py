"""``dyknow ontology``: domain ontologies and single terms."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ...ontology.texts.formats import FORMATS
from ..config.media_types import JSON_LD, NTRIPLES, RDF_XML, TURTLE
from .ontology_terms import add_feature, add_sort
from .output import (
    DEFAULT_URL,
    Json,
    Url,
    connect,
    fail,
    show_json,
    show_lines,
    show_text,
)
from .streams import read_text

_OF_FORMATS = {"turtle": TURTLE, "rdfxml": RDF_XML, "jsonld": JSON_LD, "ntriples": NTRIPLES}
MEDIA_TYPES = {suffix: _OF_FORMATS[format] for suffix, format in FORMATS.items()}
"""The media type of an ontology file, by its suffix."""

ontology = typer.Typer(
    help="Domain ontologies: add, add-feature, add-sort, list, show, remove, check.",
    no_args_is_help=True,
)
ontology.command()(add_feature)
ontology.command()(add_sort)


@ontology.command()
def add(
    file: Annotated[
        Path,
        typer.Argument(help="An ontology: .ttl, .rdf, .owl, .xml, .jsonld or .nt."),
    ],
    name: Annotated[
        str | None,
        typer.Option(help="Its IRI. Default: that of the owl:Ontology in it.", metavar="IRI"),
    ] = None,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Add a domain ontology, or replace the one of its name."""
    kind = MEDIA_TYPES.get(file.suffix.lower())
    if kind is None:
        raise fail(f"{file} is of an unknown kind", f"name it with one of {', '.join(MEDIA_TYPES)}")
    if not file.is_file():
        raise fail(f"there is no file {file}")
    text = read_text(file)
    with connect(url) as client:
        found = client.load_ontology(text, name, kind)
    if as_json:
        show_json(found)
    else:
        show_text(f"loaded {found['name']}")


@ontology.command("list")
def list_ontologies(url: Url = DEFAULT_URL, as_json: Json = False) -> None:
    """List the loaded ontologies."""
    with connect(url) as client:
        found = client.ontologies()
    if as_json:
        show_lines(found)
        return
    for name in found:
        show_text(name)


Name = Annotated[str, typer.Argument(help="The ontology's IRI, or its short name.")]


@ontology.command()
def show(name: Name, url: Url = DEFAULT_URL) -> None:
    """Print the triples of an ontology as Turtle."""
    with connect(url) as client:
        show_text(client.ontology(name))


@ontology.command()
def remove(name: Name, url: Url = DEFAULT_URL) -> None:
    """Remove an ontology, unless something uses its terms: then list what does."""
    with connect(url) as client:
        client.remove_ontology(name)
    show_text(f"removed {name}")


@ontology.command()
def check(url: Url = DEFAULT_URL, as_json: Json = False) -> None:
    """Validate the ontologies and the running streams against the shapes of a stream space.

    Status 1 if there are violations.
    """
    with connect(url) as client:
        found = client.ontology_report()
    if as_json:
        show_json(found)
    elif found["conforms"]:
        show_text("well-formed")
    else:
        for each in found["violations"]:
            show_text(f"{each['node']}: {each['message']}")
    if not found["conforms"]:
        raise typer.Exit(1)
