"""Logging in with a token, for the page in a browser: its event streams cannot send headers."""

from __future__ import annotations

from fastapi import APIRouter, Depends, Request, Response

from ..admission.sessions import set_cookie
from ..http.problems import Problem, responses
from ..models import SessionIn, SessionModel
from ..runtime.context import Context
from .json_body import JsonRoute
from .streams import json_only

router = APIRouter(tags=["session"], route_class=JsonRoute)


@router.get("/session")
async def read_session(request: Request, service: Context) -> SessionModel:
    """Whether this service wants tokens, and whose token or session the request has.

    401 for a token that is not known.
    """
    gate = service.gate
    caller = gate.who(request.scope) if gate.tokens.required else None
    return SessionModel(
        required=gate.tokens.required,
        name=None if caller is None else caller.name,
        scopes=[] if caller is None else sorted(caller.scopes),
    )


@router.post(
    "/session",
    status_code=204,
    dependencies=[Depends(json_only)],
    responses=responses(409, 413, 415, 422),
)
async def log_in(login: SessionIn, request: Request, service: Context) -> Response:
    """Log in with a token: a cookie takes its place for twelve hours, in requests of pages of this
    service. 401 for a token that is not known, 409 where none is needed."""
    gate = service.gate
    if not gate.tokens.required:
        raise Problem(409, "no tokens", "this service is open: nobody logs in")
    value = gate.sessions.begin(gate.known(login.token.get_secret_value().encode()))
    return _answer(request, value)


@router.delete("/session", status_code=204)
async def log_out(request: Request, service: Context) -> Response:
    """Log out: the cookie is worth nothing any more. Nothing happens where nobody is logged in."""
    service.gate.sessions.end(request.headers.get("cookie", "").encode("latin-1"))
    return _answer(request, "")


def _answer(request: Request, cookie: str) -> Response:
    secure = request.scope["scheme"] == "https"
    headers = {"Set-Cookie": set_cookie(cookie, secure=secure), "Cache-Control": "no-store"}
    return Response(status_code=204, headers=headers)
