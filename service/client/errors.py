"""The errors of the service, as the clients raise them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import httpx

_REDUNDANT_TITLES = ("unknown ", "no such route", "method not allowed", "empty body")
"""Beginnings of titles that a problem's detail repeats: "there is no stream 'x'"."""


class ServiceError(Exception):
    """An error response of the service: what happened, where, and what to do next."""

    def __init__(
        self,
        status: int,
        title: str,
        detail: str,
        *,
        hint: str = "",
        line: int | None = None,
        column: int | None = None,
        excerpt: str = "",
        problem: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(detail)
        self.status = status
        self.title = title
        self.detail = detail
        self.hint = hint
        self.line = line
        self.column = column
        self.excerpt = excerpt
        self.problem = dict(problem or {})
        """The whole problem document."""

    @property
    def _kind(self) -> str:
        """The title, unless the detail repeats it."""
        return "" if self.title.startswith(_REDUNDANT_TITLES) else f"{self.title}: "

    def __str__(self) -> str:
        place = ""
        if self.line is not None:
            place = f"line {self.line}" + ("" if self.column is None else f", column {self.column}")
            place += ": "
        lines = [f"{self._kind}{place}{self.detail}"]
        if self.excerpt:
            lines.append(self.excerpt)
        missing = [item for item in self.problem.get("missing") or () if item not in self.detail]
        if missing:
            lines += ["missing:", *(f"  - {item}" for item in missing)]
        if self.hint:
            lines.append(f"hint: {self.hint}")
        return "\n".join(lines)


def check(response: httpx.Response) -> None:
    """Raise `ServiceError` for an error response, whose body has been read."""
    if response.is_success:
        return
    try:
        problem = response.json()
    except ValueError:
        problem = {}
    if not isinstance(problem, dict) or "title" not in problem:
        # The response of a proxy, or of another service at this address.
        problem = {"title": response.reason_phrase or "error", "detail": response.text[:500]}
    if "retry-after" in response.headers:
        problem["retry_after"] = response.headers["retry-after"]
    raise ServiceError(
        response.status_code,
        str(problem["title"]),
        str(problem.get("detail", "")),
        hint=str(problem.get("hint", "")),
        line=problem.get("line"),
        column=problem.get("column"),
        excerpt=str(problem.get("excerpt", "")),
        problem=problem,
    )
