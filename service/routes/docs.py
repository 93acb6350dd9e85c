"""The page with the HTTP reference. It loads files of this service only, nothing from outside."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from fastapi import APIRouter, Response
from fastapi.responses import RedirectResponse

from ..http.problems import Problem

router = APIRouter(include_in_schema=False)

STATIC = Path(__file__).resolve().parent.parent / "static"
FILES = {
    "docs.html": "text/html; charset=utf-8",
    "docs.css": "text/css; charset=utf-8",
    "docs.js": "text/javascript; charset=utf-8",
}
POLICY = {
    # Own script and style, nothing inline; requests to this service; not inside other pages.
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "X-Frame-Options": "DENY",
    "Cache-Control": "no-cache",
}
"""Headers of the page and its files; service/server adds those of all responses."""


@router.get("/")
async def home() -> Response:
    """Send browsers to the documentation."""
    return RedirectResponse("/docs")


@router.get("/docs")
async def page() -> Response:
    """Return the documentation of all routes; its script reads /openapi.json."""
    return _file("docs.html")


@router.get("/static/{name}")
async def static(name: str) -> Response:
    """Return a style or script of the page."""
    return _file(name)


def _file(name: str) -> Response:
    if name not in FILES:
        raise Problem(404, "no such route", f"there is no file {name!r}")
    return Response(_read(name), media_type=FILES[name], headers=POLICY)


@lru_cache
def _read(name: str) -> bytes:
    return (STATIC / name).read_bytes()
