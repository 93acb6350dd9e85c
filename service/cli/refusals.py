"""Prints errors of commands: what, where, what next. Imported only when an error occurs."""

from __future__ import annotations

import httpx
import typer

from ..client.connection import ServiceError
from .output import fail


def report_error(error: Exception) -> typer.Exit | None:
    """Print ``error``, and return the exit to raise; None for an error in the program."""
    if isinstance(error, ServiceError):
        if error.status == 401:
            hint = "pass a token with --token, or in DYKNOW_TOKEN"
            problem = {**error.problem, "hint": hint}
            return fail(f"{error.title}: {error.detail}", hint, problem=problem)
        return fail(str(error), problem=error.problem)
    if isinstance(error, httpx.ConnectError):
        return fail(
            "there is no service at this address",
            "start one with dyknow serve, or name its address with --url",
        )
    if isinstance(error, httpx.HTTPError):
        return fail(f"the service does not answer: {error}")
    if isinstance(error, httpx.InvalidURL | OSError):
        return fail(str(error))
    return _report_own_error(error)


def _report_own_error(error: Exception) -> typer.Exit | None:
    """Do the same for errors of the rooms below, whose modules are loaded already."""
    from ...converters.errors import ConversionError, WireError
    from ...engine.model.errors import DyknowError
    from ...languages.errors import LanguageError
    from ...ontology.errors import OntologyError
    from ...streams.sample import SampleError

    if not isinstance(
        error,
        DyknowError | LanguageError | WireError | ConversionError | SampleError | OntologyError,
    ):
        return None
    from ..http.problems import problem_of

    return fail(str(error), problem=problem_of(error).model().model_dump(exclude_none=True))
