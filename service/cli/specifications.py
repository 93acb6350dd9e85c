"""``dyknow specification``: apply a specification in XML, and show the configuration as one."""

from __future__ import annotations

from typing import Annotated

import typer

from .output import (
    DEFAULT_URL,
    Json,
    Url,
    connect,
    show_json,
    show_table,
    show_text,
)
from .streams import text_or_file

specification = typer.Typer(help="Specifications in XML: apply, show, list.", no_args_is_help=True)


@specification.command()
def apply(
    source: Annotated[str, typer.Argument(help="A file, - , or the text itself.")],
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Insert and remove units: the whole text, or nothing."""
    with connect(url) as client:
        response = client.apply_specification(text_or_file(source))
    if as_json:
        show_json(response)
        return
    rows = [
        [change, unit["name"], unit["transformation"], unit["output"]]
        for change in ("started", "stopped", "there")
        for unit in response[change]
    ]
    show_table(["change", "unit", "transformation", "stream"], rows)


@specification.command()
def show(url: Url = DEFAULT_URL) -> None:
    """Print the running configuration as a specification."""
    with connect(url) as client:
        show_text(client.current_specification())


@specification.command("list")
def list_insertions(url: Url = DEFAULT_URL, as_json: Json = False) -> None:
    """List what specifications inserted."""
    with connect(url) as client:
        found = client.insertions()
    if as_json:
        show_json(found)
        return
    rows = [
        [i["name"] or "", i["transformation"], i["stream"] or "", i["failure"] or ""] for i in found
    ]
    show_table(["name", "transformation", "stream", "failure"], rows)
