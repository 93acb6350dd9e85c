"""The results of a query as server-sent events: one message a window, in SPARQL JSON.

The samples of a query's stream have fields; here each window keeps the terms of the query. A
message has the id of the window's last sample, so a client resumes as with the stream's own events.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
from fastapi import Request
from fastapi.responses import Response

from ...continuous.operators.results import WindowResult
from ...streams.time import format_time
from ..http.encodings.sparql_results import result_json
from ..http.problems import Problem
from .cursor import Cursor, Start, message
from .delivery import Delivery
from .feed import Feed
from .feeds import Feeds, stream_of

Kept = Callable[[int], WindowResult | None]
"""Returns the kept result of the window that ends at a time (ns)."""


class WindowCursor(Cursor):
    """The position of one client in the windows of a query; ``most``: characters of a result.

    A window that is no longer kept, or is larger, is a ``gap`` with its end and the reason.
    """

    def __init__(self, feeds: Feeds, name: str, start: Start, kept: Kept, most: int) -> None:
        super().__init__(feeds, name, start)
        self._epoch = feeds.epoch
        self._kept = kept
        self._most = most

    def piece(self, feed: Feed, number: int, until: int) -> tuple[int, bytes]:
        """The message of the window whose samples begin with ``number``."""
        end, last = None, number
        for segment in feed.generator.stream.since(number, until + 1 - number):
            valid = segment.batch.valid
            end = int(valid[0]) if end is None else end
            # All samples of a window are valid at its end, so another time begins the next window.
            others = np.flatnonzero(valid != end)
            last += int(others[0]) if len(others) else len(valid)
            if len(others):
                break
        assert end is not None
        last -= 1
        told: dict[str, object] = {"query": self.name, "window_end": format_time(end)}
        result, reason = self._kept(end), "this window is no longer kept"
        if result is not None:
            try:
                told |= result_json(result, self._most)
            except Problem as problem:
                result, reason = None, str(problem.detail)
        if result is None:
            return last, message("gap", {**told, "reason": reason})
        data = msgspec.json.encode(told)
        return last, f"id: {self._epoch}-{last}\nevent: result\ndata: ".encode() + data + b"\n\n"


def result_stream(
    feeds: Feeds, request: Request, key: str, name: str, since: str | None, kept: Kept, most: int
) -> Response:
    """Return the response that sends the windows of a query, as `feeds.event_stream`."""

    def opened(start: Start) -> WindowCursor:
        return WindowCursor(feeds, name, start, kept, most)

    return stream_of(feeds, request, key, name, Delivery(since), opened)
