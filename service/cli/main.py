"""The command line, put together: ``dyknow COMMAND``. Status 0, 1 for an error, 2 for usage."""

from __future__ import annotations

import sys
from typing import Any

import httpx
import typer
from typer.core import TyperGroup

from ... import __version__
from ...converters.errors import ConversionError, WireError
from ...languages.errors import LanguageError
from ...ontology.errors import OntologyError
from ...streams.sample import SampleError
from ..client.client import ServiceError
from ..http.problems import problem_of
from .data.backups import backup, restore
from .data.data_directory import check, log, repair
from .events import events
from .follow import follow
from .introspection import explain, match, sparql
from .kpl import kpl
from .ontologies import ontology
from .output import JSON_WANTED, fail
from .queries import query
from .recordings.demo import demo
from .recordings.replay import replay
from .recordings.run import run
from .serve import serve
from .specifications import specification
from .streams import annotate, streams
from .templates import template
from .token import token
from .token_option import take_tokens
from .transformations import transformation

RECURSION_LIMIT = 20_000
"""Calls inside each other: enough for chains of some two thousand units."""
USAGE: Any = typer.BadParameter.__base__
"""Every wrong use of an option, an argument or a command; typer has no public name for it."""


class Commands(TyperGroup):
    """Says errors on standard error, as people read them: what, where, what next.

    With ``--json`` each is one JSON object with the members of the service's problems.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Note whether JSON is asked for: an error may come before the option is read."""
        JSON_WANTED.set("--json" in args)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; every refusal becomes a message and status 1."""
        try:
            return super().invoke(ctx)
        except ServiceError as error:
            if error.status == 401:
                hint = "give one with --token, or in DYKNOW_TOKEN"
                problem = {**error.problem, "hint": hint}
                raise fail(f"{error.title}: {error.detail}", hint, problem=problem) from error
            raise fail(str(error), problem=error.problem) from error
        except httpx.ConnectError as error:
            raise fail(
                "there is no service at this address",
                "start one with dyknow serve, or say where it is with --url",
            ) from error
        except httpx.HTTPError as error:
            raise fail(f"the service does not answer: {error}") from error
        except (LanguageError, WireError, ConversionError, SampleError, OntologyError) as error:
            problem = problem_of(error).model().model_dump(exclude_none=True)
            raise fail(str(error), problem=problem) from error
        except (httpx.InvalidURL, OSError) as error:
            raise fail(str(error)) from error
        except USAGE as error:
            if not JSON_WANTED.get():
                raise
            told = {"title": "wrong usage", "detail": error.format_message()}
            raise fail("", problem=told, status=2) from error


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


app.command()(serve)
app.command()(token)
app.command()(demo)
app.command()(replay)
app.add_typer(template, name="template")
app.command()(events)
app.add_typer(query, name="query")
app.command()(streams)
app.command()(follow)
app.command()(annotate)
app.add_typer(transformation, name="transformation")
app.add_typer(specification, name="specification")
app.add_typer(ontology, name="ontology")
app.command()(sparql)
app.command()(match)
app.command()(explain)
app.command()(run)
app.add_typer(kpl, name="kpl")
app.command()(check)
app.command()(repair)
app.command()(backup)
app.command()(restore)
app.command()(log)
take_tokens(app)


def main() -> None:
    """The entry point of the installed command."""
    # A sample passes from unit to unit by calls: a chain is as long as the interpreter allows.
    sys.setrecursionlimit(RECURSION_LIMIT)
    app()
