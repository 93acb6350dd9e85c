"""The last results of a registered query, window by window, as terms.

The samples of its stream have the same results in fields. Terms keep more: the datatype and
language of a literal, and whether a text is an IRI. ``/queries/{name}/results`` reads them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from ...continuous.operators.results import WindowResult

WINDOWS = 1_000
ROWS = 100_000


class KeptWindows:
    """At most ``windows`` results with at most ``rows`` solutions or triples in total. It evicts
    the oldest first, but never the last result, whatever its size. Cost: O(1) a window."""

    def __init__(self, windows: int = WINDOWS, rows: int = ROWS) -> None:
        self._limits = windows, rows
        self._kept: deque[WindowResult] = deque()
        self._rows = 0

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def latest(self) -> WindowResult | None:
        """The result of the last closed window, None before the first."""
        return self._kept[-1] if self._kept else None

    def keep(self, result: WindowResult) -> None:
        """Add the result of a window that has just closed."""
        self._kept.append(result)
        self._rows += result.size
        windows, rows = self._limits
        while len(self._kept) > windows or (self._rows > rows and len(self._kept) > 1):
            self._rows -= self._kept.popleft().size

    def between(
        self, start: int | None, end: int | None, limit: int | None
    ) -> Sequence[WindowResult]:
        """Return the windows that end from ``start`` to ``end`` (ns, both included), oldest first.
        ``limit`` keeps the newest of them, but the oldest if there is a ``start``: a client that
        pages on needs the next ones."""
        found = [
            result
            for result in self._kept
            if (start is None or result.end >= start) and (end is None or result.end <= end)
        ]
        if limit is None:
            return found
        return found[:limit] if start is not None else found[max(0, len(found) - limit) :]
