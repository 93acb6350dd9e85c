"""The files of the service's own pages: with an ETag, compressed, under a strict policy.

The policy allows own scripts, styles and fonts, nothing inline, requests to this service only, and
no frames of other pages.
"""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from pathlib import Path

from fastapi import Request, Response

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
    "Vary": "Accept-Encoding",
}
"""Headers of every file; service/server adds those of all responses. ``no-cache``: browsers keep a
file, and ask by its ETag whether it is current."""


@dataclass(frozen=True, slots=True)
class PageFile:
    """A file as it is sent. ``compressed`` is None where gzip saves nothing, as with fonts."""

    media_type: str
    content: bytes
    compressed: bytes | None
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
        """Return the file as a response: 304 if the client has it, compressed if it takes that.

        Raises a 404 `Problem` for any name that is none of the folder's files.
        """
        path = self._paths.get(name)
        if path is None:
            raise Problem(404, "no such route", f"there is no file {name!r}")
        file = _read(path, path.stat().st_mtime_ns)
        headers = POLICY | {"ETag": file.etag}
        known = request.headers.get("if-none-match", "")
        if file.etag in [each.strip() for each in known.split(",")]:
            return Response(status_code=304, headers=headers)
        if file.compressed is not None and _takes_gzip(request):
            headers["Content-Encoding"] = "gzip"
            return Response(file.compressed, media_type=file.media_type, headers=headers)
        return Response(file.content, media_type=file.media_type, headers=headers)


def _takes_gzip(request: Request) -> bool:
    for part in request.headers.get("accept-encoding", "").split(","):
        coding, _, weight = part.partition(";")
        if coding.strip().lower() == "gzip":
            return weight.replace(" ", "") not in ("q=0", "q=0.0")
    return False


@lru_cache(maxsize=128)
def _read(path: Path, changed: int) -> PageFile:
    """The file as it is since ``changed`` (ns): a change of a page shows without a restart."""
    content = path.read_bytes()
    # Compressed once, at the first request: the largest file takes some 20 ms.
    packed = gzip.compress(content, 9, mtime=0)
    compressed = packed if len(packed) < 0.9 * len(content) else None
    # Weak: the compressed file and the plain one are the same file.
    etag = f'W/"{sha256(content).hexdigest()[:32]}"'
    return PageFile(TYPES[path.suffix], content, compressed, etag)
