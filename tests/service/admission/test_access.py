"""Who may do what, from where: tokens, hosts, pages of browsers, on a real server."""

from __future__ import annotations

import logging
import socket
import struct
from collections.abc import Iterator
from functools import partial
from urllib.parse import urlsplit

import anyio
import httpx
import pytest
from asking import asking
from fastapi import FastAPI
from fastapi.routing import APIRoute
from pydantic import SecretStr
from starlette.types import Message
from typer.testing import CliRunner

from dyknow.engine.engine import Engine
from dyknow.service.admission.scopes import NEEDED, OPEN
from dyknow.service.admission.tokens import Scope
from dyknow.service.app import create_app
from dyknow.service.cli import app as commands
from dyknow.service.cli.main import COMMANDS, command
from dyknow.service.client.client import Client, ServiceError
from dyknow.service.config import logs
from dyknow.service.config.settings import Settings
from dyknow.service.server import running
from dyknow.streams.time import Clock

READ, PUBLISH, ADMIN = (f"{scope}-0123456789-0123456789" for scope in Scope)
WRITE_READ = "both-0123456789-0123456789"
LINES = f"read r {READ};publish p {PUBLISH};admin a {ADMIN};read,publish b {WRITE_READ}"
PAGE = "http://page.example:3000"
SAMPLE = b'{"valid": 1, "available": 1, "v": 1.5}\n'


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


@pytest.fixture
def settings() -> Settings:
    return Settings(port=0, tick=0.02, sse_ping=0, tokens=SecretStr(LINES), trusted_origins=PAGE)


@pytest.fixture
def admin(url: str) -> Iterator[Client]:
    with Client(url, token=ADMIN, timeout=120) as client:
        yield client


@pytest.fixture(scope="module")
def open_http() -> Iterator[httpx.Client]:
    """A service without tokens; nobody changes it."""
    settings = Settings(port=0, trusted_hosts="dyknow.example, *.below.example")
    with (
        running(create_app(Engine(epoch="e1"), settings, lambda: 0), settings) as url,
        asking(url) as client,
    ):
        yield client


def raw(url: str, request: bytes) -> bytes:
    """What comes back for bytes on a connection, until it is closed."""
    parts = urlsplit(url)
    with socket.create_connection((parts.hostname, parts.port), timeout=120) as connection:
        connection.sendall(request)
        connection.shutdown(socket.SHUT_WR)
        received = b""
        while data := connection.recv(65536):
            received += data
    return received


def status_of(answer: bytes) -> int:
    return int(answer.split(b" ", 2)[1])


# -- the table of scopes ---------------------------------------------------------------------------


def served(app: FastAPI) -> set[str]:
    """Every route of the application, as METHOD /path."""
    found = set()
    for route in app.routes:
        assert isinstance(route, APIRoute) or route.path == "/openapi.json", route
        found |= {f"{method} {route.path}" for method in (route.methods or ()) if method != "HEAD"}
    return found


def test_every_route_has_a_scope_and_the_other_way_round() -> None:
    app = create_app(Engine(epoch="e1"), Settings(), lambda: 0)
    assert served(app) == set(NEEDED)
    assert len(NEEDED) > 60


def test_what_changes_something_is_not_for_readers() -> None:
    reading = {route for route, scope in NEEDED.items() if scope in (None, Scope.READ)}
    changing = {route for route in reading if not route.startswith("GET ")}
    logging_in = {"POST /session", "DELETE /session"}
    assert changing == {"POST /match", "POST /explain", "POST /sparql"} | logging_in


def test_openapi_tells_the_scope_of_each_operation(http: httpx.Client) -> None:
    paths = http.get("/openapi.json").json()["paths"]
    assert paths["/templates/{name}"]["put"]["security"] == [{"token": ["admin"]}]
    assert paths["/streams/{name}/samples"]["post"]["security"] == [{"token": ["publish"]}]
    assert paths["/healthz"]["get"]["security"] == []


def test_each_route_wants_its_scope(http: httpx.Client) -> None:
    granted = {READ: {Scope.READ}, PUBLISH: {Scope.PUBLISH}, ADMIN: set(Scope)}
    granted[WRITE_READ] = {Scope.READ, Scope.PUBLISH}
    for route, needed in NEEDED.items():
        method, _, path = route.partition(" ")
        path = path.replace("{name:path}", "x").replace("{name}", "x").replace("{id}", "x")
        nobody = http.request(method, path)
        assert (nobody.status_code == 401) == (needed is not None), route
        for token, scopes in granted.items():
            # An event stream has no end; its head says the same.
            asked = "HEAD" if path == "/status/events" else method
            answer = http.request(asked, path, headers=bearer(token))
            refused = "scope=" in answer.headers.get("www-authenticate", "")
            assert refused == (needed is not None and needed not in scopes), route


# -- tokens ----------------------------------------------------------------------------------------


def test_nobody_is_asked_to_say_who_it_is(http: httpx.Client) -> None:
    answer = http.get("/streams")
    assert answer.status_code == 401
    assert answer.headers["www-authenticate"] == 'Bearer realm="dyknow"'
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["hint"]


@pytest.mark.parametrize(
    "given", ["Bearer wrong", "Bearer", f"Bearer {READ}x", f"Bearer {READ} {ADMIN}"]
)
def test_a_wrong_token_is_told_so(http: httpx.Client, given: str) -> None:
    answer = http.get("/streams", headers={"Authorization": given})
    assert answer.status_code == 401
    assert 'error="invalid_token"' in answer.headers["www-authenticate"]
    assert READ not in answer.text


@pytest.mark.parametrize("given", ["Basic cmVhZDpyZWFk", READ, f"Token {READ}", f"Bearer,{READ}"])
def test_other_ways_to_say_it_are_no_tokens(http: httpx.Client, given: str) -> None:
    answer = http.get("/streams", headers={"Authorization": given})
    assert answer.status_code == 401
    assert "error" not in answer.headers["www-authenticate"]


@pytest.mark.parametrize("kind", ["bearer", "BEARER", "Bearer ", "bEaReR   "])
def test_the_scheme_is_taken_in_any_case(http: httpx.Client, kind: str) -> None:
    answer = http.get("/streams", headers={"Authorization": f"{kind} {READ}"})
    assert answer.status_code == 200


def test_two_tokens_are_none(url: str) -> None:
    for tokens in ((READ, ADMIN), (ADMIN, READ), (ADMIN, ADMIN)):
        lines = "".join(f"Authorization: Bearer {token}\r\n" for token in tokens)
        answer = raw(url, f"GET /streams HTTP/1.1\r\nHost: localhost\r\n{lines}\r\n".encode())
        assert status_of(answer) == 400
        assert b'error="invalid_request"' in answer


def test_a_token_in_the_address_is_none(http: httpx.Client) -> None:
    for name in ("access_token", "token", "Authorization"):
        assert http.get("/streams", params={name: ADMIN}).status_code == 401
    assert http.post("/sparql", data={"access_token": ADMIN, "query": ""}).status_code == 401


def test_a_missing_scope_is_named(http: httpx.Client) -> None:
    answer = http.put("/streams/x", json={"fields": {"v": "float"}}, headers=bearer(WRITE_READ))
    assert answer.status_code == 403
    assert "needs scope admin" in answer.json()["detail"]
    assert 'error="insufficient_scope", scope="admin"' in answer.headers["www-authenticate"]
    assert http.get("/streams/x", headers=bearer(READ)).status_code == 404


def test_who_publishes_may_not_make_a_stream_by_it(admin: Client, http: httpx.Client) -> None:
    turtle = {"Content-Type": "text/turtle"}
    send = partial(http.post, "/streams/new/samples", content="<urn:a> <urn:p> 1 .")
    refused = send(params={"create": "rdf"}, headers=turtle | bearer(PUBLISH))
    assert refused.status_code == 403
    assert refused.json()["title"] == "scope missing"
    assert send(params={"create": "rdf"}, headers=turtle | bearer(ADMIN)).status_code == 202
    assert send(params={"create": "rdf"}, headers=turtle | bearer(PUBLISH)).status_code == 202


def test_who_publishes_need_not_read(admin: Client, http: httpx.Client) -> None:
    admin.put_stream("s", {"v": "float"})
    sent = http.post("/streams/s/samples", content=SAMPLE, headers=bearer(PUBLISH))
    assert sent.status_code == 202
    assert http.get("/streams/s/samples", headers=bearer(PUBLISH)).status_code == 403
    assert len(http.get("/streams/s/samples?limit=9", headers=bearer(READ)).text.splitlines()) == 1
    assert http.post("/streams/s/end", headers=bearer(PUBLISH)).status_code == 204


def test_nothing_of_a_body_is_read_for_nobody(url: str) -> None:
    head = (
        "POST /streams/s/samples HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000\r\n"
        "Expect: 100-continue\r\n\r\n"
    )
    answer = raw(url, head.encode())
    assert status_of(answer) == 401  # and no 100 before


def test_what_is_open_is_open_with_a_wrong_token_too(http: httpx.Client) -> None:
    reading = [route.removeprefix("GET ") for route in OPEN if route.startswith("GET ")]
    reading.remove("/session")  # which tells whose token it is
    for path in reading:
        file = {"{name:path}": "app.js", "{name}": "docs.js"}
        for part, name in file.items():
            path = path.replace(part, name)
        assert http.get(path, headers=bearer("wrong")).status_code == 200, path


def test_no_spelling_of_an_address_goes_around(url: str) -> None:
    for path in (
        "//streams",
        "/streams/",
        "/./streams",
        "/%2e/streams",
        "/healthz/../streams",
        "/healthz/",
        "/healthz%2f..%2fstreams",
        "/healthz%00",
        "/healthz%0a/x",
        "/healthz;/streams",
        "/static/../streams",
        "/static/%2e%2e/streams",
        "/STREAMS",
        "/docs/streams",
        "/healthz/streams",
        "/nothing",
    ):
        for method in ("GET", "POST", "PUT", "DELETE"):
            head = f"{method} {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: 0\r\n\r\n"
            assert status_of(raw(url, head.encode())) == 401, (method, path)


@pytest.mark.parametrize("method", ["HEAD", "OPTIONS", "TRACE", "PATCH", "PROPFIND"])
def test_no_method_goes_around(http: httpx.Client, method: str) -> None:
    assert http.request(method, "/streams").status_code == 401
    assert http.request(method, "/templates/x").status_code == 401


def test_head_needs_what_get_needs(http: httpx.Client) -> None:
    assert http.head("/status/events", headers=bearer(READ)).status_code == 200
    assert http.head("/status/events", headers=bearer(PUBLISH)).status_code == 403
    assert http.head("/healthz").status_code == 200


def test_an_upgrade_to_websockets_is_a_request_like_others(url: str) -> None:
    head = (
        "GET /status HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
        "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    )
    assert status_of(raw(url, head.encode())) == 401


def test_a_websocket_is_closed_before_it_begins() -> None:
    """Where another server than ours hands one on."""
    app = create_app(Engine(epoch="e1"), Settings(), lambda: 0)
    sent: list[Message] = []

    async def receive() -> Message:
        return {"type": "websocket.connect"}

    async def send(message: Message) -> None:
        sent.append(message)

    scope = {"type": "websocket", "path": "/status/events", "headers": [], "scheme": "ws"}
    anyio.run(app, scope, receive, send)
    assert [message["type"] for message in sent] == ["websocket.close"]


def test_event_streams_are_for_readers(admin: Client, url: str) -> None:
    admin.put_stream("s", {"v": "float"})
    admin.publish("s", SAMPLE)
    with Client(url, token=READ) as reader:
        event = next(iter(reader.events("s", since="start")))
        assert event.values == {"v": 1.5}
    with Client(url, token=PUBLISH) as publisher, pytest.raises(ServiceError) as caught:
        next(iter(publisher.events("s", since="start")))
    assert caught.value.status == 403


def test_event_streams_are_counted_by_token(engine: Engine, clock: Clock) -> None:
    """Not by address: behind a proxy all have one."""
    settings = Settings(port=0, tokens=SecretStr(LINES), sse_clients_each=1)
    with (
        running(create_app(engine, settings, clock), settings) as url,
        asking(url) as http,
        http.stream("GET", "/status/events", headers=bearer(READ)) as first,
    ):
        assert first.status_code == 200
        assert http.get("/status/events", headers=bearer(READ)).status_code == 429
        with http.stream("GET", "/status/events", headers=bearer(ADMIN)) as other:
            assert other.status_code == 200


def test_refusals_are_counted(http: httpx.Client) -> None:
    http.get("/streams")
    http.get("/streams", headers={"Host": "evil.example"})
    text = http.get("/metrics", headers=bearer(READ)).text
    assert 'dyknow_refusals_total{reason="not authenticated"} 1.0' in text
    assert 'dyknow_refusals_total{reason="wrong host"} 1.0' in text


# -- hosts -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "host",
    [
        "localhost",
        "LOCALHOST:1",
        "localhost.:8000",
        "127.0.0.1",
        "127.9.9.9:80",
        "[::1]:8000",
        "[0:0:0:0:0:0:0:1]",
        "dyknow.example",
        "Dyknow.Example.:443",
        "a.b.below.example",
    ],
)
def test_hosts_that_are_ours(open_http: httpx.Client, host: str) -> None:
    assert open_http.get("/streams", headers={"Host": host}).status_code == 200


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "localhost.evil.example",
        "127.0.0.1.evil.example",
        "10.0.0.1",
        "[::2]",
        "evil.dyknow.example",
        "below.example",
        "evilbelow.example",
        "2130706433",
        "0x7f.1",
    ],
)
def test_hosts_that_are_not_ours(open_http: httpx.Client, host: str) -> None:
    answer = open_http.get("/healthz", headers={"Host": host})
    assert answer.status_code == 421
    assert answer.json()["title"] == "wrong host"


@pytest.mark.parametrize(
    "host",
    [
        "",
        "user@localhost",
        "localhost:",
        "localhost:x",
        "localhost:99999",
        "local host",
        "[::1",
        "localhost, evil.example",
        "localhost/",
        ".",
    ],
)
def test_hosts_that_are_none(open_http: httpx.Client, host: str) -> None:
    answer = raw(str(open_http.base_url), f"GET /streams HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
    assert status_of(answer) == 400


def test_several_hosts_or_none_are_none(open_http: httpx.Client) -> None:
    url = str(open_http.base_url)
    twice = b"GET /streams HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n"
    assert status_of(raw(url, twice)) == 400
    assert status_of(raw(url, b"GET /streams HTTP/1.1\r\n\r\n")) == 400
    assert status_of(raw(url, b"GET /streams HTTP/1.0\r\n\r\n")) == 400
    assert status_of(raw(url, b"GET /streams HTTP/1.0\r\nHost: localhost\r\n\r\n")) == 200


def test_the_host_of_an_absolute_target_goes_before_the_header(open_http: httpx.Client) -> None:
    """RFC 9112, section 3.2.2."""
    url = str(open_http.base_url)
    for target, host, status in (
        ("http://evil.example/streams", "localhost", 421),
        ("http://localhost/streams", "localhost", 200),
        ("http://user@localhost/streams", "localhost", 400),
    ):
        request = f"GET {target} HTTP/1.1\r\nHost: {host}\r\n\r\n"
        assert status_of(raw(url, request.encode())) == status, target


def test_a_service_at_all_addresses_is_called_by_each(engine: Engine, clock: Clock) -> None:
    settings = Settings(host="0.0.0.0", port=0, tokens=SecretStr(LINES))
    with running(create_app(engine, settings, clock), settings) as url:
        for host, status in (("192.168.1.5:80", 200), ("[fe80::1]", 200), ("evil.example", 421)):
            answer = httpx.get(
                f"{url}/healthz", headers={"Host": host}, trust_env=False, timeout=60
            )
            assert answer.status_code == status


# -- pages -----------------------------------------------------------------------------------------


def same_port(client: httpx.Client) -> str:
    return f"{client.base_url.host}:{client.base_url.port}"


def test_pages_of_this_service_may_send(open_http: httpx.Client) -> None:
    origin = {"Origin": f"http://{same_port(open_http)}", "Sec-Fetch-Site": "same-origin"}
    wanted = {"feature": "dyknow:speed", "sort": "dyknow:UAV"}
    assert open_http.post("/match", json=wanted, headers=origin).status_code == 200
    answer = open_http.get("/streams", headers=origin)
    assert answer.status_code == 200
    assert not [name for name in answer.headers if name.startswith("access-control")]


@pytest.mark.parametrize(
    "origin",
    [
        "null",
        "http://evil.example",
        "https://{own}",
        "http://localhost:{port}",
        "http://{host}",
        "http://{host}:1",
        "{own}",
        "http://{own}.evil.example",
        "http://evil.example@{own}",
        "http://{own}/",
        "",
        "file://",
        "chrome-extension://abc",
    ],
)
@pytest.mark.parametrize("method", ["GET", "POST", "PUT", "DELETE", "OPTIONS"])
def test_pages_elsewhere_may_not(open_http: httpx.Client, origin: str, method: str) -> None:
    own = same_port(open_http)
    host, port = own.split(":")
    headers = {"Origin": origin.format(own=own, host=host, port=port)}
    answer = open_http.request(method, "/streams", headers=headers)
    assert answer.status_code == 403
    assert answer.json()["title"] == "foreign origin"
    assert "access-control-allow-origin" not in answer.headers


def test_several_origins_are_foreign(open_http: httpx.Client) -> None:
    own = same_port(open_http)
    for other in (f"http://{own}", "http://evil.example"):
        lines = f"Host: {own}\r\nOrigin: http://{own}\r\nOrigin: {other}\r\n"
        request = f"GET /streams HTTP/1.1\r\n{lines}\r\n"
        assert status_of(raw(str(open_http.base_url), request.encode())) == 403


@pytest.mark.parametrize("site", ["cross-site", "same-site", "Cross-Site"])
def test_what_a_page_elsewhere_embeds_is_refused(open_http: httpx.Client, site: str) -> None:
    for mode, destination in (
        ("no-cors", "image"),
        ("no-cors", "script"),
        ("cors", "empty"),
        ("navigate", "iframe"),
        ("navigate", "object"),
    ):
        headers = {"Sec-Fetch-Site": site, "Sec-Fetch-Mode": mode, "Sec-Fetch-Dest": destination}
        assert open_http.get("/streams", headers=headers).status_code == 403
    # A form that is sent from there, by a browser that leaves Origin out.
    headers = {"Sec-Fetch-Site": site, "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}
    assert open_http.post("/kpl", content="source float x", headers=headers).status_code == 403
    assert open_http.get("/kpl").json() == []


def test_a_link_from_elsewhere_opens_the_page(open_http: httpx.Client) -> None:
    link = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}
    link["Sec-Fetch-Dest"] = "document"
    assert open_http.get("/docs", headers=link).status_code == 200
    for site in ("none", "same-origin"):
        assert open_http.get("/streams", headers={"Sec-Fetch-Site": site}).status_code == 200


def test_a_trusted_page_may_read_and_send(http: httpx.Client) -> None:
    preflight = {
        "Origin": PAGE,
        "Access-Control-Request-Method": "PUT",
        "Access-Control-Request-Headers": "authorization, content-type",
    }
    allowed = http.options("/streams/s", headers=preflight)
    assert allowed.status_code == 204
    assert allowed.headers["access-control-allow-origin"] == PAGE
    assert "PUT" in allowed.headers["access-control-allow-methods"]
    assert "authorization" in allowed.headers["access-control-allow-headers"].lower()
    body = {"fields": {"v": "float"}}
    origin = {"Origin": PAGE, "Sec-Fetch-Site": "cross-site"}
    made = http.put("/streams/s", json=body, headers={**origin, **bearer(ADMIN)})
    assert made.status_code == 201
    assert made.headers["access-control-allow-origin"] == PAGE
    assert set(made.headers["vary"].split(", ")) == {"Accept-Encoding", "Origin"}
    assert "Location" in made.headers["access-control-expose-headers"]
    assert "access-control-allow-credentials" not in made.headers


def test_a_trusted_page_reads_why_it_is_refused(http: httpx.Client) -> None:
    answer = http.get("/streams", headers={"Origin": PAGE})
    assert answer.status_code == 401
    assert answer.headers["access-control-allow-origin"] == PAGE
    other = http.get("/streams", headers={"Origin": f"{PAGE}1"})
    assert other.status_code == 403
    assert "access-control-allow-origin" not in other.headers
    assert http.get("/healthz").headers["vary"] == "Origin"


def test_answers_tell_browsers_what_they_are_not(open_http: httpx.Client) -> None:
    for path in ("/docs", "/streams", "/nothing", "/static/docs.js"):
        headers = open_http.get(path).headers
        assert headers.get_list("x-content-type-options") == ["nosniff"]
        assert headers["cross-origin-resource-policy"] == "same-origin"
    page = open_http.get("/docs")
    policy = page.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "frame-ancestors 'none'" in policy
    assert "unsafe" not in policy
    assert page.headers["referrer-policy"] == "no-referrer"
    # What the policy allows is all that the page has: own files, nothing inline.
    assert "<style" not in page.text
    assert " style=" not in page.text
    assert " on" not in page.text.split("<body>")[1].replace(" on ", "")
    assert page.text.count("<script") == page.text.count('<script src="/static/')


# -- who asks --------------------------------------------------------------------------------------


def test_the_client_sends_the_token_of_its_environment(
    url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DYKNOW_TOKEN", f"{READ}\n")
    with Client(url) as client:
        assert client.streams()
    with Client(url, token=f"{READ}x") as client, pytest.raises(ServiceError) as caught:
        client.streams()
    assert caught.value.status == 401
    monkeypatch.delenv("DYKNOW_TOKEN")
    with Client(url) as client, pytest.raises(ServiceError):
        client.streams()


def test_the_commands_send_a_token(url: str) -> None:
    def run(*arguments: str, **environment: str) -> tuple[int, str]:
        variables = {"DYKNOW_URL": url, "DYKNOW_TOKEN": "", **environment}
        result = CliRunner().invoke(commands, list(arguments), env=variables)
        return result.exit_code, result.output

    assert run("streams", "--token", READ)[0] == 0
    assert run("template", "list", DYKNOW_TOKEN=READ)[0] == 0
    status, text = run("streams")
    assert status == 1
    assert "this service requires a token" in text
    assert "--token" in text
    status, text = run("streams", "--json", "--token", "wrong-0123456789-0123456789")
    assert '"title": "not authenticated"' in text
    assert "DYKNOW_TOKEN" in text
    status, text = run("kpl", "add", "source float x", "--token", READ)
    assert "needs scope admin" in text


def test_every_command_with_a_url_takes_a_token() -> None:
    def check(name: str, arguments: list[str]) -> None:
        text = CliRunner().invoke(commands, [*arguments, "--help"], env={"COLUMNS": "200"}).output
        assert ("--url" in text) == ("--token " in text), name

    for name in COMMANDS:
        inner = getattr(command(name), "commands", None)
        for arguments in [[name]] if inner is None else [[name, each] for each in inner]:
            check(name, arguments)


def test_no_token_comes_into_a_log(
    engine: Engine,
    http: httpx.Client,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    logger: logging.Logger,
) -> None:
    """Also where a request fails in the service, and its frames are printed."""
    logs.configure("debug", as_json=False)

    def fails(*arguments: object) -> object:
        raise RuntimeError("broken within")

    monkeypatch.setattr(engine, "generators", fails)
    assert http.get("/streams", headers=bearer(ADMIN)).status_code == 500
    http.get("/streams", params={"token": ADMIN})
    http.get("/streams", headers=bearer("wrong-0123456789-0123456789"))
    for handler in logger.handlers:
        handler.flush()
    text = capsys.readouterr().err
    assert "broken within" in text
    assert "0123456789" not in text


def test_an_address_that_is_cut_off_is_no_failure(url: str) -> None:
    """A connection that is reset while its request comes leaves the service as it was."""
    parts = urlsplit(url)
    for _ in range(20):
        with socket.create_connection((parts.hostname, parts.port), timeout=120) as connection:
            linger = struct.pack("ii", 1, 0)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
            connection.sendall(b"GET /streams HTTP/1.1\r\nHost: localhost\r\n")
    assert httpx.get(f"{url}/healthz", trust_env=False, timeout=60).status_code == 200
