"""The samples that a policy refused, as a stream of their own (SPEC §1: never lost from sight).

The stream ``<name>_violations`` belongs to stream ``<name>``. The first refused sample or the first
request makes it.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Final

import numpy as np

from ...streams.generator import StreamGenerator
from ...streams.policies.adaptation import REASONS, Dropped
from ...streams.sample import Column, FieldType, SampleBatch, Times
from ...streams.string_pool import StringPool
from ...streams.synchronization.synchronization import Late

SUFFIX: Final = "_violations"
"""The suffix of these names."""
_LATE: Final = "late"


class Violations:
    """The violations of one policy; ``open`` makes the stream when it is needed.

    A sample is available at the time of the decision, with the valid time of the original.
    ``reason`` is the kind of constraint, ``arrived`` the available time (ns) of the original. For a
    subscription the fields of the original follow, with ``_`` after a name that is taken. For a
    synchronization ``input`` is the label of the input, and ``sample`` has the values as JSON.

    Cost: O(n) numpy a batch for a subscription; Python per sample for a synchronization.
    """

    def __init__(self, open: Callable[[], StreamGenerator]) -> None:
        self._open = open
        self._stream: StreamGenerator | None = None
        self._reasons = StringPool([*map(str, REASONS), _LATE])
        self._inputs = StringPool()

    @property
    def stream(self) -> StreamGenerator:
        """The stream; the first use makes it."""
        if self._stream is None:
            self._stream = self._open()
        return self._stream

    @property
    def name(self) -> str | None:
        """The name of the stream; None before it is made."""
        return None if self._stream is None else self._stream.name

    def add_dropped(self, dropped: Dropped) -> None:
        """Add samples that a subscription's policy has dropped."""
        batch = dropped.batch
        columns = {
            "reason": self._text(dropped.reasons.astype(np.int32), self._reasons),
            "arrived": Column(FieldType.INTEGER, batch.available),
        }
        for name, column in batch.columns.items():
            columns[f"{name}_" if name in columns else name] = column
        self._offer(dropped.at, batch.valid, columns)

    def add_late(self, late: Late, label: str) -> None:
        """Add samples of the input ``label`` that are in no state."""
        batch, count = late.batch, len(late.batch)
        reason = str(late.constraint) if str(late.constraint) == "order" else _LATE
        texts = [
            json.dumps(batch.values_at(row), ensure_ascii=False, separators=(",", ":"))
            for row in range(count)
        ]
        codes = np.full(count, self._reasons.code(reason), np.int32)
        samples = StringPool()
        columns = {
            "reason": self._text(codes, self._reasons),
            "input": self._text(self._inputs.encode([label] * count), self._inputs),
            "arrived": Column(FieldType.INTEGER, batch.available),
            # A new pool each time: the texts all differ, and the stream's pool frees old ones.
            "sample": self._text(samples.encode(texts), samples),
        }
        self._offer(late.at, batch.valid, columns)

    def end(self) -> None:
        """End the stream, since the policy's output has ended."""
        if self._stream is not None:
            self._stream.end()

    def _offer(self, at: Times, valid: Times, columns: dict[str, Column]) -> None:
        stream = self.stream
        stream.emit(SampleBatch(stream.stamps_at(at), valid, columns))

    @staticmethod
    def _text(codes: np.ndarray, pool: StringPool) -> Column:
        return Column(FieldType.STRING, codes, None, pool)
