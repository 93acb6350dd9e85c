"""A pattern over samples of several objects, each evaluated by itself (SPEC §8)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ....streams.sample import Times
from ...states.part_departures import PartDepartures, PartSteps
from ..evaluation.part_rows import InParts
from ..plans.by_object import PART, PatternByObject, within_part
from ..plans.limits import DEFAULT_LIMITS, Limits
from ..plans.plan import PatternPlan
from ..plans.query import Keys
from ..plans.rows import Values, concatenated
from .choice import evaluator_of
from .combined import StaticSolutions
from .recognition import Batch, Recognition, Recognized, joined

Parts: TypeAlias = NDArray[np.int64]


class PartRecognition(Recognition):
    """The matches of a pattern of each object by itself; an object is a part, by its number.

    Law (tests/laws/reasoning/patterns/test_part_recognition.py): the results of a part, and when
    they are available, are those of `Recognition` over its own samples. The limits are those of all
    parts together. Cost: that of one `Recognition` over all samples.
    """

    evaluator: InParts

    def __init__(
        self,
        pattern: PatternByObject,
        streams: int,
        keys: Keys,
        *,
        lateness: Sequence[int] = (),
        limits: Limits = DEFAULT_LIMITS,
    ) -> None:
        self._column = pattern.column
        super().__init__(pattern.query, streams, keys, lateness=lateness, limits=limits)
        if self._changes is not None:
            self._changes.has_parts = True
        self._part_departures = PartDepartures(streams, lateness)
        self.late_of: NDArray[np.int64] = np.empty(0, np.int64)
        """The rows of each part that came too late."""
        self.samples_of: NDArray[np.int64] = np.empty(0, np.int64)
        """The samples of each part that came."""
        self._rows_of_parts = np.zeros((len(self._kinds), 0), np.int64)

    def add_part(self) -> int:
        """Return the number of a new part, whose samples may follow."""
        part = self._part_departures.add_part()
        self.evaluator.make_room_for(part + 1)
        if part == len(self.late_of):
            more = max(16, part)
            self.late_of = np.concatenate([self.late_of, np.zeros(more, np.int64)])
            self.samples_of = np.concatenate([self.samples_of, np.zeros(more, np.int64)])
            kinds = np.zeros((len(self._kinds), more), np.int64)
            self._rows_of_parts = np.concatenate([self._rows_of_parts, kinds], axis=1)
        return part

    def end_part(self, part: int) -> None:
        """Drop all that is known of a part. Cost: O(rows and matches that wait)."""
        self.evaluator.drop_part(part)
        self._waiting = self._others(self._waiting, part)
        self._parts = [self._others(each, part) for each in self._parts]

    def explain(self) -> str:
        return f"{super().explain()}, for each object at its own time"

    def watermark_of(self, part: int = 0) -> int:
        return self.evaluator.watermark_of(part)

    def rows_of_part(self, part: int) -> dict[str, int]:
        """Return the rows of each kind that came of a part."""
        return dict(zip(self._kinds, self._rows_of_parts[:, part].tolist(), strict=True))

    def add(
        self,
        stream: int,
        kind: str,
        samples: NDArray[np.int64],
        available: Times,
        start: Times,
        end: Times,
        columns: Mapping[str, Values],
    ) -> None:
        super().add(stream, kind, samples, available, start, end, columns)
        parts = np.asarray(columns[self._column], np.int64)
        np.add.at(self._rows_of_parts[self._kinds.index(kind)], parts, 1)

    def came_in_parts(self, stream: int, available: Times, valid: Times, part: Parts) -> None:
        """Take the times of samples in a batch of a stream, with their parts; see `came`."""
        self._begin(stream, len(available))
        np.add.at(self.samples_of, part, 1)
        self._part_departures.add(stream, available, valid, part)

    def resumed(self, stream: int) -> None:
        """A stream goes on after its end."""
        self._part_departures.resume(stream)

    def ended(self, stream: int, moment: int) -> None:
        self._part_departures.end(stream, moment)

    def set_idle(self, streams: Iterable[int]) -> None:
        self._part_departures.idle = frozenset(streams)

    def advance(self, watermark: int, *, by_clock: bool = False) -> Recognized:
        steps = self._part_departures.advance(watermark, by_clock=by_clock)
        new = self._before(watermark)
        late, new = new.split(new.end < steps.reached_before(self._part_of(new), new.available))
        self.late += len(late)
        np.add.at(self.late_of, self._part_of(late), 1)
        if self.is_ordered:
            return self._parts_in_order(new, steps)
        return self._as_they_come(new, lambda: self.evaluator.advance_parts(steps.latest))

    def _parts_in_order(self, new: Batch, steps: PartSteps) -> Recognized:
        rows = joined([self._waiting, new]).in_order()
        self._waiting, rows = rows.split(rows.end > steps.latest[self._part_of(rows)])
        first = self._number
        found = concatenated([self._pushed(rows), self.evaluator.advance_parts(steps.latest)])
        reached = steps.reaching(found.outputs[PART], found.decided)
        return self._decided(found, reached, rows, first)

    def _within_part(self, number: int) -> PatternPlan:
        return within_part(self.plans[number], self._column)

    def _named_columns(self) -> tuple[str, ...]:
        # The column of the part has its number.
        return tuple(name for name in super()._named_columns() if name != self._column)

    def _evaluator(self, limits: Limits, static: StaticSolutions | None) -> InParts:
        (plan,) = self.plans
        found = evaluator_of(plan, is_ordered=self.is_ordered, limits=limits, part=self._column)
        assert isinstance(found, InParts)
        return found

    def _part_of(self, rows: Batch) -> Parts:
        return np.asarray(rows.columns[self._column], np.int64)

    def _others(self, rows: Batch, part: int) -> Batch:
        return rows.take(self._part_of(rows) != part)
