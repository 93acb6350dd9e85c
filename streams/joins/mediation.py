"""Mediate the streams of a changing set of objects into one ([DyKnow10 Def. 4.7]).

A stream of label sets says which objects there are: the set that became available last holds
(Def. 5.5's last_avail). A sample of an object's stream is passed on if the object was in the set
that held when the sample became available.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from typing import Final

import numpy as np

from ..input_queues import NOTHING_KNOWN, Input
from ..sample import Column, FieldType, SampleBatch, SampleError, Times
from ..stream_rules import Rules
from ..string_pool import StringPool
from ..time import TIME_MAX, TIME_MIN

Labels = tuple[str, ...]
_FAR: Final = 2**62


class Mediation:
    """One stream of the streams of the objects in a set that changes.

    Samples go out in order of available time, those of one instant in the order of their labels (by
    `UNIQUE_TIMES` each at the least free time from its own on). With ``tag`` a text field of that
    name, where the samples have none, says whose sample it is. Text is encoded with ``pools`` (by
    field; made where one lacks).

    The output is decided up to the least time up to which the set and the streams of its objects
    are known. An object that has left counts up to the time when it left. A stream that does not
    exist yet (`attach`) has no samples and delays nothing, except by what `promised` returns.

    Law: the output does not depend on how inputs were cut or interleaved, as long as streams are
    there when their objects enter (tests/laws). Cost of a `take`: O(n log n) numpy for n samples,
    and Python per object, and set that it leaves behind, with something to take; O(1) while the
    object that held it up the last time still does. Memory: what waits, and the sets that it needs.
    """

    def __init__(
        self,
        tag: str | None = None,
        pools: dict[str, StringPool] | None = None,
        rules: Rules | None = None,
    ) -> None:
        self._rules = Rules() if rules is None else rules
        self._tag = tag
        self._pools = {} if pools is None else pools
        # The sets that may still hold for a sample to come, and since when each does. Of two with
        # one time the second holds, and the first has the objects of all that it replaced.
        self._since: list[int] = [TIME_MIN]
        self._sets: list[frozenset[str]] = [frozenset()]
        self._members_known = self._members_last = NOTHING_KNOWN
        self._members_ended = False
        self.wanted: frozenset[str] = frozenset()
        """The objects whose samples may still be needed."""
        self._blocker: str | None = None
        # Of each object one for each life of its stream that something waits of; the last is read.
        self._inputs: dict[str, list[Input]] = {}
        self._last = TIME_MIN - 1
        self.promised = TIME_MAX
        """Up to then streams are final: whoever may still make one for an object, or make one
        anew, knows that."""
        self.done = NOTHING_KNOWN
        """Everything available by then has been given; what comes is available later."""

    @property
    def members(self) -> frozenset[str]:
        """The last set of objects."""
        return self._sets[-1]

    @property
    def reached(self) -> int:
        """What comes is available later; samples may have been moved beyond `done`."""
        return max(self.done, self._last)

    @property
    def has_ended(self) -> bool:
        """Nothing comes any more: the last set is all that is left, it is final, and so are the
        streams of its objects that are there."""
        return (
            self._members_ended
            and self.promised == TIME_MAX
            and len(self._sets) == 1
            and all(self._current(label).ended_at is not None for label in self._read_members())
        )

    def push_members(self, available: Sequence[int], sets: Sequence[Labels]) -> None:
        """The next label sets, whose available times do not decrease; of an instant the last
        holds.
        """
        self._members_ended = False
        for time, members in zip(available, sets, strict=True):
            self._members_last = time
            self._members_known = max(self._members_known, time - 1)
            labels = frozenset(members)
            if labels == self._sets[-1]:
                continue
            if self._since[-2:] == [time, time]:
                # The instant may still end with a set of the objects of those before: keep them.
                self._since.pop()
                replaced = self._sets.pop()
                self._sets[-1] |= replaced
            # The new set may no longer have the object that held the others back.
            self._blocker = None
            self._since.append(time)
            self._sets.append(labels)
            self.wanted |= labels

    def advance_members(self, watermark: int) -> None:
        """Promise that later label sets are available at ``watermark`` or after it."""
        self._members_known = max(self._members_known, watermark - 1)

    def end_members(self) -> None:
        """End the sets: the last one stays."""
        self._members_ended = True
        self._members_known = max(self._members_known, self._members_last)

    def resume_members(self) -> None:
        """Continue the sets after their end: samples wait for them again."""
        self._members_ended = False

    def attach(self, label: str) -> None:
        """The stream of ``label`` is there, or another one in its place: what the one before has
        not promised is waited for."""
        lives = self._inputs.setdefault(label, [])
        lives.append(_after(lives))

    def push(self, label: str, batch: SampleBatch) -> None:
        """The next samples of an attached stream; those that were decided already are left out."""
        input = self._current(label)
        # A stream in another's place may say what that had promised not to.
        batch = batch.take(batch.available > max(self.done, input.known))
        if len(batch):
            input.push(batch)

    def advance(self, label: str, watermark: int) -> None:
        """Promise that later samples of ``label`` are available at ``watermark`` or after it."""
        self._current(label).advance(watermark)

    def end(self, label: str) -> None:
        """End the stream of ``label``."""
        self._current(label).end()

    def resume(self, label: str) -> None:
        """Continue the stream of ``label`` after its end."""
        self._current(label).resume()

    def end_at(self, label: str, until: int) -> None:
        """No more samples of ``label``, and none that is available later than ``until`` counts."""
        input = self._current(label)
        whole = self._inputs[label][-1] = Input()
        for batch in input.take(until):
            whole.push(batch)
        # Promises of the stream stay, but reach no further than the end of this life.
        whole.advance(min(input.known, until) + 1)
        whole.end()

    def forget(self, label: str) -> None:
        """What waits of the stream of ``label`` that was attached last does not hold, and it is
        not there any more: one in its place may say it anew."""
        lives = self._inputs[label]
        lives.pop()
        if not lives:
            del self._inputs[label]

    def _current(self, label: str) -> Input:
        """What is known of the stream that is read."""
        return self._inputs[label][-1]

    def _read_members(self) -> list[str]:
        """The objects in the set that was told last whose streams are there."""
        return [label for label in self.members if label in self._inputs]

    def take(self) -> SampleBatch | None:
        """What is decided by now; None if that is nothing."""
        known = self._known()
        if known <= self.done:
            return None
        parts: list[tuple[str, SampleBatch]] = []
        since = np.array(self._since[: bisect_right(self._since, known)], np.int64)
        # `_merged` orders the samples of an instant by their place here.
        for label in sorted(self._inputs):
            batches = [batch for input in self._inputs[label] for batch in input.take(known)]
            if not batches:
                continue
            within = np.array([label in labels for labels in self._sets[: len(since)]], np.bool_)
            for batch in batches:
                # A set holds for the samples of its own instant, too.
                place = np.searchsorted(since, batch.available, "right") - 1
                chosen = batch.take(within[place])
                if len(chosen):
                    parts.append((label, chosen))
        self.done = known
        self._forget(known)
        return self._merged(parts) if parts else None

    def _known(self) -> int:
        """Up to when everything is decided."""
        # The stream that held the others back last time mostly still does: a quick answer.
        if self._blocker in self.wanted and self._known_of(self._blocker) <= self.done:
            return self.done
        known, self._blocker = TIME_MAX if self._members_ended else self._members_known, None
        for label in self.wanted:
            own = self._known_of(label)
            if own >= known:
                continue
            stays = self._stays(label)
            # A set that another one of its instant replaced never held: its objects delay nothing.
            if not stays:
                continue
            # Only samples from its entry to its leaving count, so the stream is awaited no further.
            entered, left = stays[0][0], stays[-1][1]
            own = max(own, entered - 1)
            if own < min(known, left - 1):
                known, self._blocker = own, label
        if known == TIME_MAX:
            # All that is there has ended. It may be taken up again, and others may come.
            ends = [self._current(label).known for label in self._read_members()]
            known = max(self.done, self._members_known, *ends)
        return known

    def _stays(self, label: str) -> list[tuple[int, int]]:
        """When an object is in a set that holds: since when, and the first moment after it."""
        ends = [*self._since[1:], TIME_MAX + 1]
        return [
            (since, end)
            for since, end, labels in zip(self._since, ends, self._sets, strict=True)
            if label in labels and since < end
        ]

    def _known_of(self, label: str | None) -> int:
        lives = self._inputs.get(label or "")
        if lives is None or lives[-1].ended_at is not None:
            return self.promised
        # A stream that is there but has not begun may still have samples of any time.
        return min(lives[-1].known, self.promised) if lives[-1].begun else NOTHING_KNOWN

    def _forget(self, known: int) -> None:
        """Let go of sets that no sample to come was available under, and of their objects."""
        for label, lives in self._inputs.items():
            if len(lives) > 1:
                # Earlier lives stay for their samples only: `_after` has given their promises to
                # the last one.
                waiting = [life for life in lives[:-1] if life.waiting]
                self._inputs[label] = [*waiting, lives[-1]]
        # The set that holds at ``known`` also holds for the samples after it.
        first = bisect_right(self._since, known) - 1
        if not first:
            return
        del self._since[:first], self._sets[:first]
        self.wanted = frozenset[str]().union(*self._sets)
        for label in self._inputs.keys() - self.wanted:
            del self._inputs[label]

    def _merged(self, parts: Sequence[tuple[str, SampleBatch]]) -> SampleBatch:
        fields = [(name, column.type) for name, column in parts[0][1].columns.items()]
        for label, batch in parts:
            if [(name, column.type) for name, column in batch.columns.items()] != fields:
                raise SampleError(f"the stream of {label} has other fields than those before")
        available = np.concatenate([batch.available for _, batch in parts])
        # Parts stand in the order of labels, so the stable sort orders ties by label.
        order = np.argsort(available, kind="stable")
        available = self._spaced(available[order])
        valid = np.concatenate([batch.valid for _, batch in parts])[order]
        columns = {}
        if self._tag is not None and all(name != self._tag for name, _ in fields):
            pool = self._pools.setdefault(self._tag, StringPool())
            codes = [np.full(len(batch), pool.code(label), np.int32) for label, batch in parts]
            tags = np.concatenate(codes)[order]
            columns[self._tag] = Column(FieldType.STRING, tags, None, pool)
        for name, kind in fields:
            own = [batch.columns[name] for _, batch in parts]
            columns[name] = self._column(name, kind, own).take(order)
        return SampleBatch(available, valid, columns)

    def _spaced(self, available: Times) -> Times:
        """``available``, which do not decrease, each at least the gap of the rules after the one
        before, and the first after the last before it.

        Raises `SampleError` where none is left: the end of 64-bit time.
        """
        if not self._rules.gap:
            available = np.maximum(available, max(self._last, TIME_MIN))
            self._last = int(available[-1])
            return available
        count = len(available)
        start = self._last + 1
        if start <= int(available[0]) and bool((available[1:] > available[:-1]).all()):
            moved = available
        elif int(available[0]) > -_FAR and max(start, int(available[-1])) < _FAR:
            steps = np.arange(count, dtype=np.int64)
            first = np.maximum(available, start)
            moved = np.maximum.accumulate(first - steps) + steps
        else:  # near the ends of 64 bits, where sums wrap around
            times = []
            for time in available.tolist():
                start = max(start, time) + 1
                times.append(start - 1)
            if times[-1] > TIME_MAX:
                raise SampleError("available times have reached the end of 64-bit time")
            moved = np.array(times, np.int64)
        self._last = int(moved[-1])
        return moved

    def _column(self, name: str, kind: FieldType, parts: Sequence[Column]) -> Column:
        values = [part.values for part in parts]
        pool = None
        if kind is FieldType.STRING:
            pool = self._pools.setdefault(name, StringPool())
            values = [part.recoded(pool).values for part in parts]
        null = None
        if any(part.null is not None for part in parts):
            null = np.concatenate([~part.present for part in parts])
        return Column(kind, np.concatenate(values), null, pool)


def _after(lives: Sequence[Input]) -> Input:
    """What is known of a stream that comes after others in its place."""
    input = Input()
    if lives:
        input.begun, input.known = lives[-1].begun, lives[-1].known
    return input
