"""Adapt a stream of many objects to a policy, each object by itself (SPEC §1, Policies).

Change, order and approximation then compare a sample with others of its object only, as if each
object had a stream of its own. Used for streams whose annotation has an id field, as
engine/configuration/policy_keys says. tests/laws/streams/test_keyed_policies.py compares it with
one `adapt` for each object.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..key_numbering import Numbering, Numbers, TextNumbering, paired
from ..sample import Column, SampleBatch
from ..stream_rules import Rules
from ..tuples import Rows
from .adaptation import Adaptation, Filtering, OnDrop, joined
from .policy import Policy, PolicyCounters
from .select_adaptation import adapt


def adapt_each(
    policy: Policy,
    keys: Sequence[str],
    on_drop: OnDrop | None = None,
    *,
    rules: Rules | None = None,
) -> Adaptation | KeyedAdapting:
    """`adapt`, for each object that the fields ``keys`` name by itself, if there are any."""
    if keys:
        return KeyedAdapting(policy, keys, on_drop, rules=rules)
    return adapt(policy, on_drop, rules=rules)


class KeyedAdapting:
    """One `Adaptation` for each object that the fields ``keys`` name; samples without a name are
    of one object together.

    Contract: as of `Adaptation`; each of ``keys`` is a field of text or integers.

    Law: for each object the samples sent and dropped are those that `adapt` gives for the samples
    of this object, while time passes for all. Together they are in order of available time; those
    of one instant as they came, or, where samples are held back or made, by object.

    Cost: O(n log n) numpy and one `push` for each object of a batch; where samples are held back or
    made, also one `advance` for each object there is. Memory: an `Adaptation` for each object, for
    as long as it lives.
    """

    def __init__(
        self,
        policy: Policy,
        keys: Sequence[str],
        on_drop: OnDrop | None = None,
        *,
        rules: Rules | None = None,
    ) -> None:
        self.policy = policy
        self._rules = rules
        self._on_drop = on_drop
        self._keys = tuple(keys)
        self._names = [_FieldNumbering() for _ in keys]
        self._pairs = [Numbering() for _ in keys[1:]]
        self._objects: dict[int, Adaptation] = {}
        # What is held back of an object may have to leave when another one has a sample.
        self._waits = not isinstance(adapt(policy), Filtering)

    @property
    def counters(self) -> PolicyCounters:
        """The sums over all objects. Cost: O(objects)."""
        total = PolicyCounters()
        for one in (adaptation.counters for adaptation in self._objects.values()):
            total.received += one.received
            total.kept += one.kept
            total.sent += one.sent
            total.delayed += one.delayed
            total.approximated += one.approximated
            total.pending += one.pending
            for constraint, count in one.dropped.items():
                total.drop(constraint, count)
        return total

    def push(self, batch: SampleBatch) -> list[SampleBatch]:
        """Take samples; returns those that can be sent now."""
        if not len(batch):
            return []
        numbers = self._numbers(batch)
        order = np.argsort(numbers, kind="stable")
        objects, starts = np.unique(numbers[order], return_index=True)
        sent: list[tuple[int, SampleBatch]] = []
        kept: list[Rows] = []
        for number, rows in zip(objects.tolist(), np.split(order, starts[1:]), strict=True):
            if number not in self._objects:
                self._objects[number] = adapt(self.policy, self._on_drop, rules=self._rules)
            adaptation = self._objects[number]
            sent += [(number, part) for part in adaptation.push(batch.take(rows))]
            if isinstance(adaptation, Filtering):
                kept.append(rows if adaptation.kept is None else rows[adaptation.kept])
        # Samples that leave on arrival keep the order in which they came.
        if not self._waits:
            chosen = np.sort(np.concatenate(kept))
            return [batch.take(chosen)] if len(chosen) else []
        # Time passes for all objects, also for those without a sample in this batch.
        return _in_order(sent + self._asked(lambda each: each.advance(int(batch.available[-1]))))

    def advance(self, watermark: int) -> list[SampleBatch]:
        """Promise that later samples have available time ≥ ``watermark``; returns those to send."""
        # A filter holds nothing back, so a watermark releases nothing.
        return self._of_all(lambda each: each.advance(watermark)) if self._waits else []

    def end(self) -> list[SampleBatch]:
        """End the stream (a later `push` continues it); returns the rest."""
        return self._of_all(lambda each: each.end())

    def _of_all(self, ask: Callable[[Adaptation], list[SampleBatch]]) -> list[SampleBatch]:
        return _in_order(self._asked(ask))

    def _asked(
        self, ask: Callable[[Adaptation], list[SampleBatch]]
    ) -> list[tuple[int, SampleBatch]]:
        return [(number, part) for number, each in self._objects.items() for part in ask(each)]

    def _numbers(self, batch: SampleBatch) -> Numbers:
        """A number of its object for each sample."""
        columns = [
            names.of(batch.columns[key]) for key, names in zip(self._keys, self._names, strict=True)
        ]
        found = columns[0]
        for pairs, other in zip(self._pairs, columns[1:], strict=True):
            found = pairs.of(paired(found, other))
        return found


class _FieldNumbering:
    """The numbers of the values of one field, from 1 on; 0 is no_value."""

    def __init__(self) -> None:
        self._texts = TextNumbering()
        self._integers = Numbering()

    def of(self, column: Column) -> Numbers:
        numbers = np.zeros(len(column), np.int64)
        present = column.present
        values = column.values[present]
        numbers[present] = 1 + (
            self._integers.of(values)
            if column.pool is None
            else self._texts.of(values, column.pool)
        )
        return numbers


def _in_order(parts: Sequence[tuple[int, SampleBatch]]) -> list[SampleBatch]:
    """The samples of objects as one batch, in order of available time, then of objects."""
    filled = [(number, batch) for number, batch in parts if len(batch)]
    if len(filled) < 2:
        return [batch for _, batch in filled]
    whole = joined([batch for _, batch in filled])
    numbers = np.repeat([number for number, _ in filled], [len(batch) for _, batch in filled])
    return [whole.take(np.lexsort((numbers, whole.available)))]
