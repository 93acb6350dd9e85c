"""``dyknow sparql``, ``match``, ``explain`` and ``objects``: query the service, and show its
reasons and what it knows."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from .events import STRATEGY
from .output import (
    DEFAULT_URL,
    Json,
    Url,
    clock_ms,
    connect,
    err,
    show_json,
    show_table,
    show_text,
)
from .parameters import MEDIA_TYPES, ResultFormat, parameters_of
from .streams import text_or_file


def sparql(
    query: Annotated[str, typer.Argument(help="A SPARQL query, its file, or - .")],
    default_graph: Annotated[
        list[str] | None,
        typer.Option(help="A graph of the default graph, instead of FROM. May be repeated."),
    ] = None,
    named_graph: Annotated[
        list[str] | None,
        typer.Option(help="A graph that GRAPH reads, instead of FROM NAMED. May be repeated."),
    ] = None,
    parameter: Annotated[
        list[str] | None,
        typer.Option(
            help="A term for a variable: limit=100, sort=dyknow:UAV. May be repeated.",
            metavar="NAME=TERM",
        ),
    ] = None,
    format: ResultFormat = None,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Query the ontology and the live stream space."""
    text = text_or_file(query)
    chosen: dict[str, Any] = {
        "default_graphs": default_graph or (),
        "named_graphs": named_graph or (),
        "parameters": parameters_of(parameter or ()),
    }
    with connect(url) as client:
        if format is not None:
            print(client.sparql_text(text, MEDIA_TYPES[format], **chosen), end="")
            return
        found = client.sparql(text, **chosen)
        if not _has_results(found):
            from .unknown_terms import unknown_terms

            for hint in unknown_terms(client, text):
                err().print(f"hint: {hint}", markup=False)
    if isinstance(found, str):
        show_text(found)
    elif as_json:
        show_json(found)
    else:
        show_bindings(found)


def _has_results(found: dict[str, Any] | str) -> bool:
    if isinstance(found, str):
        return bool(found.strip())
    rows = found.get("results", {}).get("bindings", [])
    if len(rows) == 1:
        # The one row of aggregates over nothing has counts and sums of 0.
        return any(term["value"] != "0" for term in rows[0].values())
    return bool(found.get("boolean") or rows)


def show_bindings(found: dict[str, Any]) -> None:
    """Show SPARQL JSON as a table, or as yes or no."""
    if "boolean" in found:
        show_text("yes" if found["boolean"] else "no")
        return
    names = found["head"]["vars"]
    rows = found["results"]["bindings"]
    if rows:
        show_table(names, [[_term(row.get(name)) for name in names] for row in rows])
    show_text(f"({len(rows)} {'row' if len(rows) == 1 else 'rows'})")


def match(
    feature: Annotated[str, typer.Argument(help="A feature, such as dyknow:speed.")],
    sort: Annotated[str | None, typer.Option(help="For all objects of this sort.")] = None,
    object: Annotated[
        list[str] | None,
        typer.Option(help="For this object. May be repeated: the arguments of an n-ary feature."),
    ] = None,
    strategy: Annotated[str, STRATEGY] = "fast",
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Find a plan for a feature, without starting anything. Status 1 if there is none."""
    with connect(url) as client:
        found = client.match(feature, sort=sort, objects=object or (), strategy=strategy)
    if as_json:
        show_json(found)
    else:
        show_text(f"{found['target']}: {'found' if found['found'] else 'not found'}")
        if found["plan"] is not None:
            show_text(found["plan"]["text"])
            proven = "" if found["proven"] else "; not proven to be the best"
            show_text(f"cost {found['cost']:g}, quality {found['quality']:g}{proven}")
        _section("why", found["reasons"])
        _section("also considered", found["alternatives"])
    if not found["found"]:
        raise typer.Exit(1)


def explain(
    event: Annotated[
        str | None, typer.Argument(help="A request: 'dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)'.")
    ] = None,
    template: Annotated[str | None, typer.Option(help="A template's name.")] = None,
    query: Annotated[str | None, typer.Option(help="REGISTER text, its file, or - .")] = None,
    id: Annotated[str | None, typer.Option(help="A running request.")] = None,
    feature: Annotated[str | None, typer.Option(help="A feature to match.")] = None,
    since: Annotated[
        str | None,
        typer.Option(
            help="Also try a request or a query on what is kept: from the start, a time, or a "
            "duration before the newest sample."
        ),
    ] = None,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Explain a request, a template, a query or a match, stage by stage. Status 1 if there is no
    plan."""
    if sum(value is not None for value in (event, template, query, id, feature)) != 1:
        raise typer.BadParameter("name one of: a request, --template, --query, --id, --feature")
    thing = {"event": event, "template": template, "id": id, "feature": feature, "since": since}
    thing["query"] = None if query is None else text_or_file(query)
    from ..client.errors import ServiceError

    with connect(url) as client:
        try:
            found = client.explanation(**thing)
        except ServiceError as error:
            if "stages" not in error.problem:
                raise
            found = error.problem
    if as_json:
        show_json(found)
    else:
        show_text(found["text"])
    if not found["found"]:
        raise typer.Exit(1)


def objects(
    name: Annotated[
        str | None, typer.Argument(help="Only this object: its id in samples, dyknow:uav1 or IRI.")
    ] = None,
    sort: Annotated[
        str | None, typer.Option(help="Only objects of this sort, such as dyknow:UAV.")
    ] = None,
    limit: Annotated[int, typer.Option(min=1, max=1000, help="Objects at most.")] = 100,
    after: Annotated[
        str | None, typer.Option(help="Begin after this IRI, the last of the list before.")
    ] = None,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """List the known objects; with a name, show its sorts and its newest values."""
    if name is not None and (sort, after) != (None, None):
        raise typer.BadParameter("--sort and --after are for the list: leave the name out")
    with connect(url) as client:
        if name is not None:
            found = client.object(name)
        else:
            found = client.objects(sort, after=after, limit=limit)
    if as_json:
        show_json(found)
    elif name is not None:
        _show_one(found)
    else:
        _show_list(found)


def _show_list(found: dict[str, Any]) -> None:
    rows = [(each["name"], ", ".join(each["sorts"][:1])) for each in found["objects"]]
    show_table(["object", "sort"], rows, unfolded=["object"], empty="no such objects are known")
    if found["more"]:
        last = found["objects"][-1]["iri"]
        err().print(f"hint: there are more: --after '{last}'", markup=False)


def _show_one(found: dict[str, Any]) -> None:
    show_text(f"{found['name']}: {', '.join(found['sorts']) or 'of no known sort'}")
    show_table(
        ["feature", "value", "unit", "of", "valid", "stream"],
        [
            (
                each["feature"],
                each["value"],
                each["unit"],
                ", ".join(each["of"]),
                clock_ms(each["valid"]),
                each["stream"],
            )
            for each in found["features"]
        ],
        unfolded=["stream"],
        empty="no stream has a value of it",
    )


def _section(title: str, lines: list[str]) -> None:
    if lines:
        show_text(f"{title}:")
        for line in lines:
            show_text(f"  - {line}")


def _term(term: dict[str, Any] | None) -> str:
    if term is None:
        return "-"
    from ...rdf.namespaces import shorten

    return shorten(term["value"]) if term["type"] == "uri" else str(term["value"])
