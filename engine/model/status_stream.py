"""The status stream: every change of the stream space, as a sample ([Introspection15 §3.2]).

Listeners within the engine receive the `Change` itself. The semantics manager is one of them
([Introspection15 §4.2]: "by listening to status streams, the semantics manager is able to keep
track of the state of the stream processing system").
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TypeAlias

from ...streams.generator import StreamGenerator
from ...streams.history import Retention
from ...streams.sample import Field, FieldType, Schema, batch_from_rows
from .status_changes import Change

STATUS = "status"
"""The name of the stream."""
FIELDS = ("change", "stream", "unit", "transformation", "inputs", "specification")
SCHEMA = Schema(tuple(Field(name, FieldType.STRING) for name in FIELDS))
RETENTION = Retention(samples=10_000)
MAX_TEXT = 2048
"""Characters of a text that a sample holds: thousands of long ones would take gigabytes."""

Listener: TypeAlias = Callable[[Change], None]


class StatusStream:
    """Reports changes one after another, first to the listeners in order, then as a sample.

    A report may cause another change, since processes may read the stream; that change is queued.
    ``clock`` returns the time (ns).
    """

    def __init__(self, clock: Callable[[], int]) -> None:
        self._clock = clock
        self._listeners: list[Listener] = []
        self._queue: deque[Change] = deque()
        """Unreported changes; the first one is being reported."""
        self._output: StreamGenerator | None = None

    def open(self, output: StreamGenerator) -> None:
        """Publish changes to ``output`` from now on."""
        self._output = output
        output.stamped = True

    def listen(self, listener: Listener) -> None:
        """Call ``listener`` with every change from now on."""
        self._listeners.append(listener)

    def report(self, change: Change) -> None:
        """Report ``change``, after the changes that are being reported."""
        self._queue.append(change)
        if len(self._queue) == 1:
            while self._queue:
                try:
                    self._report(self._queue[0])
                finally:
                    self._queue.popleft()

    def _report(self, change: Change) -> None:
        for listener in self._listeners:
            listener(change)
        output = self._output
        if output is None or change.stream == STATUS:
            return
        now = self._clock()
        values = {
            "change": str(change.kind),
            "stream": change.stream or None,
            "unit": change.unit or None,
            "transformation": change.transformation or None,
            "inputs": _truncate(" ".join(change.inputs)) or None,
            "specification": _truncate(change.specification) or None,
        }
        output.offer(batch_from_rows(output.schema, [(now, now, values)], output.stream.pools), now)


def _truncate(text: str) -> str:
    return text if len(text) <= MAX_TEXT else f"{text[:MAX_TEXT]}… ({len(text)} characters)"
