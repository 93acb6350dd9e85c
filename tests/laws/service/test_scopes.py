"""Law: the scope that a request is held against is that of the route that answers it, however its
address is spelled."""

from __future__ import annotations

from urllib.parse import unquote

from hypothesis import example, given
from hypothesis import strategies as st
from starlette.routing import Match

from dyknow.engine.engine import Engine
from dyknow.service.admission.scopes import NEEDED, UNKNOWN, Rules
from dyknow.service.app import create_app
from dyknow.service.config.settings import Settings

APP = create_app(Engine(epoch="e1"), Settings(), lambda: 0)
ROUTES = APP.routes
RULES = Rules()

words = sorted({word for route in NEEDED for word in route.partition(" ")[2].split("/") if word})
segments = st.sampled_from(words) | st.sampled_from(
    ["", ".", "..", "x", "%2e%2e", "%2f", "%00", "%0a", "streams;a", "STREAMS", "%73treams", "é"]
)
paths = st.builds(
    lambda parts, end: unquote("/" + "/".join(parts) + end),
    st.lists(segments, max_size=5),
    st.sampled_from(["", "/", "\n", "//"]),
)
methods = st.sampled_from(["GET", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE", "get"])


def answering(method: str, path: str) -> str | None:
    """The route that the router hands a request to, as METHOD /path."""
    scope = {"type": "http", "method": method, "path": path, "root_path": "", "headers": []}
    for route in ROUTES:
        if route.matches(scope)[0] is Match.FULL:
            return f"{method} {route.path}"
    return None


@given(methods, paths)
@example("GET", "/healthz\n")
@example("PUT", "/templates/a/b")
@example("DELETE", "/kpl/pos[car1]/x")
@example("POST", "/streams/x/samples/live")
@example("GET", "/static/../streams")
def test_the_rule_is_that_of_the_route(method: str, path: str) -> None:
    rule, parameters = RULES.find(method, path)
    route = answering(method, path)
    if route is None:
        assert rule is UNKNOWN  # nothing answers; whoever asks all the same needs the most
        return
    assert rule.route == route
    assert rule.scope == NEEDED[route]
    assert all(value in path for value in parameters.values())
