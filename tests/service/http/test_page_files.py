"""The files of the service's pages: ETag, compression, policy, and nothing beside the pages."""

from __future__ import annotations

import gzip
import hashlib

import httpx
import pytest
from places import ROOT

from dyknow.service.http.compression import MINIMUM

CONSOLE = ROOT / "service" / "console"
BUDGET = 350_000
"""Bytes of the whole console, compressed."""
PAGES = sorted(
    path.relative_to(CONSOLE).as_posix()
    for path in CONSOLE.rglob("*")
    if path.suffix in (".html", ".js", ".css", ".woff2")
)
OWN = [name for name in PAGES if not name.startswith("vendor/") and name != "questions.js"]
"""All that is written by hand; questions.js has SPARQL, with its prefixes."""


def test_the_console_is_at_the_root(http: httpx.Client) -> None:
    page = http.get("/", headers={"Accept": "text/html,*/*;q=0.8"})
    assert page.status_code == 200
    assert page.headers["content-type"].startswith("text/html")
    assert page.text == (CONSOLE / "index.html").read_text()
    assert "Accept" in page.headers["vary"].split(", ")


def test_programs_get_the_routes_at_the_root(http: httpx.Client) -> None:
    answer = http.get("/", headers={"Accept": "application/json"})
    listed = {(each["method"], each["path"]) for each in answer.json()["routes"]}
    assert ("POST", "/streams/{name}/samples") in listed
    assert answer.json()["docs"] == "/docs"
    assert http.get("/", headers={"Accept": "image/png"}).status_code == 406


@pytest.mark.parametrize("name", PAGES)
def test_a_file_is_sent_whole_compressed_and_once(http: httpx.Client, name: str) -> None:
    plain = http.get(f"/console/{name}", headers={"Accept-Encoding": "identity"})
    assert plain.status_code == 200
    assert plain.content == (CONSOLE / name).read_bytes()
    assert "content-encoding" not in plain.headers
    policy = plain.headers["content-security-policy"]
    assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self'; ")
    assert "unsafe" not in policy
    packed = http.get(f"/console/{name}", headers={"Accept-Encoding": "br, gzip;q=0.5"})
    assert packed.content == plain.content  # httpx unpacks it
    is_packed = not name.endswith(".woff2") and len(plain.content) >= MINIMUM
    assert packed.headers.get("content-encoding") == ("gzip" if is_packed else None)
    refused = http.get(f"/console/{name}", headers={"Accept-Encoding": "gzip;q=0"})
    assert "content-encoding" not in refused.headers
    etag = plain.headers["etag"]
    again = http.get(f"/console/{name}", headers={"If-None-Match": f'"other", {etag}'})
    assert again.status_code == 304
    assert again.content == b""
    assert again.headers["etag"] == etag
    assert again.headers["vary"] == "Accept-Encoding"


def test_other_files_of_the_folder_are_not_served(http: httpx.Client) -> None:
    there = ("vendor/build.sh", "vendor/package.json", "vendor/SHA256SUMS")
    for name in (*there, "../app.py", "%2e%2e/app.py", "", "pages", "pages/none.js"):
        assert http.get(f"/console/{name}").status_code == 404, name


def test_the_console_fits_its_budget() -> None:
    sizes = {name: len(gzip.compress((CONSOLE / name).read_bytes(), 9)) for name in PAGES}
    assert sum(sizes.values()) < BUDGET, sizes


def test_vendored_files_are_those_that_the_sums_name() -> None:
    folder = CONSOLE / "vendor"
    lines = (folder / "SHA256SUMS").read_text().splitlines()
    sums = {name: value for value, name in (line.split() for line in lines)}
    there = {path.name for path in folder.iterdir() if path.suffix in (".js", ".css", ".woff2")}
    assert sums.keys() == there
    for name, value in sums.items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == value, name


@pytest.mark.parametrize("name", OWN)
def test_own_files_name_no_outside_address_and_no_inline_style(name: str) -> None:
    text = (CONSOLE / name).read_text()
    assert "https://" not in text
    assert 'style="' not in text
    assert "http://" not in text
