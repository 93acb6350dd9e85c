"""Errors of commands as people read them: what, where, what next. Imported when there is one."""

from __future__ import annotations

import httpx
import typer

from ..client.connection import ServiceError
from .output import fail


def told_of(error: Exception) -> typer.Exit | None:
    """Say what went wrong; gives what ends the command. None where ``error`` is no refusal."""
    if isinstance(error, ServiceError):
        if error.status == 401:
            hint = "give one with --token, or in DYKNOW_TOKEN"
            problem = {**error.problem, "hint": hint}
            return fail(f"{error.title}: {error.detail}", hint, problem=problem)
        return fail(str(error), problem=error.problem)
    if isinstance(error, httpx.ConnectError):
        return fail(
            "there is no service at this address",
            "start one with dyknow serve, or say where it is with --url",
        )
    if isinstance(error, httpx.HTTPError):
        return fail(f"the service does not answer: {error}")
    if isinstance(error, httpx.InvalidURL | OSError):
        return fail(str(error))
    return _told_of_ours(error)


def _told_of_ours(error: Exception) -> typer.Exit | None:
    """The same for what a room below refuses: its module is there already."""
    from ...converters.errors import ConversionError, WireError
    from ...languages.errors import LanguageError
    from ...ontology.errors import OntologyError
    from ...streams.sample import SampleError

    if not isinstance(
        error, LanguageError | WireError | ConversionError | SampleError | OntologyError
    ):
        return None
    from ..http.problems import problem_of

    return fail(str(error), problem=problem_of(error).model().model_dump(exclude_none=True))
