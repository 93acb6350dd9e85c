"""What a policy did not let through, as a stream of its own (SPEC §1: never lost from sight).

The stream ``<name>_violations`` belongs to stream ``<name>``. It comes into being with the first
sample that was not passed on, or when somebody asks for it.
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
"""Names of these streams end so."""
_LATE: Final = "late"


class Violations:
    """The violations of one policy; ``open`` makes the stream when it is needed.

    A sample is available when it was decided that the original is not passed on, and valid when
    that was. ``reason`` is the kind of constraint, ``arrived`` the available time (ns) of the
    original. Of one stream's subscription the fields of the original follow, under their names
    (with ``_`` behind where those are taken); of a synchronization ``input`` says which it was, and
    ``sample`` has its values as JSON.

    Cost: O(n) numpy a batch of one stream's; Python per sample of a synchronization's.
    """

    def __init__(self, open: Callable[[], StreamGenerator]) -> None:
        self._open = open
        self._stream: StreamGenerator | None = None
        self._reasons = StringPool([*map(str, REASONS), _LATE])
        self._inputs = StringPool()

    @property
    def stream(self) -> StreamGenerator:
        """The stream, made now if nobody has needed it."""
        if self._stream is None:
            self._stream = self._open()
        return self._stream

    @property
    def name(self) -> str | None:
        """The name of the stream; None as long as there is none."""
        return None if self._stream is None else self._stream.name

    def dropped(self, dropped: Dropped) -> None:
        """Samples that were not passed on to a subscription."""
        batch = dropped.batch
        columns = {
            "reason": self._text(dropped.reasons.astype(np.int32), self._reasons),
            "arrived": Column(FieldType.INTEGER, batch.available),
        }
        for name, column in batch.columns.items():
            columns[f"{name}_" if name in columns else name] = column
        self._offer(dropped.at, batch.valid, columns)

    def late(self, late: Late, label: str) -> None:
        """Samples of the input ``label`` that no state has used."""
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
            # A pool for each time: each sample is another text, and the stream forgets them.
            "sample": self._text(samples.encode(texts), samples),
        }
        self._offer(late.at, batch.valid, columns)

    def end(self) -> None:
        """The stream they belong to has come to its end."""
        if self._stream is not None:
            self._stream.end()

    def _offer(self, at: Times, valid: Times, columns: dict[str, Column]) -> None:
        stream = self.stream
        stream.emit(SampleBatch(stream.stamps_at(at), valid, columns))

    @staticmethod
    def _text(codes: np.ndarray, pool: StringPool) -> Column:
        return Column(FieldType.STRING, codes, None, pool)
