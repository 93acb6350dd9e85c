"""Errors as ``application/problem+json`` (RFC 9457), with the cause and the next step.

`problem_of` has the status of every error of a lower room. The application's exception handlers
call it; routes raise `Problem` only for conditions, media types and sizes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any, Final
from urllib.parse import quote

from fastapi import FastAPI, HTTPException, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException as StarletteHTTPException
from starlette.routing import Match
from starlette.types import Receive, Scope, Send

from ...converters.arrow.stream import ArrowMissing
from ...converters.errors import AheadOfClock, ConversionError, WireError
from ...engine.model import errors as engine_errors
from ...engine.model.errors import DyknowError, NoPlan, OntologyInUse
from ...journal.errors import JournalError, JournalFull
from ...languages.errors import LanguageError
from ...ontology.errors import OntologyError, QueryRefused
from ...ontology.units import UnitError
from ...streams.past_queries import Forgotten
from ...streams.sample import SampleError
from ...streams.time import format_time
from ..config.defaults import AHEAD
from ..config.logs import log
from ..models import StageModel, StepModel
from .hints import hint_for

MEDIA_TYPE = "application/problem+json"
REQUEST_ID: Final = "dyknow.request"
"""In the scope of a request: its id, as in its answer, the log and problems."""
LONGEST = 4000
"""Characters of a text in an error, at most."""
MOST_TOLD = 100
"""Values that do not fit whose places an error lists, so that it is not longer than its request."""
WHOLE = frozenset({"text"})
"""Members that the service has written, and therefore are not cut."""
PROBLEM: Final = "dyknow.problem"
"""In the scope of a request: the type of the problem that answers it."""
_NAMES = "urn:dyknow:problem:"
_REQUESTS = "urn:dyknow:request:"


class ProblemModel(BaseModel):
    """An error. ``line``, ``column`` (from 1) and ``hint`` are there when a text is to blame."""

    type: str = Field(examples=["urn:dyknow:problem:unknown-stream"])
    title: str
    status: int
    detail: str
    instance: str | None = Field(None, description="the request, as the log has it")
    hint: str | None = None
    line: int | None = None
    column: int | None = None
    excerpt: str | None = Field(None, description="the source line with a caret under the place")
    field: str | None = Field(None, description="the field of a sample that is to blame")
    latest: str | None = Field(None, description="the latest time that the stream takes at present")
    accepted: int | None = Field(
        None, description="how many of the live samples before the error were taken"
    )
    oldest: str | None = Field(None, description="the available time of the oldest sample kept")
    missing: list[str] | None = Field(None, description="what semantic matching would need")
    found: bool | None = Field(None, description="false: an explanation found no plan")
    text: str | None = Field(None, description="see ExplainModel")
    stages: list[StageModel] | None = Field(None, description="see ExplainModel")
    plan: list[StepModel] | None = Field(None, description="see ExplainModel")
    used_by: list[str] | None = Field(None, description="what uses the terms of an ontology")
    errors: list[dict[str, Any]] | None = Field(None, description="each value that does not fit")


class Problem(HTTPException):
    """An error to answer with. ``title`` names its type, ``extra`` are further members."""

    def __init__(
        self,
        status: int,
        title: str,
        detail: str,
        *,
        hint: str = "",
        headers: Mapping[str, str] | None = None,
        **extra: object,
    ) -> None:
        super().__init__(status, detail, dict(headers) if headers else None)
        self.title = title
        self.members: dict[str, object] = {"hint": hint or hint_for(title), **extra}

    @property
    def kind(self) -> str:
        """Its type (RFC 9457)."""
        return _NAMES + self.title.lower().replace(" ", "-")

    def model(self) -> ProblemModel:
        known: dict[str, Any] = {
            key: value if key in WHOLE else _shown(value)
            for key, value in self.members.items()
            if value or value == 0
        }
        detail = _shown(str(self.detail))
        return ProblemModel(
            type=self.kind, title=self.title, status=self.status_code, detail=detail, **known
        )

    def response(self, request: str | None = None) -> Response:
        """The answer to the request with this id, its ``instance``."""
        model = self.model()
        if request is not None:
            model.instance = _REQUESTS + quote(request, safe="")
        # Only the problem's own members are left out; those of a plan may be null.
        body = {name: value for name, value in model.model_dump().items() if value is not None}
        return _ProblemResponse(self.kind, body, self.status_code, self.headers)


class _ProblemResponse(JSONResponse):
    """Notes the problem's type in the scope, for the list of requests."""

    media_type = MEDIA_TYPE

    def __init__(self, kind: str, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._kind = kind

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        scope[PROBLEM] = self._kind
        await super().__call__(scope, receive, send)


def _shown(value: Any) -> Any:
    """``value``, a long text without its end: the client has sent it."""
    if isinstance(value, str) and len(value) > LONGEST:
        return f"{value[:LONGEST]}…"
    return value


_STATUS: tuple[tuple[type[DyknowError], int], ...] = (
    (engine_errors.UnknownStream, 404),
    (engine_errors.UnknownTemplate, 404),
    (engine_errors.UnknownTransformation, 404),
    (engine_errors.UnknownEvent, 404),
    (engine_errors.UnknownRequest, 404),
    (engine_errors.UnknownFeature, 404),
    (engine_errors.UnknownDeclaration, 404),
    (engine_errors.UnknownNode, 404),
    (engine_errors.UnknownObject, 404),
    (engine_errors.UnknownQuery, 404),
    (engine_errors.UnknownOntology, 404),
    (engine_errors.NoResult, 404),
    (engine_errors.AlreadyExists, 409),
    (engine_errors.Conflict, 409),
    (engine_errors.BadArguments, 400),
    (engine_errors.NoPlan, 422),
    (engine_errors.NotAnnotated, 422),
    (engine_errors.Refused, 403),
)


def problem_of(error: Exception) -> Problem:
    """The problem for an error of a lower room or of the web framework."""
    match error:
        case Problem():
            return error
        case LanguageError():
            excerpt = "\n".join(error.render().splitlines()[1:3])
            return Problem(
                400,
                "syntax error",
                error.message,
                hint=error.hint,
                line=error.line,
                column=error.column,
                excerpt=excerpt,
            )
        case DyknowError():
            status = next((code for kind, code in _STATUS if isinstance(error, kind)), 400)
            missing = list(error.missing) if isinstance(error, NoPlan) else None
            users = list(error.used_by) if isinstance(error, OntologyInUse) else None
            return Problem(
                status,
                error.title,
                error.detail,
                hint=error.hint,
                missing=missing,
                used_by=users,
            )
        case Forgotten():
            oldest = None if error.oldest is None else format_time(error.oldest)
            return Problem(
                410,
                "forgotten",
                str(error),
                hint="ask for later samples, or declare the stream with a longer retention",
                oldest=oldest,
            )
        case QueryRefused():
            return Problem(
                400,
                "query refused",
                error.message,
                hint=error.hint,
                line=error.line,
                column=error.column,
            )
        case ArrowMissing():
            return Problem(
                501,
                "not available",
                "this service was installed without Arrow",
                hint="install dyknow[arrow], or use application/x-ndjson",
            )
        case AheadOfClock():
            latest = format_time(error.latest)
            return Problem(
                400,
                AHEAD,
                error.message,
                hint=error.hint,
                line=error.line,
                field="available",
                latest=latest,
            )
        case WireError():
            return Problem(400, "bad samples", error.message, hint=error.hint, line=error.line)
        case ConversionError():
            return Problem(
                400, "conversion failed", error.message, hint=error.hint, field=error.field
            )
        case SampleError():
            line = None if error.row is None else error.row + 1
            return Problem(400, "bad samples", str(error), line=line, field=error.field)
        case OntologyError():
            return Problem(
                400,
                "bad ontology",
                error.message,
                hint=error.hint,
                line=error.line,
                column=error.column,
            )
        case JournalFull():
            return Problem(
                507, "no room", error.message, hint=error.hint, headers={"Retry-After": "5"}
            )
        case JournalError():
            return Problem(503, "journal broken", error.message, hint=error.hint)
        case UnitError():
            return Problem(400, "bad unit", str(error))
        case RequestValidationError():
            return _validation(error.errors())
        case StarletteHTTPException():
            return _plain(error)
        case _:
            # The log has the error; its message may name files, and does not help the client.
            return Problem(500, "internal error", "the service failed; its log has the error")


def stopping() -> Problem:
    """The problem of a request that the service cancels because it stops."""
    return Problem(
        503,
        "the service stops",
        "the service did not complete the request",
        hint="send it again when the service is back; samples with the same Idempotency-Key",
        headers={"Retry-After": "5"},
    )


def install(app: FastAPI) -> None:
    """Make ``app`` answer every error with a problem."""

    async def answer(request: Request, error: Exception) -> Response:
        found = problem_of(error)
        if found.status_code == 405:
            found.headers = {**(found.headers or {}), "Allow": ", ".join(_allowed(request))}
        id = request.scope.get(REQUEST_ID)
        log().debug(
            "refused",
            status=found.status_code,
            title=found.title,
            detail=str(found.detail),
            request=id,
        )
        return found.response(id)

    for kind in (
        StarletteHTTPException,
        RequestValidationError,
        LanguageError,
        DyknowError,
        QueryRefused,
        WireError,
        ConversionError,
        SampleError,
        OntologyError,
        UnitError,
        JournalError,
        Exception,
    ):
        app.add_exception_handler(kind, answer)


def _allowed(request: Request) -> list[str]:
    """The methods of all routes of the path: Starlette knows those of the first one only."""
    found = []
    for method in ("GET", "POST", "PUT", "PATCH", "DELETE"):
        scope = {**request.scope, "method": method}
        if any(route.matches(scope)[0] is Match.FULL for route in request.app.routes):
            # `AccessLog` answers HEAD wherever GET is.
            found += ["GET", "HEAD"] if method == "GET" else [method]
    return found


def responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """The OpenAPI responses of a route for errors with these statuses."""
    return {
        status: {
            "description": HTTPStatus(status).phrase,
            "content": {
                MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/ProblemModel"}},
            },
        }
        for status in statuses
    }


def written_responses() -> dict[str, dict[str, Any]]:
    """The OpenAPI responses of every route that changes something, for failures of the log."""
    return {str(status): each for status, each in responses(503, 507).items()}


def _validation(errors: Sequence[Any]) -> Problem:
    details = [
        {
            "at": ".".join(str(part) for part in error["loc"])[:LONGEST],
            "problem": error["msg"].removeprefix("Value error, "),
        }
        for error in errors[:MOST_TOLD]
    ]
    first = errors[0]
    if first["type"] == "json_invalid":
        position = first["loc"][-1]
        return Problem(
            400, "bad JSON", f"{first['ctx']['error']} at character {position}", errors=details
        )
    text = "; ".join(f"{detail['at']}: {detail['problem']}" for detail in details[:5])
    if len(errors) > len(details):
        text += f"; and {len(errors) - 5} more"
    return Problem(422, "values do not fit", text, errors=details)


def _plain(error: StarletteHTTPException) -> Problem:
    phrase = HTTPStatus(error.status_code).phrase
    hint = {
        400: "send JSON in UTF-8, not nested deeply",
        404: "the routes are listed at /docs and in /openapi.json",
        405: "see the Allow header for the methods of this route",
    }.get(error.status_code, "")
    title, detail = {
        404: ("no such route", "no route of the service has this address"),
        405: ("method not allowed", "the route of this address takes other methods"),
    }.get(error.status_code, (phrase, str(error.detail)))
    return Problem(error.status_code, title.lower(), detail, hint=hint, headers=error.headers)
