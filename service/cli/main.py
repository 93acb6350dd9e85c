"""The command line, put together: ``dyknow COMMAND``. Status 0, 1 for an error, 2 for usage.

A command's module is imported when the command runs: help, and what only talks to a service, need
not wait for the engine (tests/service/cli/test_starting.py).
"""

from __future__ import annotations

import gc
import sys
from contextlib import contextmanager
from functools import lru_cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

import typer
from typer.core import TyperGroup

from ..config.version import __version__
from .output import JSON_WANTED, fail

if TYPE_CHECKING:
    from collections.abc import Iterator

RECURSION_LIMIT = 20_000
"""Calls inside each other: enough for chains of some two thousand units."""
USAGE: Any = typer.BadParameter.__base__
"""Every wrong use of an option, an argument or a command; typer has no public name for it."""
COMMANDS: Final[dict[str, tuple[str, str]]] = {
    "serve": (
        "serve",
        "Run the service. Every setting can also be given as DYKNOW_<NAME>.",
    ),
    "token": (
        "token",
        "Make a token. It is shown this once: the file keeps a hash of it.",
    ),
    "demo": (
        "recordings.demo",
        "Replay five minutes of recorded flights and find events in them; ends by itself.",
    ),
    "replay": (
        "recordings.replay",
        "Play a recording into its streams: declares them, publishes, says when it has ended.",
    ),
    "events": (
        "events",
        "Request an event and follow it; without an argument, list the requests that run.",
    ),
    "streams": (
        "streams",
        "List the streams; with a name, tell all of one: fields, counters, lag, annotation.",
    ),
    "follow": (
        "follow",
        "Follow a stream, under a policy of one's own; or a feature, with a line for each switch.",
    ),
    "annotate": (
        "streams",
        "Say in SSL what streams are about.",
    ),
    "sparql": (
        "introspection",
        "Query the ontology and the live stream space.",
    ),
    "match": (
        "introspection",
        "Show how a feature could be had, without starting anything. Status 1 if it cannot.",
    ),
    "explain": (
        "introspection",
        "Show each stage of a request, a template, a query or a match.",
    ),
    "run": (
        "recordings.run",
        "Evaluate a continuous query over recorded streams and print each window's result.",
    ),
    "check": (
        "data.commands",
        "Look at a data directory, also of a running service: status 1 if it is damaged.",
    ),
    "repair": (
        "data.commands",
        "Keep what is good of a damaged data directory, and set the rest aside as *.damaged.",
    ),
    "backup": (
        "data.commands",
        "Copy a data directory, also of a running service, and verify the copy.",
    ),
    "restore": (
        "data.commands",
        "Make a data directory out of a backup; its next start begins new ids of events.",
    ),
    "log": (
        "data.commands",
        "Print the commands of a data directory's log, a line of JSON each, up to what is damaged.",
    ),
    "template": (
        "templates",
        "Event templates: add, list, show, remove.",
    ),
    "query": (
        "queries",
        "Continuous queries: add, list, show, results, remove.",
    ),
    "transformation": (
        "transformations",
        "Transformations: add, list, show, remove.",
    ),
    "specification": (
        "specifications",
        "Specifications in XML: apply, show, list.",
    ),
    "ontology": (
        "ontologies",
        "Domain ontologies: add, list, check.",
    ),
    "kpl": (
        "kpl",
        "KPL, the knowledge processing language: check, prove, run, add, show, remove.",
    ),
}
"""Each command's module, and what is said of it in the list of all. The module has a function or a
group of the command's name; its own help begins with the same sentence (a test holds that)."""


@lru_cache
def command(name: str) -> Any:
    """The command of that name as typer runs it; imports its module."""
    from .token_option import take_tokens

    with _uncollected():
        found = getattr(import_module(f".{COMMANDS[name][0]}", __package__), name)
    if isinstance(found, typer.Typer):
        take_tokens(found)
        made: Any = typer.main.get_group(found)
    else:
        alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        alone.command(name)(found)
        take_tokens(alone)
        made = typer.main.get_command(alone)
    made.name = name
    return made


@contextmanager
def _uncollected() -> Iterator[None]:
    """Of what modules make when they are imported nothing is garbage, and looking for it again and
    again takes a sixth of the time."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


class Commands(TyperGroup):
    """The commands of `COMMANDS`. Says errors on standard error, as people read them: what, where,
    what next.

    With ``--json`` each is one JSON object with the members of the service's problems.
    """

    def __init__(self, **attributes: Any) -> None:
        # What the list of all shows, and what may be meant by a name that there is not.
        told = {
            name: typer.core.TyperCommand(name, help=text) for name, (_, text) in COMMANDS.items()
        }
        super().__init__(**{**attributes, "commands": told})

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command itself, where it is to be run."""
        name, found, rest = super().resolve_command(ctx, args)
        return name, found and command(name or ""), rest

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Note whether JSON is asked for: an error may come before the option is read."""
        JSON_WANTED.set("--json" in args)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; every refusal becomes a message and status 1."""
        try:
            return super().invoke(ctx)
        except USAGE as error:
            if not JSON_WANTED.get():
                raise
            told = {"title": "wrong usage", "detail": error.format_message()}
            raise fail("", problem=told, status=2) from error
        except (typer.Exit, typer.Abort):
            raise
        except Exception as error:
            from .refusals import told_of

            if (end := told_of(error)) is None:
                raise
            raise end from error


app = typer.Typer(
    cls=Commands,
    name="dyknow",
    help="Semantic stream reasoning: say what you want to know.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _version(wanted: bool) -> None:
    if wanted:
        print(__version__)
        raise typer.Exit


@app.callback()
def _options(
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version."
    ),
) -> None:
    """Options before the command."""


def main() -> None:
    """The entry point of the installed command."""
    # A sample passes from unit to unit by calls: a chain is as long as the interpreter allows.
    sys.setrecursionlimit(RECURSION_LIMIT)
    app()
