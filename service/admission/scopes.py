"""The scope that each route needs (docs/reference/access.md, "Scopes").

A route without an entry needs ``admin``; a test compares the table with the application's routes.
Creating, changing and removing streams, units, templates and requests is ``admin``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from starlette.routing import compile_path

from .tokens import Scope

OPEN = (
    # Orchestrators and load balancers have no token.
    "GET /healthz",
    "GET /readyz",
    # The pages and the schema contain nothing of the running system, and users log in on them.
    "GET /",
    "GET /docs",
    "GET /static/{name}",
    "GET /console/{name:path}",
    "GET /openapi.json",
    "GET /session",
    "POST /session",
    "DELETE /session",
)
"""Routes without a token."""

READ = (
    "GET /streams",
    "GET /streams/{name}",
    "GET /streams/{name}/evaluation",
    "GET /graph",
    "GET /objects",
    "GET /objects/{name:path}",
    "GET /units",
    "GET /units/{name}",
    "GET /journal",
    "GET /problems",
    "GET /vocabulary",
    "GET /streams/{name}/samples",
    "GET /streams/{name}/events",
    "GET /follow",
    "GET /templates",
    "GET /templates/{name:path}",
    "GET /events",
    "GET /events/{id}",
    "GET /events/{id}/partial",
    "GET /events/{id}/why",
    "GET /subscriptions",
    "GET /subscriptions/{id}",
    "GET /subscriptions/{id}/rematches",
    "GET /subscriptions/{id}/events",
    "GET /queries",
    "GET /queries/{name}",
    "GET /queries/{name}/results",
    "GET /queries/{name}/results/events",
    "GET /queries/{name}/partial",
    "GET /queries/{name}/why",
    "GET /kpl",
    "GET /kpl/{name:path}",
    "GET /specifications",
    "GET /specifications/current",
    "GET /annotations",
    "GET /transformations",
    "GET /transformations/{name}",
    "GET /ontologies",
    "GET /ontologies/report",
    "GET /ontologies/{name:path}",
    "GET /explain",
    "GET /sparql",
    "GET /status",
    "GET /status/events",
    "GET /metrics",
    # They compute an answer and change nothing.
    "POST /match",
    "POST /explain",
    "POST /sparql",
)

PUBLISH = (
    # The statements of a source on its own stream: samples, their end, their quality.
    "POST /streams/{name}/samples",
    "POST /streams/{name}/samples/live",
    "POST /streams/{name}/end",
    "PUT /streams/{name}/quality",
)

ADMIN = (
    # They may quote what others sent.
    "GET /log",
    "GET /requests",
    "GET /settings",
    "PUT /streams/{name}",
    "DELETE /streams/{name}",
    "POST /templates",
    "PUT /templates/{name:path}",
    "DELETE /templates/{name:path}",
    "POST /events",
    "DELETE /events/{id}",
    "POST /subscriptions",
    "DELETE /subscriptions/{id}",
    "POST /queries",
    "DELETE /queries/{name}",
    "POST /kpl",
    "DELETE /kpl/{name:path}",
    "POST /specifications",
    "POST /annotations",
    "POST /transformations",
    "PUT /transformations/{name}",
    "PATCH /transformations/{name}",
    "DELETE /transformations/{name}",
    "POST /ontologies",
    "DELETE /ontologies/{name:path}",
)

NEEDED: Mapping[str, Scope | None] = (
    dict.fromkeys(OPEN)
    | dict.fromkeys(READ, Scope.READ)
    | dict.fromkeys(PUBLISH, Scope.PUBLISH)
    | dict.fromkeys(ADMIN, Scope.ADMIN)
)
"""The scope of each route; None for an open one."""


_BY_FORMAT = {route.replace(":path}", "}"): scope for route, scope in NEEDED.items()}


def scope_of_operation(method: str, path: str) -> Scope | None:
    """The scope of a route as OpenAPI writes it; None if it is open."""
    return _BY_FORMAT.get(f"{method.upper()} {path}", Scope.ADMIN)


@dataclass(frozen=True, slots=True)
class Rule:
    """A route, ``METHOD /path``, and the scope it needs."""

    route: str
    scope: Scope | None


UNKNOWN = Rule("", Scope.ADMIN)
"""The rule for a path without a route, and for a route without an entry."""


class Rules:
    """Finds the rule for a request as the router finds its route: by the same expressions on the
    same decoded path. Otherwise a spelling of a path could match an open rule here and another
    route there (tests/laws/service/test_scopes.py).

    Cost: a look-up for a path without parameters, else one expression a route of the method.
    """

    def __init__(self, needed: Mapping[str, Scope | None] = NEEDED) -> None:
        self._fixed: dict[tuple[str, str], Rule] = {}
        self._by_method: dict[str, list[tuple[re.Pattern[str], Rule]]] = {}
        for route, scope in _most_frequent_first(needed.items()):
            method, _, path = route.partition(" ")
            rule = Rule(route, scope)
            expression = compile_path(path)[0]
            self._by_method.setdefault(method, []).append((expression, rule))
            if "{" not in path:
                self._fixed[method, path] = rule

    def find(self, method: str, path: str) -> tuple[Rule, dict[str, str]]:
        """The rule of a request, and the values of the parameters in its path."""
        fixed = self._fixed.get((method, path))
        if fixed is not None:
            return fixed, {}
        for expression, rule in self._by_method.get(method, ()):
            if match := expression.match(path):
                return rule, match.groupdict()
        return UNKNOWN, {}


def _most_frequent_first(
    needed: Iterable[tuple[str, Scope | None]],
) -> list[tuple[str, Scope | None]]:
    """The rules of publishing first: most requests are batches of samples."""
    return sorted(needed, key=lambda each: each[1] is not Scope.PUBLISH)
