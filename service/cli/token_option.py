"""``--token``: every command that takes ``--url`` takes it, too, without saying so itself."""

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
        help="Token of the service; others on this machine see it here, not in the environment.",
        metavar="TOKEN",
    ),
]


def take_tokens(app: typer.Typer) -> None:
    """Give ``--token`` to the commands of ``app``, and of the groups in it, that take ``--url``."""
    for command in app.registered_commands:
        callback = command.callback
        if callback is not None and "url" in inspect.signature(callback).parameters:
            command.callback = _with_token(callback)
    for group in app.registered_groups:
        if group.typer_instance is not None:
            take_tokens(group.typer_instance)


def _with_token(command: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(command)
    def run(*arguments: Any, token: str | None = None, **options: Any) -> Any:
        TOKEN_GIVEN.set(token)
        return command(*arguments, **options)

    # What typer reads: the command's own parameters, and one more.
    hints = get_type_hints(command, include_extras=True)
    given = inspect.signature(command)
    parameters = [
        parameter.replace(annotation=hints[name]) for name, parameter in given.parameters.items()
    ]
    added = inspect.Parameter(
        "token", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=Token
    )
    run.__signature__ = given.replace(parameters=[*parameters, added])  # type: ignore[attr-defined]
    run.__annotations__ = {**hints, "token": Token}
    return run
