"""Log in with a token in a browser, whose event streams cannot send headers."""

from __future__ import annotations

from fastapi import Depends, Request, Response

from ..admission.sessions import set_cookie
from ..http.problems import Problem, responses
from ..http.routers import resource_router
from ..models import SessionIn, SessionModel
from ..runtime.context import Context
from .json_body import JsonRoute
from .streams import json_only

router = resource_router("session", route_class=JsonRoute)


@router.get("/session")
async def read_session(request: Request, service: Context) -> SessionModel:
    """Return whether this service requires tokens, and the owner of the request's token or session.

    401: an unknown token.
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
    """Log in with a token. For twelve hours a cookie replaces it in requests of this service's
    pages. 401: an unknown token; 409: the service requires no tokens."""
    gate = service.gate
    if not gate.tokens.required:
        raise Problem(409, "no tokens", "this service requires no tokens, so there is no login")
    value = gate.sessions.begin(gate.known(login.token.get_secret_value().encode()))
    return _answer(request, value)


@router.delete("/session", status_code=204)
async def log_out(request: Request, service: Context) -> Response:
    """Log out: the cookie becomes invalid. Without a session this does nothing."""
    service.gate.sessions.end(request.headers.get("cookie", "").encode("latin-1"))
    return _answer(request, "")


def _answer(request: Request, cookie: str) -> Response:
    secure = request.scope["scheme"] == "https"
    headers = {"Set-Cookie": set_cookie(cookie, secure=secure), "Cache-Control": "no-store"}
    return Response(status_code=204, headers=headers)
