"""The last results of a registered query, window by window, as the query gave them.

The samples of its stream say the same in fields; here terms keep what fields cannot hold: the
datatype and language of a literal, whether a text is a name. Read by ``/queries/{name}/results``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from ...continuous.operators.results import WindowResult

WINDOWS = 1_000
ROWS = 100_000


class KeptWindows:
    """At most ``windows`` results with at most ``rows`` solutions or triples in all; the last one
    is kept whatever its size. The oldest go first. Cost: O(1) a window."""

    def __init__(self, windows: int = WINDOWS, rows: int = ROWS) -> None:
        self._limits = windows, rows
        self._kept: deque[WindowResult] = deque()
        self._rows = 0

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def latest(self) -> WindowResult | None:
        """The result of the last window that closed."""
        return self._kept[-1] if self._kept else None

    def keep(self, result: WindowResult) -> None:
        """The result of a window that has just closed."""
        self._kept.append(result)
        self._rows += result.size
        windows, rows = self._limits
        while len(self._kept) > windows or (self._rows > rows and len(self._kept) > 1):
            self._rows -= self._kept.popleft().size

    def between(
        self, start: int | None, end: int | None, limit: int | None
    ) -> Sequence[WindowResult]:
        """The windows that end from ``start`` to ``end`` (ns, both included), oldest first: the
        newest ``limit``, or with ``start`` the oldest."""
        found = [
            result
            for result in self._kept
            if (start is None or result.end >= start) and (end is None or result.end <= end)
        ]
        if limit is None:
            return found
        return found[:limit] if start is not None else found[max(0, len(found) - limit) :]
