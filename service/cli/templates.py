"""``dyknow template``: register, list, show and remove event templates."""

from __future__ import annotations

from collections.abc import Mapping
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
)
from .streams import text_or_file

template = typer.Typer(help="Event templates: add, list, show, remove.", no_args_is_help=True)


@template.command()
def add(
    source: Annotated[
        str | None, typer.Argument(help="REGISTER TEMPLATE text, its file, or - .")
    ] = None,
    library: Annotated[
        str | None,
        typer.Option(
            help="Instead of a text, a template of the package: high_speed, low_altitude.",
            metavar="NAME",
        ),
    ] = None,
    replace: Annotated[
        str | None, typer.Option(help="Replace the template of this name.", metavar="NAME")
    ] = None,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Register a template."""
    if (source is None) == (library is None):
        raise typer.BadParameter("pass a text, or --library with the name of a shipped template")
    text = _shipped(library) if library is not None else text_or_file(source or "")
    with connect(url) as client:
        found = client.register_template(text, replace=replace)
    if as_json:
        show_json(found)
    else:
        show_text(f"registered {found['local_name']}({_parameters(found)})")


@template.command("list")
def list_templates(url: Url = DEFAULT_URL, as_json: Json = False) -> None:
    """List the templates."""
    with connect(url) as client:
        found = client.templates()
    if as_json:
        show_lines(found)
        return
    show_table(
        ["template", "parameters", "event"],
        [(t["local_name"], _parameters(t), t["name"]) for t in found],
        empty="no templates yet: dyknow template add FILE",
    )


@template.command()
def show(
    name: Annotated[str, typer.Argument(help="The event's name.")],
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Print a template's text."""
    with connect(url) as client:
        found = client.template(name)
    if as_json:
        show_json(found)
    else:
        show_text(found["source"])


@template.command()
def remove(
    name: Annotated[str, typer.Argument(help="The event's name.")], url: Url = DEFAULT_URL
) -> None:
    """Remove a template."""
    with connect(url) as client:
        client.remove_template(name)
    show_text(f"removed {name}")


def _shipped(name: str) -> str:
    from ...templates.library import shipped_texts

    texts = shipped_texts()
    if name not in texts:
        raise fail(f"the package has no template {name!r}", f"it has {', '.join(texts)}")
    return texts[name]


def _parameters(template: Mapping[str, Any]) -> str:
    """The parameters of a template, with their defaults."""
    return ", ".join(
        each["name"] if each["default"] is None else f"{each['name']} = {each['default']}"
        for each in template["uses"]
    )
