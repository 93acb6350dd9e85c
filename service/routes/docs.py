"""The console at `/`, and the page with the HTTP reference. Both load files of this service only,
nothing from outside."""

from __future__ import annotations

from pathlib import Path

from fastapi import Request, Response
from fastapi.responses import JSONResponse

from ..config.media_types import HTML, JSON
from ..config.version import __version__
from ..http.negotiation import accepted
from ..http.page_files import PageFiles
from ..http.routers import resource_router

router = resource_router(include_in_schema=False)

_SERVICE = Path(__file__).resolve().parent.parent
STATIC = PageFiles(_SERVICE / "static")
CONSOLE = PageFiles(_SERVICE / "console")


@router.get("/")
async def home(request: Request) -> Response:
    """Return the console, or the list of routes for `Accept: application/json`."""
    if accepted(request, (HTML, JSON)) == HTML:
        answer = CONSOLE.answer("index.html", request)
        answer.headers.add_vary_header("Accept")
        return answer
    routes = [
        {"method": method.upper(), "path": path, "does": operation["description"].split("\n\n")[0]}
        for path, operations in request.app.openapi()["paths"].items()
        for method, operation in operations.items()
    ]
    links = {"version": __version__, "docs": "/docs", "openapi": "/openapi.json"}
    return JSONResponse({**links, "routes": routes}, headers={"Vary": "Accept"})


@router.get("/console/{name:path}")
async def console(name: str, request: Request) -> Response:
    """Return a file of the console."""
    return CONSOLE.answer(name, request)


@router.get("/docs")
async def page(request: Request) -> Response:
    """Return the documentation of all routes; its script reads /openapi.json."""
    return STATIC.answer("docs.html", request)


@router.get("/static/{name}")
async def static(name: str, request: Request) -> Response:
    """Return a style or script of the page."""
    return STATIC.answer(name, request)
