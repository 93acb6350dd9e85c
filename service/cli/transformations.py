"""``dyknow transformation``: register, list, show and remove transformations."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer

from .output import (
    DEFAULT_URL,
    Json,
    Url,
    connect,
    fail,
    show_json,
    show_lines,
    show_table,
    show_text,
    show_values,
)
from .parameters import parameters_of
from .streams import text_or_file

transformation = typer.Typer(help="Transformations: add, list, show, remove.", no_args_is_help=True)


@transformation.command()
def add(
    source: Annotated[
        str | None,
        typer.Argument(help="Turtle, JSON or SSL: a file, - , or the text itself."),
    ] = None,
    annotation: Annotated[
        str | None, typer.Option(help="One `compunit` or `source` in SSL.", metavar="SSL")
    ] = None,
    implementation: Annotated[
        str | None,
        typer.Option(help="With SSL: the code, if it has another name.", metavar="NAME"),
    ] = None,
    parameter: Annotated[
        list[str] | None,
        typer.Option(
            help="With SSL: a parameter of the code. May be repeated.", metavar="NAME=VALUE"
        ),
    ] = None,
    cost: Annotated[float | None, typer.Option(help="With SSL: the cost of a unit.")] = None,
    quality: Annotated[float | None, typer.Option(help="With SSL: the quality, 0 to 1.")] = None,
    replace: Annotated[
        str | None, typer.Option(help="Replace the transformation of this name.", metavar="NAME")
    ] = None,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Register a transformation, or several in Turtle: all of them, or none."""
    if (source is None) == (annotation is None):
        raise typer.BadParameter("pass a file, or SSL with --annotation")
    text = annotation if annotation is not None else text_or_file(source or "")
    options = {"implementation": implementation, "cost": cost, "quality": quality}
    more: dict[str, Any] = {key: value for key, value in options.items() if value is not None}
    if parameter:
        more["parameters"] = parameters_of(parameter)
    with connect(url) as client:
        found = client.register_transformation(_description(text, more), replace=replace)
    if as_json:
        show_lines(found)
        return
    for each in found:
        show_text(f"registered {each['text']}")


@transformation.command("list")
def list_transformations(url: Url = DEFAULT_URL, as_json: Json = False) -> None:
    """List the transformations."""
    with connect(url) as client:
        found = client.transformations()
    if as_json:
        show_lines(found)
        return
    show_table(
        ["transformation", "takes and gives", "cost", "quality", "units", "lacks"],
        [
            (
                each["name"],
                str(each["text"]).removeprefix(f"{each['name']} : "),
                each["cost"],
                each["quality"],
                len(each["units"]),
                each["lacks"] or None,
            )
            for each in found
        ],
        unfolded=["transformation"],
    )


@transformation.command()
def show(
    name: Annotated[str, typer.Argument(help="The transformation's name.")],
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Print the details of a transformation."""
    with connect(url) as client:
        found = client.transformation(name)
    if as_json:
        show_json(found)
        return
    show_text(found["text"])
    show_text(f"  annotation      {found['annotation']}".replace("\n", "\n" + " " * 18))
    show_text(f"  implementation  {found['implementation']}")
    show_text(f"  parameters      {show_values(found['parameters']) or '-'}")
    show_text(f"  cost, quality   {found['cost']:g}, {found['quality']:g}")
    show_text(f"  units           {', '.join(found['units']) or '-'}")
    if found["lacks"]:
        show_text(f"  lacks           {found['lacks']}")


@transformation.command()
def remove(
    name: Annotated[str, typer.Argument(help="The transformation's name.")],
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Remove a transformation."""
    with connect(url) as client:
        client.remove_transformation(name)
    if as_json:
        show_json({"removed": name})
    else:
        show_text(f"removed {name}")


def _description(text: str, more: dict[str, Any]) -> dict[str, Any] | str:
    """Return the body: JSON or Turtle unchanged, SSL with the options."""
    words = text.split(maxsplit=1)
    if words and words[0] in ("compunit", "source"):
        return {"annotation": text, **more}
    if more:
        raise typer.BadParameter(
            "JSON and Turtle contain code, parameters, cost and quality themselves"
        )
    if not text.lstrip().startswith("{"):
        return text
    try:
        found: dict[str, Any] = json.loads(text)
    except ValueError as error:
        raise fail(f"malformed JSON: {error}") from error
    return found
