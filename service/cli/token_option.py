"""``--token``, added to every command that has ``--url``."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Annotated, Any, get_type_hints

import typer

from ..config.defaults import TOKEN
from .output import TOKEN_GIVEN

Token = Annotated[
    str | None,
    typer.Option(
        "--token",
        envvar=TOKEN,
        show_envvar=True,
        help="Token of the service. Other users of this machine can see it here, but not in the "
        "environment.",
        metavar="TOKEN",
    ),
]


def add_token_option(app: typer.Typer) -> None:
    """Add ``--token`` to the commands of ``app`` and its groups that have ``--url``."""
    for command in app.registered_commands:
        callback = command.callback
        if callback is not None and "url" in inspect.signature(callback).parameters:
            command.callback = _with_token(callback)
    for group in app.registered_groups:
        if group.typer_instance is not None:
            add_token_option(group.typer_instance)


def _with_token(command: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(command)
    def run(*arguments: Any, token: str | None = None, **options: Any) -> Any:
        TOKEN_GIVEN.set(token)
        return command(*arguments, **options)

    # typer reads the signature: the command's own parameters, and one more.
    hints = get_type_hints(command, include_extras=True)
    signature = inspect.signature(command)
    parameters = [
        parameter.replace(annotation=hints[name])
        for name, parameter in signature.parameters.items()
    ]
    added = inspect.Parameter(
        "token", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=Token
    )
    run.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[*parameters, added]
    )
    run.__annotations__ = {**hints, "token": Token}
    return run
