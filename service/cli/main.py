"""The entry point of the command line: ``dyknow COMMAND``. Status 0; 1 for an error; 2 for usage.

A command's module is imported when the command runs. So help, and commands that only talk to a
service, do not load the engine (tests/service/cli/test_starting.py).
"""

from __future__ import annotations

import sys
from functools import lru_cache
from importlib import import_module
from typing import Any, Final

import typer
from typer.core import TyperGroup

from ...matching.gc_pause import gc_paused
from ..config.version import __version__
from .output import JSON_WANTED, fail

RECURSION_LIMIT = 20_000
"""The limit on nested calls: enough for chains of some two thousand units."""
USAGE: Any = typer.BadParameter.__base__
"""The base class of usage errors, for which typer has no public name."""
COMMANDS: Final[dict[str, tuple[str, str]]] = {
    "serve": (
        "serve",
        "Run the service. Every setting can also be given as DYKNOW_<NAME>.",
    ),
    "token": (
        "token",
        "Create a token and show it once; the file keeps a hash of it.",
    ),
    "demo": (
        "recordings.demo",
        "Replay five minutes of recorded flights, and find events in them.",
    ),
    "replay": (
        "recordings.replay",
        "Play a recording into its streams: declare them, publish, report the end.",
    ),
    "inspect": (
        "recordings.inspect",
        "Show a recording's streams, fields, times and rates, and a first SSL text for it.",
    ),
    "events": (
        "events",
        "Request an event and follow it; without an argument, list the requests that run.",
    ),
    "streams": (
        "streams",
        "List the streams; with a name, show all of one: fields, counters, lag, annotation.",
    ),
    "objects": (
        "introspection",
        "List the known objects; with a name, show its sorts and its newest values.",
    ),
    "follow": (
        "follow",
        "Follow a stream, optionally under a policy; or a feature, with a line for each switch.",
    ),
    "annotate": (
        "streams",
        "Annotate streams in SSL.",
    ),
    "sparql": (
        "introspection",
        "Query the ontology and the live stream space.",
    ),
    "match": (
        "introspection",
        "Find a plan for a feature, without starting anything. Status 1 if there is none.",
    ),
    "explain": (
        "introspection",
        "Explain a request, a template, a query or a match, stage by stage. Status 1 if there is "
        "no plan.",
    ),
    "run": (
        "recordings.run",
        "Evaluate a query over recorded streams, check a monitor, or find a pattern in them.",
    ),
    "check": (
        "data.commands",
        "Check a data directory, also of a running service; status 1 if it is damaged.",
    ),
    "repair": (
        "data.commands",
        "Repair a damaged data directory, and set the damaged files aside as *.damaged.",
    ),
    "backup": (
        "data.commands",
        "Copy a data directory, also of a running service, and verify the copy.",
    ),
    "restore": (
        "data.commands",
        "Make a data directory from a backup; its next start begins new ids of events.",
    ),
    "log": (
        "data.commands",
        "Print the commands of a data directory's log as lines of JSON, up to any damage.",
    ),
    "template": (
        "templates",
        "Event templates: add, list, show, remove.",
    ),
    "query": (
        "queries",
        "Queries, monitors and patterns: add, list, show, results, why, partial, remove.",
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
        "Domain ontologies: add, add-feature, add-sort, list, show, remove, check.",
    ),
    "kpl": (
        "kpl",
        "KPL, the knowledge processing language: check, prove, run, add, show, remove.",
    ),
}
"""Each command's module and summary. The module has a function or a group of the command's name,
whose own help begins with the same sentence (a test checks that)."""


@lru_cache
def command(name: str) -> Any:
    """Import the module of command ``name``, and return it as a click command."""
    from .token_option import add_token_option

    # Imports make no garbage; scanning their objects again and again takes a sixth of the time.
    with gc_paused():
        found = getattr(import_module(f".{COMMANDS[name][0]}", __package__), name)
    if isinstance(found, typer.Typer):
        add_token_option(found)
        runnable: Any = typer.main.get_group(found)
    else:
        alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        alone.command(name)(found)
        add_token_option(alone)
        runnable = typer.main.get_command(alone)
    runnable.name = name
    return runnable


class Commands(TyperGroup):
    """The commands of `COMMANDS`. Prints errors on standard error: what, where, what next.

    With ``--json`` each error is one JSON object with the members of the service's problems.
    """

    def __init__(self, **attributes: Any) -> None:
        # Placeholders: help lists them, and a wrong name is compared with them.
        placeholders = {
            name: typer.core.TyperCommand(name, help=text) for name, (_, text) in COMMANDS.items()
        }
        super().__init__(**{**attributes, "commands": placeholders})

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the real command instead of its placeholder."""
        name, found, rest = super().resolve_command(ctx, args)
        return name, found and command(name or ""), rest

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Note ``--json`` first: an error may occur before the option is parsed."""
        JSON_WANTED.set("--json" in args)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the command, and turn an error into a message and status 1."""
        try:
            return super().invoke(ctx)
        except USAGE as error:
            if not JSON_WANTED.get():
                raise
            usage = {"title": "wrong usage", "detail": error.format_message()}
            raise fail("", problem=usage, status=2) from error
        except (typer.Exit, typer.Abort):
            raise
        except Exception as error:
            from .refusals import report_error

            if (end := report_error(error)) is None:
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
    # A sample passes from unit to unit by nested calls, so this limits the length of a chain.
    sys.setrecursionlimit(RECURSION_LIMIT)
    app()
