"""``dyknow streams`` and ``dyknow annotate``: list streams, and annotate them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from .output import (
    DEFAULT_URL,
    Json,
    Url,
    brief,
    clock_ms,
    connect,
    fail,
    show_json,
    show_lines,
    show_table,
    show_text,
    show_values,
)

_TEXTS = (".rq", ".sparql", ".ssl", ".txt")


def streams(
    name: Annotated[str | None, typer.Argument(help="Only this stream, in full.")] = None,
    remove: Annotated[
        str | None,
        typer.Option(help="Forget the stream of this name, with its samples.", metavar="NAME"),
    ] = None,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """List the streams; with a name, show all of one: fields, counters, lag, annotation."""
    if remove is not None:
        _remove(remove, name, url, as_json)
        return
    with connect(url) as client:
        found = client.streams() if name is None else [client.stream(name)]
    if as_json:
        show_lines(found)
        return
    if name is not None:
        _show_one(found[0])
        return
    show_table(
        ["stream", "samples", "late", "rate/s", "last", "made by"],
        [
            (
                stream["name"],
                stream["counters"]["used"],
                stream["counters"]["late"],
                stream["rate"],
                clock_ms(stream["last_available"]) + (" (ended)" if stream["ended"] else ""),
                stream["producer"],
            )
            for stream in found
        ],
        unfolded=["stream", "made by"],
        empty="no streams yet: dyknow replay FILE --stream NAME",
    )


def _remove(stream: str, shown: str | None, url: str, as_json: bool) -> None:
    if shown is not None:
        raise typer.BadParameter("pass --remove with one name, and no other")
    with connect(url) as client:
        client.remove_stream(stream)
    if as_json:
        show_json({"removed": stream})
    else:
        show_text(f"removed {stream}")


def annotate(
    source: Annotated[str, typer.Argument(help="SSL text, its file, or - .")],
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Annotate streams in SSL."""
    text = text_or_file(source)
    with connect(url) as client:
        found = client.annotate(text)
    if as_json:
        show_lines(found)
        return
    for annotation in found:
        show_text(f"{annotation['kind']} {annotation['name']}: {', '.join(annotation['features'])}")


def text_or_file(source: str) -> str:
    """Return ``source``, the content of the file that it names, or standard input for ``-``."""
    if source == "-":
        return sys.stdin.read().removeprefix("\ufeff")
    # A text with line ends is no file name, and a long one is no legal name either.
    if "\n" not in source and len(source) < 1024 and Path(source).is_file():
        return read_text(Path(source))
    if _is_file_name(source):
        raise fail(f"there is no file {source}", "pass a text, the name of its file, or -")
    return source.removeprefix("\ufeff")


def read_text(path: Path) -> str:
    """Read a file without its byte order mark."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise fail(f"{path} is not UTF-8 at byte {error.start}") from error


def _is_file_name(source: str) -> bool:
    """Guess whether ``source`` names a file: texts of all languages have several words or
    braces, file names rarely."""
    if not source or any(mark in source for mark in "\n{}"):
        return False
    word = not any(map(str.isspace, source)) and any(mark in source for mark in "./")
    return word or source.lower().endswith(_TEXTS)


def _show_one(stream: dict[str, object]) -> None:
    for key, value in stream.items():
        if key == "ports":
            continue  # the annotation says the same
        if isinstance(value, dict):
            value = show_values(value)
        elif key in ("lag", "silent_for") and isinstance(value, str):
            value = brief(value)
        elif key == "fields" and isinstance(value, list):
            value = ", ".join(f"{field['name']}: {field['type']}" for field in value)
        elif isinstance(value, bool):
            value = str(value).lower()
        text = "-" if value is None else str(value)
        show_text(f"{key:>15}  " + text.replace("\n", "\n" + " " * 17))
