"""The newest HTTP requests, for `GET /requests`: which were refused, were slow or had long answers.

`AccessLog` adds each request when its answer has ended. Cost: a microsecond a request.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from datetime import datetime
from itertools import islice
from typing import Final

KEPT: Final = 1_000
"""Requests that are kept."""
LONGEST: Final = 500
"""Characters of a path; the rest of a longer one is cut."""


@dataclass(frozen=True, slots=True)
class AnsweredRequest:
    """A request whose answer has ended, by itself or with the connection.

    ``time``: when it began; ``path``: without the query, which may have a token; ``route``: the
    path of its route, empty without one; ``seconds``: until the answer began; ``size``: bytes of
    the answer's body as sent; ``problem``: the type of an error, else None.
    """

    time: datetime
    id: str
    method: str
    path: str
    route: str
    status: int
    seconds: float
    size: int
    problem: str | None


class RecentRequests:
    """Keeps the newest `KEPT` requests."""

    def __init__(self) -> None:
        self._requests: deque[AnsweredRequest] = deque(maxlen=KEPT)

    def add(self, request: AnsweredRequest) -> None:
        """Keep a request."""
        self._requests.append(request)

    def newest(self, least: int, most: int) -> list[AnsweredRequest]:
        """Return the newest ``most`` requests whose status is at least ``least``, newest first."""
        found = (each for each in reversed(self._requests) if each.status >= least)
        return list(islice(found, most))
