"""Sessions of browsers: a cookie in place of a token, from pages of this service only."""

from __future__ import annotations

import re

import httpx
import pytest
from pydantic import SecretStr

from dyknow.service.admission.sessions import (
    COOKIE,
    LASTS,
    MOST,
    MOST_OF_ONE,
    Sessions,
    set_cookie,
)
from dyknow.service.admission.tokens import Caller, Scope
from dyknow.service.client.client import Client
from dyknow.service.config.settings import Settings

READ, ADMIN = "read-0123456789-0123456789", "admin-0123456789-0123456789"
PAGE = "http://page.example:3000"
OWN = {"Sec-Fetch-Site": "same-origin"}


@pytest.fixture
def settings() -> Settings:
    tokens = SecretStr(f"read r {READ};admin a {ADMIN}")
    return Settings(port=0, tick=0.02, sse_ping=0, tokens=tokens, trusted_origins=PAGE)


def log_in(http: httpx.Client, token: str, **headers: str) -> httpx.Response:
    answer = http.post("/session", json={"token": token}, headers={**OWN, **headers})
    http.cookies.clear()  # each request says for itself what it sends
    return answer


def cookie(answer: httpx.Response) -> dict[str, str]:
    return {"Cookie": answer.headers["set-cookie"].partition(";")[0]}


def test_a_token_gives_a_cookie_that_is_none(http: httpx.Client) -> None:
    answer = log_in(http, READ)
    assert answer.status_code == 204
    header = answer.headers["set-cookie"]
    for attribute in ("HttpOnly", "SameSite=Strict", "Path=/", "Max-Age=43200"):
        assert attribute in header
    assert READ not in header
    assert "Secure" not in header
    assert answer.headers["cache-control"] == "no-store"
    assert http.get("/streams", headers=OWN | cookie(answer)).status_code == 200
    refused = http.post("/kpl", content="source float x", headers=OWN | cookie(answer))
    assert refused.status_code == 403


def test_backlog_tls_it_is_secure(http: httpx.Client) -> None:
    answer = log_in(http, READ, **{"X-Forwarded-Proto": "https"})
    assert "; Secure" in answer.headers["set-cookie"]


def test_a_wrong_token_gives_none(http: httpx.Client) -> None:
    answer = log_in(http, f"{READ}x")
    assert answer.status_code == 401
    assert "set-cookie" not in answer.headers
    assert READ not in answer.text
    for body in ({}, {"token": 1}, {"token": "x" * 2000}, []):
        assert http.post("/session", json=body, headers=OWN).status_code == 422


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Sec-Fetch-Site": "same-origin"}, 200),
        ({"Sec-Fetch-Site": "none"}, 200),
        ({"Origin": "{own}"}, 200),
        ({}, 401),  # no browser says so: who has got hold of a cookie has nothing
        ({"Sec-Fetch-Site": "same-site"}, 403),
        ({"Sec-Fetch-Site": "cross-site"}, 403),
        ({"Origin": PAGE}, 401),
        ({"Origin": PAGE, "Sec-Fetch-Site": "same-origin"}, 401),
        ({"Origin": "null", "Sec-Fetch-Site": "none"}, 403),
        (
            {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"},
            401,
        ),
    ],
)
def test_the_cookie_counts_from_our_pages_only(
    http: httpx.Client, url: str, headers: dict[str, str], status: int
) -> None:
    given = {name: value.format(own=url) for name, value in headers.items()}
    assert http.get("/streams", headers=given | cookie(log_in(http, READ))).status_code == status


def test_an_event_stream_needs_no_header(http: httpx.Client, url: str) -> None:
    with Client(url, token=ADMIN) as admin:
        admin.put_stream("s", {"v": "float"})
    with http.stream("GET", "/streams/s/events", headers=OWN | cookie(log_in(http, READ))) as told:
        assert told.status_code == 200
        assert next(told.iter_lines()) == ": dyknow"


def test_a_token_goes_before_a_cookie(http: httpx.Client) -> None:
    both = OWN | cookie(log_in(http, READ)) | {"Authorization": "Bearer wrong"}
    assert http.get("/streams", headers=both).status_code == 401
    both["Authorization"] = f"Bearer {ADMIN}"
    assert http.post("/kpl", content="source float x", headers=both).status_code == 201


def test_who_logs_out_is_out(http: httpx.Client) -> None:
    mine = OWN | cookie(log_in(http, READ))
    other = OWN | cookie(log_in(http, ADMIN))
    answer = http.delete("/session", headers=mine)
    assert answer.status_code == 204
    assert "Max-Age=0" in answer.headers["set-cookie"]
    assert http.get("/streams", headers=mine).status_code == 401
    assert http.get("/streams", headers=other).status_code == 200
    assert http.delete("/session", headers=OWN).status_code == 204


def test_a_page_is_told_who_it_is(http: httpx.Client) -> None:
    assert http.get("/session", headers=OWN).json() == {
        "required": True,
        "name": None,
        "scopes": [],
    }
    session = cookie(log_in(http, READ))
    assert http.get("/session", headers=OWN | session).json()["name"] == "r"
    assert http.get("/session", headers=session).json()["name"] is None
    admin = http.get("/session", headers={"Authorization": f"Bearer {ADMIN}"}).json()
    assert (admin["name"], admin["scopes"]) == ("a", ["admin", "publish", "read"])
    wrong = http.get("/session", headers={"Authorization": "Bearer wrong"})
    assert wrong.status_code == 401


def test_the_page_logs_in_and_out(http: httpx.Client) -> None:
    page, script = http.get("/docs").text, http.get("/static/docs.js").text
    for id in ("session", "who", "token", "log"):
        assert f'id="{id}"' in page
        assert f'$("{id}")' in script
    assert re.search(r'fetch\("/session", \{ method: "DELETE" \}\)', script)


def test_sessions_end_by_themselves() -> None:
    now = [0]
    sessions = Sessions(lambda: now[0])
    caller = Caller("x", frozenset({Scope.READ}))
    value = sessions.begin(caller)
    header = f"other=1; {COOKIE}=no; {COOKIE}={value}".encode()
    assert sessions.caller(header) is caller
    assert sessions.caller(f"not_{COOKIE}={value}".encode()) is None
    now[0] = LASTS
    assert sessions.caller(header) is None
    now[0] = 0
    assert sessions.caller(header) is None  # it is forgotten


def test_sessions_are_bounded() -> None:
    sessions = Sessions(lambda: 0)
    callers = [Caller(f"x{i}", frozenset()) for i in range(MOST + 1)]
    values = [sessions.begin(caller) for caller in callers]
    known = [sessions.caller(f"{COOKIE}={value}".encode()) for value in values]
    assert known == [None, *callers[1:]]
    assert set_cookie("v", secure=True).endswith("; Secure")


def test_nobody_logs_others_out() -> None:
    sessions = Sessions(lambda: 0)
    mine, others = Caller("me", frozenset()), Caller("other", frozenset())
    value = sessions.begin(mine)
    first, *rest = [sessions.begin(others) for _ in range(MOST_OF_ONE + 1)]
    assert sessions.caller(f"{COOKIE}={value}".encode()) is mine
    assert sessions.caller(f"{COOKIE}={first}".encode()) is None
    assert sessions.caller(f"{COOKIE}={rest[0]}".encode()) is others


@pytest.mark.parametrize("settings", [Settings(port=0)], ids=["open"])
def test_an_open_service_has_none(http: httpx.Client) -> None:
    assert http.get("/session").json()["required"] is False
    assert log_in(http, READ).status_code == 409
