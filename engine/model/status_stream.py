"""The status stream: every change of the stream space, as a sample ([Introspection15 §3.2]).

Listeners inside the system get the `Change` itself; the semantics manager is one of them
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
LONGEST = 2048
"""Characters of a text that are told: thousands of long ones would be gigabytes."""

Listener: TypeAlias = Callable[[Change], None]


class StatusStream:
    """Tells changes, one after another, to the listeners in order and then as a sample.

    To tell one may cause another, if a process reads the stream: that is told after it. ``clock``
    gives the time (ns).
    """

    def __init__(self, clock: Callable[[], int]) -> None:
        self._clock = clock
        self._listeners: list[Listener] = []
        self._untold: deque[Change] = deque()
        self._output: StreamGenerator | None = None

    def open(self, output: StreamGenerator) -> None:
        """From now on changes are samples of ``output``, too."""
        self._output = output
        output.stamped = True

    def listen(self, listener: Listener) -> None:
        """``listener`` hears of every change from now on."""
        self._listeners.append(listener)

    def tell(self, change: Change) -> None:
        """Something has changed."""
        self._untold.append(change)
        if len(self._untold) == 1:
            while self._untold:
                try:
                    self._tell(self._untold[0])
                finally:
                    self._untold.popleft()

    def _tell(self, change: Change) -> None:
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
            "inputs": _told(" ".join(change.inputs)) or None,
            "specification": _told(change.specification) or None,
        }
        output.offer(batch_from_rows(output.schema, [(now, now, values)], output.stream.pools), now)


def _told(text: str) -> str:
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}… ({len(text)} characters)"
