"""The files of the service's own pages: with an ETag, under a strict policy. `Compression`
compresses them like all answers.

The policy allows own scripts, styles and fonts, nothing inline, requests to this service only, and
no frames of other pages.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from fastapi import Request, Response

from .entity_tags import entity_tag, names
from .problems import Problem

TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".woff2": "font/woff2",
}
"""The media types of the files that are served, by suffix; a folder's other files are not."""
POLICY = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "connect-src 'self'; img-src 'self' data:; font-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "X-Frame-Options": "DENY",
    "Cache-Control": "no-cache",
}
"""Headers of every file; service/server adds those of all responses. ``no-cache``: browsers keep a
file, and ask by its ETag whether it is current."""


@dataclass(frozen=True, slots=True)
class PageFile:
    """A file as it is sent."""

    media_type: str
    content: bytes
    etag: str


class PageFiles:
    """The files of a folder and of the folders within it, by their paths in it."""

    def __init__(self, folder: Path) -> None:
        self._paths = {
            path.relative_to(folder).as_posix(): path
            for path in folder.rglob("*")
            if path.suffix in TYPES
        }

    def answer(self, name: str, request: Request) -> Response:
        """Return the file as a response: 304 if the client has it.

        Raises a 404 `Problem` for any name that is none of the folder's files.
        """
        path = self._paths.get(name)
        if path is None:
            raise Problem(404, "no such route", f"there is no file {name!r}")
        file = _read(path, path.stat().st_mtime_ns)
        headers = POLICY | {"ETag": file.etag}
        if names(request.headers.get("if-none-match"), file.etag):
            return Response(status_code=304, headers=headers | {"Vary": "Accept-Encoding"})
        return Response(file.content, media_type=file.media_type, headers=headers)


@lru_cache(maxsize=128)
def _read(path: Path, changed: int) -> PageFile:
    """The file as it is since ``changed`` (ns): a change of a page shows without a restart."""
    content = path.read_bytes()
    return PageFile(TYPES[path.suffix], content, entity_tag(content))
