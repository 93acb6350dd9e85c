"""Access control: the ASGI layer that checks each request before the service reads its body.

It checks, in this order: Host and Origin (origins), a token or session with the scope of the route
(tokens, sessions, scopes), quotas and memory (quotas, memory_limit). A pure ASGI layer costs less
than a middleware or dependency of the framework, which matters for small batches.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from starlette.requests import Request
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ..config.settings import Settings
from ..http.client_address import address_of
from ..http.problems import REQUEST_ID, Problem
from .memory_limit import Memory
from .origins import Headers, Hosts, Origins, Place, is_own_page
from .quotas import Quotas
from .scopes import Rule, Rules
from .sessions import Sessions
from .tokens import Caller, Tokens

CALLER = "dyknow.caller"
"""In the scope of a request: its `Caller`, if tokens are required."""
CHALLENGE = 'Bearer realm="dyknow"'
ALLOWED_METHODS = "GET, HEAD, POST, PUT, PATCH, DELETE"
ALLOWED_HEADERS = (
    "Accept, Authorization, Cache-Control, Content-Type, Idempotency-Key, "
    "If-Match, If-None-Match, Last-Event-ID"
)
EXPOSED_HEADERS = (
    "Dyknow-Position, Dyknow-Window-End, ETag, Location, Retry-After, WWW-Authenticate"
)
PREFLIGHT_LASTS = 600
"""Seconds for which a browser caches a preflight."""

_READ = frozenset(
    (
        b"host",
        b"origin",
        b"authorization",
        b"cookie",
        b"sec-fetch-site",
        b"sec-fetch-mode",
        b"sec-fetch-dest",
    )
)


@dataclass(frozen=True, slots=True)
class Gate:
    """The parts that decide on a request."""

    tokens: Tokens
    sessions: Sessions
    quotas: Quotas
    memory: Memory
    rules: Rules
    hosts: Hosts
    origins: Origins

    @classmethod
    def of(
        cls, settings: Settings, tokens: Tokens, sessions: Sessions, quotas: Quotas, memory: Memory
    ) -> Gate:
        """The gate of a service with these settings."""
        return cls(tokens, sessions, quotas, memory, Rules(), Hosts(settings), Origins(settings))

    def check_page(self, scope: Scope, headers: Headers) -> Place:
        """Check Host and Origin. Raises a `Problem` for another host or an untrusted origin."""
        server = scope.get("server") or ("",)
        place = self.hosts.check(headers.get(b"host", []), server[0])
        if len(headers) > 1:
            self.origins.check(headers, scope["scheme"], place, scope["method"])
        return place

    def check_caller(self, scope: Scope, headers: Headers, place: Place) -> None:
        """Check token, quotas and memory. Raises a `Problem`."""
        rule, parameters = self.rules.find(scope["method"], scope["path"])
        if self.tokens.required and rule.scope is not None:
            caller = self._caller(scope, headers, place)
            if caller is None:
                raise _unknown(401, "this service requires a token")
            scope[CALLER] = caller
        self._check(scope, rule, parameters)

    def check_also(self, scope: Scope, method: str, path: str) -> None:
        """Check what an admitted request does beside its own route, as if it were a request for
        that. Raises a `Problem`."""
        self._check(scope, *self.rules.find(method, path))

    def _check(self, scope: Scope, rule: Rule, parameters: Mapping[str, str]) -> None:
        caller: Caller | None = scope.get(CALLER)
        if caller is not None and rule.scope is not None and not caller.may(rule.scope):
            raise _lacking(caller, rule)
        self.quotas.check(rule.route, parameters)
        self.memory.check_route(rule.route)

    def who(self, scope: Scope) -> Caller | None:
        """The caller of an admitted request; None without a token or session. Raises a `Problem`
        for an unknown token."""
        headers = _wanted(scope)
        return self._caller(scope, headers, self.check_page(scope, headers))

    def known(self, token: bytes) -> Caller:
        """The caller with ``token``. Raises a 401 `Problem` if there is none."""
        caller = self.tokens.caller(token)
        if caller is None:
            raise _unknown(401, "the service does not know the token", 'error="invalid_token"')
        return caller

    def _caller(self, scope: Scope, headers: Headers, place: Place) -> Caller | None:
        given = headers.get(b"authorization", [])
        if len(given) > 1:
            raise _unknown(
                400, "there are several Authorization headers", 'error="invalid_request"'
            )
        kind, _, token = given[0].partition(b" ") if given else (b"", b"", b"")
        if kind.lower() == b"bearer":
            return self.known(token.strip())
        if not given and b"cookie" in headers and is_own_page(headers, scope["scheme"], place):
            found = self.sessions.caller(b";".join(headers[b"cookie"]))
            # A session ends with its token, and has the scopes that this has now.
            return None if found is None else self.tokens.current(found)
        return None


def revoked() -> Problem:
    """The problem that ends a request whose token was removed."""
    return _unknown(401, "the token is no longer valid", 'error="invalid_token"')


def client_key(request: Request) -> str:
    """The key under which a request's streams and answers count: its token, else its address."""
    caller: Caller | None = request.scope.get(CALLER)
    return address_of(request) if caller is None else f"token {caller.name}"


class Access:
    """The ASGI layer. ``refused`` counts refusals by their title."""

    def __init__(self, app: ASGIApp, gate: Gate, refused: Callable[[str], None]) -> None:
        self._app = app
        self._gate = gate
        self._refused = refused

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            if scope["type"] == "websocket":
                await send({"type": "websocket.close", "code": 1008})  # no route takes it
                return
            await self._app(scope, receive, send)
            return
        headers = _wanted(scope)
        gate = self._gate
        try:
            place = gate.check_page(scope, headers)
            if gate.origins.any_trusted:
                origin = headers.get(b"origin", [b""])[0]
                trusted = gate.origins.is_trusted(origin)
                send = _with_headers(send, _cors(origin) if trusted else [(b"vary", b"Origin")])
                if trusted and scope["method"] == "OPTIONS":
                    await _preflight(scope, receive, send)
                    return
            gate.check_caller(scope, headers, place)
        except Problem as problem:
            self._refused(problem.title)
            await problem.response(scope.get(REQUEST_ID))(scope, receive, send)
            return
        await self._app(scope, receive, send)


def _wanted(scope: Scope) -> Headers:
    """The values of the headers that the checks read; a header may have several."""
    headers: dict[bytes, list[bytes]] = {}
    for name, value in scope["headers"]:
        if name in _READ:
            headers.setdefault(name, []).append(value)
    return headers


def _unknown(status: int, detail: str, error: str = "") -> Problem:
    """A 401, or 400 for a request with several tokens (RFC 6750, section 3)."""
    challenge = f"{CHALLENGE}, {error}" if error else CHALLENGE
    return Problem(
        status,
        "not authenticated",
        detail,
        hint="send one header Authorization: Bearer <token>; "
        "its operator makes tokens: dyknow token --help",
        headers={"WWW-Authenticate": challenge},
    )


def _lacking(caller: Caller, rule: Rule) -> Problem:
    scopes = ", ".join(sorted(caller.scopes))
    return Problem(
        403,
        "scope missing",
        f"this needs scope {rule.scope}; the token of {caller.name} has {scopes}",
        hint="ask the operator of the service for a token with that scope",
        headers={
            "WWW-Authenticate": f'{CHALLENGE}, error="insufficient_scope", scope="{rule.scope}"'
        },
    )


def _cors(origin: bytes) -> list[tuple[bytes, bytes]]:
    """The headers that let a page of a trusted origin read the answer. Without credentials: cookies
    are for pages of this service."""
    return [
        (b"access-control-allow-origin", origin),
        (b"access-control-expose-headers", EXPOSED_HEADERS.encode()),
        (b"vary", b"Origin"),
    ]


def _with_headers(send: Send, headers: list[tuple[bytes, bytes]]) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message["headers"], *headers]}
        await send(message)

    return sending


async def _preflight(scope: Scope, receive: Receive, send: Send) -> None:
    """Answer the preflight of a page of a trusted origin."""
    headers = {
        "Access-Control-Allow-Methods": ALLOWED_METHODS,
        "Access-Control-Allow-Headers": ALLOWED_HEADERS,
        "Access-Control-Max-Age": str(PREFLIGHT_LASTS),
        "Access-Control-Allow-Private-Network": "true",
    }
    await Response(status_code=204, headers=headers)(scope, receive, send)
