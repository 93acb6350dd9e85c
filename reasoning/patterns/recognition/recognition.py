"""A pattern over samples: its rows in order, and when its matches become known (SPEC §8)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ....streams.sample import Times
from ....streams.time import TIME_MIN, format_duration
from ....streams.time_arithmetic import later
from ...states.departures import Departures, Steps
from ..evaluation.all_rows import AllRows
from ..evaluation.evaluator import Evaluator
from ..plans.limits import DEFAULT_LIMITS, Limits
from ..plans.network import minimal_network
from ..plans.plan import NO_VALUE, ColumnType, PatternPlan, PlanError, Selection
from ..plans.query import END, Branch, Keys, PatternQuery, with_numbers
from ..plans.rows import Matches, Rows, Values, concatenated
from ..sequences.next_rows import NextRows
from ..sequences.run_packing import sequence_network
from .changes import Changes
from .choice import evaluator_of
from .combined import CombinedRows, StaticSolutions
from .partial import Partial, Wanted, partial_matches, partial_runs

STREAM, SAMPLE, KIND = range(3)
"""Where a row comes from."""


@dataclass(frozen=True, slots=True, eq=False)
class Recognized:
    """Matches in order of available time. Shape ``(n,)``: ``available`` and ``valid`` are ns;
    ``outputs`` are those of the plans. ``rows`` as in `Matches`."""

    available: Times
    valid: Times
    outputs: Mapping[str, NDArray[Any]]
    rows: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.valid)


class Recognition:
    """The matches of a pattern over the samples of ``streams``, numbered from 0.

    A row's end is its valid time. Where order matters (probes, runs, trends, changes), a row waits
    until no earlier one may come: until the greatest valid times of all streams have reached it,
    less their ``lateness`` (ns, one a stream). With a ``max_delay`` of the query it waits that long
    after its time instead, by available times, so that the clock decides what did not happen. A
    match is available when it is decided. Other plans take rows as they arrive, and a match is
    available with the last of its rows. A row behind what has been reached is late in both: it is
    counted, and left out. ``keeps_places``: `places` may be asked for.

    Law (tests/laws/reasoning/patterns/test_recognition.py): results and their available times do
    not depend on batch cuts, nor on the order in which the streams deliver. Cost: a sort of the new
    rows.
    """

    def __init__(
        self,
        query: PatternQuery,
        streams: int,
        keys: Keys,
        *,
        lateness: Sequence[int] = (),
        limits: Limits = DEFAULT_LIMITS,
        keeps_places: bool = False,
        static: StaticSolutions | None = None,
    ) -> None:
        self.query = query
        self.is_ordered = needs_order(query)
        self.plans = plans = tuple(with_numbers(plan, keys) for plan in query.plans)
        self.evaluator = self._evaluator(limits, static)
        self.late = 0
        """Rows that came too late."""
        self._kinds = tuple(source.kind for source in query.sources)
        self.rows_of = dict.fromkeys(self._kinds, 0)
        """The rows of each kind that came."""
        self._columns = {
            column.name: np.float64 if column.type == "number" else np.int64
            for plan in plans
            for column in plan.columns
        }
        has_changes = any(source.has_changes for source in query.sources)
        self._changes = Changes(query.sources) if has_changes else None
        self._departures = Departures(query.max_delay, streams, lateness)
        self._begun = [0] * streams
        """The number of the first sample in the last batch of each stream."""
        self._samples = [0] * streams
        self._none = Batch.empty(self._columns)
        self._waiting = self._none
        """Rows, in order, for which an earlier one may still come."""
        self._parts: list[Batch] = []
        """Rows that are not before the watermark, by available time in each part."""
        self._number = 0
        """The number of rows given to the evaluator."""
        self._places: list[NDArray[np.int64]] | None = [] if keeps_places else None

    def explain(self) -> str:
        """Describe the plans and their evaluation."""
        order = "in order of valid time" if self.is_ordered else "as they arrive"
        delay = self.query.max_delay
        wait = "" if delay is None else f", at most {format_duration(delay)} after it"
        return f"{self.evaluator.explain()}\nrows are taken {order}{wait}"

    def losses(self) -> dict[str, int]:
        """Return what was left out for a limit, and how often."""
        counters = self.evaluator.counters
        lost = {
            "rows, beyond the limit of rows kept": counters.unstored,
            "rows, beyond the limit of rows kept for one key": counters.crowded,
            "rows that complete more matches than the limit": counters.cut_short,
            "matches, beyond the limit of those that wait": counters.unawaited,
            "matches that would have begun, beyond the limit of runs": counters.unstarted,
        }
        return {what: count for what, count in lost.items() if count}

    @property
    def retained(self) -> int:
        """The number of rows and matches in memory."""
        queued = sum(map(len, (self._waiting, *self._parts)))
        return queued + self.evaluator.kept + self.evaluator.pending

    def watermark_of(self, part: int = 0) -> int:
        """Return the time (ns) before which no row comes any more; with parts, none of ``part``."""
        return self.evaluator.watermark

    def partials(
        self, limit: int, keys: Collection[int | None] = (), part: int = 0
    ) -> tuple[list[tuple[PatternPlan, Partial]], bool]:
        """Return the partial matches with all these ``keys`` of objects and texts, at most
        ``limit``, the newest first, each with its plan; and whether there may be more. With parts,
        those of ``part``. Raises `PlanError` for a pattern that keeps neither rows to join nor
        runs."""
        wanted = Wanted(frozenset(keys), self._named_columns())
        evaluator = self.evaluator
        now = self.watermark_of(part)
        match evaluator:
            case NextRows():
                (plan,) = self.plans
                runs = evaluator.begun(part)
                parts = [(plan, partial_runs(sequence_network(plan), runs, now, limit, wanted))]
            case AllRows() | CombinedRows():
                joins = [(0, evaluator)] if isinstance(evaluator, AllRows) else evaluator.given()
                given = [(self._within_part(number), rows.rows(part)) for number, rows in joins]
                parts = [
                    (plan, partial_matches(minimal_network(plan), rows, now, limit, wanted))
                    for plan, rows in given
                ]
            case _:
                raise PlanError(
                    "under skip_till_any_match a repeated part has exponentially many partial "
                    "matches",
                    "write `WHERE skip_till_next_match`, or ask a pattern without repetition",
                )
        found = [(plan, each) for plan, partials in parts for each in partials.found]
        found.sort(key=lambda each: (-each[1].last, -len(each[1].rows)))
        has_more = len(found) > limit or any(partials.has_more for _, partials in parts)
        return found[:limit], has_more

    def _within_part(self, number: int) -> PatternPlan:
        """A plan for the rows of a part."""
        return self.plans[number]

    def _named_columns(self) -> tuple[str, ...]:
        """The columns whose keys are those of objects and texts."""
        read = {each.column: each for source in self.query.sources for each in source.columns}
        keys = {c.name for plan in self.plans for c in plan.columns if c.type is ColumnType.KEY}
        return tuple(name for name in keys if name not in read or not read[name].as_key)

    def places(self) -> NDArray[np.int64]:
        """Return where each row came from, by the numbers of `Recognized.rows`: `STREAM`, `SAMPLE`
        (its number there, from 0) and `KIND`; shape ``(n, 3)``. Contract: with ``keeps_places``."""
        assert self._places is not None
        return np.concatenate([np.empty((0, 3), np.int64), *self._places])

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
        """Take the rows of one kind in the batch of a stream that `came` has told of last.
        ``samples``: their places in that batch, in order."""
        count = len(end)
        self.rows_of[kind] += count
        place = np.empty((count, 3), np.int64)
        place[:, STREAM], place[:, KIND] = stream, self._kinds.index(kind)
        place[:, SAMPLE] = samples + self._begun[stream]
        filled: dict[str, Any] = {
            name: np.asarray(columns[name], type) if name in columns else _missing(type, count)
            for name, type in self._columns.items()
        }
        self._parts.append(Batch(available, place, start, end, filled))

    def came(self, stream: int, available: Times, valid: Times) -> None:
        """Take the times of all samples in a batch of a stream, in order of available time."""
        self._begin(stream, len(available))
        self._departures.add(stream, available, valid)

    def ended(self, stream: int, moment: int) -> None:
        """Wait for a stream no longer after the available time ``moment``, when it ended."""
        self._departures.end(stream, moment)

    def set_idle(self, streams: Iterable[int]) -> None:
        """Wait for these streams no longer, until they have samples again."""
        self._departures.idle = frozenset(streams)

    def advance(self, watermark: int, *, by_clock: bool = False) -> Recognized:
        """Return what the samples available before ``watermark`` decide. Contract: all of them were
        added. ``by_clock``: the clock, and no sample, has brought the watermark."""
        steps = self._departures.advance(watermark, by_clock=by_clock)
        new = self._before(watermark)
        is_late = new.end < steps.reached_before(new.available)
        if is_late.any():
            self.late += int(np.count_nonzero(is_late))
            new = new.take(~is_late)
        if self.is_ordered:
            return self._in_order(new, steps)
        return self._as_they_come(new, lambda: self.evaluator.advance(steps.latest))

    def finish(self, moment: int) -> Recognized:
        """Return what is decided at the end of all streams, which is at ``moment``."""
        rest = joined([self._waiting, *self._parts]).in_order()
        self._waiting, self._parts = self._none, []
        found = concatenated([self._pushed(rest), self.evaluator.end()])
        return self._results(found, np.full(len(found), moment, np.int64))

    def _evaluator(
        self, limits: Limits, static: StaticSolutions | None
    ) -> Evaluator | CombinedRows:
        branches = self.query.branches
        if len(self.plans) > 1 or any(branch != Branch() for branch in branches):
            ordered = self.is_ordered
            return CombinedRows(
                self.plans, branches, is_ordered=ordered, limits=limits, static=static
            )
        (plan,) = self.plans
        return evaluator_of(plan, is_ordered=self.is_ordered, limits=limits)

    def _begin(self, stream: int, count: int) -> None:
        """Begin a batch of ``count`` samples of a stream."""
        self._begun[stream] = self._samples[stream]
        self._samples[stream] += count

    def _before(self, watermark: int) -> Batch:
        """Take the new rows that are available before the watermark."""
        before, rest = [self._none], []
        for part in self._parts:
            cut = int(part.available.searchsorted(watermark, "left"))
            if cut:
                before.append(part if cut == len(part) else part.take(slice(0, cut)))
            if cut < len(part):
                rest.append(part.take(slice(cut, None)) if cut else part)
        self._parts = rest
        return joined(before)

    def _as_they_come(self, new: Batch, reach: Callable[[], object]) -> Recognized:
        """The results of rows that need no order. ``reach`` lets the evaluator reach the time that
        the streams have reached."""
        if len(new) > 1:
            new = new.take(new.order(new.available))
        first = self._number
        found = self._pushed(new)
        reach()
        return self._results(found, new.available[found.last - first])

    def _in_order(self, new: Batch, steps: Steps) -> Recognized:
        rows = joined([self._waiting, new]).in_order()
        side: Literal["left", "right"] = "right" if steps.delay is None else "left"
        leave, first = int(rows.end.searchsorted(steps.latest, side)), self._number
        self._waiting = self._none
        if leave < len(rows):
            self._waiting, rows = rows.take(slice(leave, None)), rows.take(slice(0, leave))
        found = concatenated([self._pushed(rows), self.evaluator.advance(steps.latest)])
        if not len(found):
            return self._results(found, found.decided)
        if steps.delay is not None:
            # One that had to wait is decided by what did not come up to the time before.
            waited = ~_is_by_row(found)
            return self._results(found, later(found.decided - waited, steps.delay))
        return self._decided(found, steps.reaching(found.decided), rows, first)

    def _decided(self, found: Matches, reached: Times, rows: Batch, first: int) -> Recognized:
        """The results of matches whose times are ``reached`` then. ``first``: the number of the
        first of the ``rows`` that have been pushed last."""
        # A match that had to wait is decided when its time is reached, another one by its last row,
        # which leaves when its time is reached, or later, when it comes.
        by_row = _is_by_row(found)
        came = rows.available[found.last[by_row] - first]
        reached[by_row] = np.maximum(reached[by_row], came)
        return self._results(found, reached)

    def _pushed(self, batch: Batch) -> Matches:
        if not len(batch):
            return self.evaluator.advance(TIME_MIN)
        self._number += len(batch)
        if self._places is not None:
            self._places.append(batch.place)
        rows = Rows(self._kinds, batch.place[:, KIND].copy(), batch.start, batch.end, batch.columns)
        if self._changes is not None:
            rows = self._changes.push(rows)
        return self.evaluator.push(rows)

    def _results(self, found: Matches, available: Times) -> Recognized:
        return Recognized(available, found.outputs[self.query.valid], found.outputs, found.rows)


def _is_by_row(found: Matches) -> NDArray[np.bool_]:
    """Which matches their last row decides; the others had to wait."""
    by_row: NDArray[np.bool_] = found.decided <= found.outputs[END]
    return by_row


def needs_order(query: PatternQuery) -> bool:
    """Whether rows must be taken in order of their ends: what did not happen, what follows and what
    was before are known only then."""
    return (
        any(source.has_changes for source in query.sources)
        or any(branch.absences for branch in query.branches)
        or any(
            plan.probes
            or plan.selection is not Selection.ANY_MATCH
            or any(element.is_kleene for element in plan.elements)
            or plan.trends
            for plan in query.plans
        )
    )


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Rows; ``place`` has the stream of each, the number of its sample there, and its kind, shape
    ``(n, 3)``."""

    available: Times
    place: NDArray[np.int64]
    start: Times
    end: Times
    columns: dict[str, Values]

    def __len__(self) -> int:
        return len(self.end)

    @classmethod
    def empty(cls, columns: Mapping[str, Any]) -> Batch:
        none = np.empty(0, np.int64)
        filled = {name: _missing(type, 0) for name, type in columns.items()}
        return cls(none, np.empty((0, 3), np.int64), none, none, filled)

    def take(self, rows: Any) -> Batch:
        columns = {name: values[rows] for name, values in self.columns.items()}
        return Batch(
            self.available[rows], self.place[rows], self.start[rows], self.end[rows], columns
        )

    def split(self, chosen: NDArray[np.bool_]) -> tuple[Batch, Batch]:
        """The rows that are chosen, and the others."""
        if not chosen.any():
            return self.take(slice(0, 0)), self
        return self.take(chosen), self.take(~chosen)

    def order(self, *times: Times) -> NDArray[np.int64]:
        """The order of the rows by the last of these times, then by those before it, by stream, and
        by sample."""
        return np.lexsort((self.place[:, SAMPLE], self.place[:, STREAM], *times))

    def in_order(self) -> Batch:
        """The rows in order of end, then of arrival."""
        if len(self) < 2:
            return self
        return self.take(self.order(self.available, self.end))


def joined(parts: Sequence[Batch]) -> Batch:
    """Return the rows of all parts, of which there is at least one."""
    filled = [part for part in parts if len(part)]
    if len(filled) < 2:
        return filled[0] if filled else parts[0]
    columns = {
        name: np.concatenate([part.columns[name] for part in filled]) for name in filled[0].columns
    }
    return Batch(
        np.concatenate([part.available for part in filled]),
        np.concatenate([part.place for part in filled]),
        np.concatenate([part.start for part in filled]),
        np.concatenate([part.end for part in filled]),
        columns,
    )


def _missing(type: Any, count: int) -> Values:
    return np.full(count, np.nan if type is np.float64 else NO_VALUE, type)
