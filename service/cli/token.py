"""``dyknow token``: create a token, and its line for the service's file."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from ..admission.tokens import FORM, Scope, is_name, line_of, new_token
from .output import Json, err, fail, out, show_json


def token(
    name: Annotated[str, typer.Argument(help="The owner, for logs and error messages.")],
    scope: Annotated[
        list[Scope] | None,
        typer.Option(help="A permission; may be repeated. admin includes the others."),
    ] = None,
    add: Annotated[
        Path | None,
        typer.Option(
            help="Append the line to this file, which is created if needed.", dir_okay=False
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Create a token and show it once; the file keeps a hash of it."""
    if not is_name(name):
        raise fail("a name has letters, digits and . _ @ -, at most 64", FORM)
    secret = new_token()
    scopes = scope or [Scope.READ]
    line = line_of(scopes, name, secret)
    if add is not None:
        _add(add, line)
    if as_json:
        show_json(
            {"name": name, "scopes": [str(each) for each in scopes], "token": secret, "line": line}
        )
        return
    err().print(f"The token of {name}; keep it, it is not shown again:", markup=False)
    out().print(secret, markup=False)
    if add is None:
        err().print(f"The line for the file of tokens, or DYKNOW_TOKENS:\n{line}", markup=False)
    else:
        err().print(f"Added to {add}: dyknow serve --tokens {add}", markup=False)


def _add(path: Path, line: str) -> None:
    """Append a line; a new file is readable by its owner only."""
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o600)
        with os.fdopen(descriptor, "rb+") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - 1))
            begin = b"" if file.read(1) in (b"", b"\n") else b"\n"
            file.write(begin + line.encode() + b"\n")
    except OSError as error:
        raise fail(f"{path} cannot be written: {error.strerror}") from error
