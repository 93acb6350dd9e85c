"""State synchronization of several streams ([DyKnow10 §5.4, §7.4], SPEC §1)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from ..input_queues import NOTHING_KNOWN, Input, known_of
from ..policies.policy import GRID_LIMIT, Constraint, Order, SynchronizationPolicy
from ..sample import Mask, SampleBatch, Times, concatenate
from ..tuples import TupleBatch
from .change_states import ChangeStates
from .complete_states import CompleteStates
from .grid_states import GridStates
from .states import InputSamples, LateRows, Made, States

PRUNED: Final = 8
"""New samples of an input after which a search for those that no state can use pays."""


@dataclass(frozen=True, slots=True, eq=False)
class Late:
    """Samples of one input that came too late for a state or broke the order, at times ``at``."""

    input: int
    batch: SampleBatch
    constraint: Constraint
    at: Times


@dataclass(slots=True)
class StateCounters:
    """Counts of samples and states.

    ``complete`` of the ``states`` had every input that had not ended. ``approximated`` values are
    of another valid time than the state's, ``unknown`` ones are no_value. ``late`` samples came
    after the first state that could have used them, ``dropped`` ones broke the order.
    ``incomplete`` states were never complete and never left; ``pending`` ones still wait.
    """

    received: int = 0
    states: int = 0
    complete: int = 0
    approximated: int = 0
    unknown: int = 0
    late: int = 0
    dropped: int = 0
    incomplete: int = 0
    pending: int = 0


class Synchronization:
    """States of n inputs under a policy.

    ``sample every s`` makes a state at every ``from + k*s``, any other change at every valid time
    of a sample in the duration. Without ``from`` the grid are the multiples of s from the valid
    time of the first sample that arrives, but from none whose deadline had passed before it came.
    The state for t leaves at L_t = max(c_t, L_before + 1), in order of t. c_t is t + max delay, or
    the moment before at which every input not ended has a sample valid at t, or at t or later
    where its valid times do not decrease. An input ends the moment after all it has promised; at
    the end of the last input nothing is complete that was not. Where states wait for ever
    (``max delay oo``) and some input is in any order, they leave in order of (c_t, t) instead, and
    an incomplete one holds back no other. A value is the most recent sample at t among those
    available at L_t; without approximation only if it is valid at t.

    Monotone inputs (``monotone[i]``, or all by the policy's order) lose samples that decrease.

    Law: what is given does not depend on how inputs were cut or interleaved, and everything that
    leaves by `known` has been given. Cost: see `GridStates`, `ChangeStates` and
    `CompleteStates`; each push that moves `known` copies what is kept. Memory: the samples that a
    state to come may use.
    """

    def __init__(
        self,
        policy: SynchronizationPolicy,
        monotone: Sequence[bool],
        on_late: Callable[[Late], None] | None = None,
        *,
        limit: int = GRID_LIMIT,
    ) -> None:
        if not monotone:
            raise ValueError("a synchronization has at least one input")
        self._policy = policy
        self._monotone = [each or policy.order is not Order.ANY for each in monotone]
        self._inputs = [Input() for _ in monotone]
        self._kept: list[SampleBatch | None] = [None] * len(monotone)
        self._reach = [NOTHING_KNOWN] * len(monotone)
        self._pruned = [0] * len(monotone)
        self._on_late = on_late
        self._states: States
        if policy.period is not None:
            self._states = GridStates(policy, limit)
        # Without a deadline and an order a state may wait for ever: it must hold back no other.
        elif policy.max_delay is None and not all(self._monotone):
            self._states = CompleteStates(policy)
        else:
            self._states = ChangeStates(policy)
        self._done = NOTHING_KNOWN
        self._finished = False
        self.counters = StateCounters()

    @property
    def known(self) -> int | None:
        """No later state leaves at or before it; None before all inputs have begun."""
        return known_of(self._inputs)

    @property
    def policy(self) -> SynchronizationPolicy:
        """The policy that the states follow."""
        return self._policy

    @property
    def monotone(self) -> Sequence[bool]:
        """Which inputs have valid times that do not decrease."""
        return self._monotone

    @property
    def ends(self) -> Sequence[int | None]:
        """The moment from which on states do not wait for each input; None: it goes on."""
        return [input.ended_at for input in self._inputs]

    @property
    def retained(self) -> int:
        """Number of kept samples."""
        kept = sum(len(batch) for batch in self._kept if batch is not None)
        return kept + sum(input.waiting for input in self._inputs)

    def push(self, input: int, batch: SampleBatch) -> list[TupleBatch]:
        """Take samples of ``input`` in order; returns the states that leave, in batches of at
        most 65,536."""
        self._inputs[input].push(batch, self._done)
        self.counters.received += len(batch)
        return self._proceed()

    def advance(self, input: int, watermark: int) -> list[TupleBatch]:
        """Promise that later samples of ``input`` are available at ``watermark`` or later."""
        self._inputs[input].advance(watermark)
        return self._proceed()

    def decided(self, input: int) -> int:
        """The time up to which samples of ``input`` come too late: states left without them, or a
        watermark excluded them."""
        return max(self._inputs[input].known, self._done)

    def resume(self, input: int) -> None:
        """Continue ``input`` after its end: states wait for it again."""
        self._inputs[input].resume()

    def end(self, input: int) -> list[TupleBatch]:
        """End ``input``."""
        self._inputs[input].end()
        return self._proceed()

    def _proceed(self) -> list[TupleBatch]:
        known = known_of(self._inputs)
        if known is None:
            return []
        finishing = all(input.ended_at is not None for input in self._inputs)
        if finishing:
            known = max(input.known for input in self._inputs)
            # The states after the end have been given; only a resumed input leads to more.
            if self._finished:
                return []
        elif known <= self._done:
            return []
        self._finished = finishing
        inputs, dropped = self._collect(known)
        made, late = self._states.run(inputs, known)
        self._done = max(self._done, known)
        if finishing:
            inputs = [one.without_news() for one in inputs]
            tail, self.counters.incomplete = self._states.finish(inputs)
            made += tail
        tables = [one.table for one in inputs]
        self._tell(tables, late, dropped)
        for i, one in enumerate(inputs):
            # At each push the search would cost more than the push itself.
            table = one.table
            if len(table) >= self._pruned[i] + PRUNED:
                table = self._states.of_use(one)
                self._pruned[i] = len(table)
            self._kept[i] = table
        self.counters.pending = 0 if finishing else self._states.pending
        return [self._state_batch(part, tables) for part in made]

    def _collect(self, known: int) -> tuple[list[InputSamples], list[Late]]:
        """Kept and new samples of each input, and what broke the order."""
        inputs: list[InputSamples] = []
        dropped: list[Late] = []
        for i, input in enumerate(self._inputs):
            kept, reached = self._kept[i], self._reach[i]
            table = kept if kept is not None and len(kept) else input.empty()
            first_new = len(table)
            parts = input.take(known)
            if parts:
                new = concatenate(parts)
                if self._monotone[i]:
                    falls = falling(new.valid, reached)
                    if falls is not None:
                        lost = new.take(falls)
                        dropped.append(Late(i, lost, Constraint.ORDER, lost.available))
                        new = new.take(~falls)
                if len(new):
                    newest = new.valid[-1] if self._monotone[i] else new.valid.max()
                    self._reach[i] = max(reached, int(newest))
                table = concatenate([table, new]) if first_new else new
            # With the last input's end there is no input left that could complete a state.
            ended = None if input.ended_at is None or input.ended_at > known else input.ended_at
            inputs.append(
                InputSamples(table, first_new, reached, self._reach[i], self._monotone[i], ended)
            )
        return inputs, dropped

    def _tell(
        self, tables: Sequence[SampleBatch], late: Sequence[LateRows], dropped: Sequence[Late]
    ) -> None:
        """Count and report what was late or dropped, in order of moment, then of input."""
        told = [*dropped]
        self.counters.dropped += sum(len(each.batch) for each in dropped)
        for i, rows, constraint in late:
            if len(rows):
                batch = tables[i].take(rows)
                told.append(Late(i, batch, constraint, batch.available))
                self.counters.late += len(rows)
        if self._on_late is None or not told:
            return
        moments = np.concatenate([each.at for each in told])
        source = np.repeat(np.arange(len(told)), [len(each.at) for each in told])
        place = np.concatenate([np.arange(len(each.at)) for each in told])
        # The order of reports must not depend on how the inputs were cut.
        order = np.lexsort((np.array([each.input for each in told])[source], moments))
        source, place = source[order], place[order]
        cuts = np.flatnonzero(np.diff(source)) + 1
        for run, rows in zip(np.split(source, cuts), np.split(place, cuts), strict=True):
            each = told[int(run[0])]
            batch = each.batch.take(rows)
            self._on_late(Late(each.input, batch, each.constraint, batch.available))

    def _state_batch(self, part: Made, tables: Sequence[SampleBatch]) -> TupleBatch:
        available, valid, rows, complete = part
        counters = self.counters
        counters.states += len(available)
        counters.complete += int(complete.sum())
        for table, chosen in zip(tables, rows, strict=True):
            absent = chosen < 0
            unknown = int(absent.sum())
            counters.unknown += unknown
            if len(table):
                # A row of -1 reads the last sample here, so it has to be masked.
                other = (table.valid[chosen] != valid) & ~absent
                counters.approximated += int(other.sum())
        return TupleBatch(available, valid, tuple(tables), rows)


def falling(valid: Times, reach: int) -> Mask | None:
    """Which of ``valid`` are less than one before or than ``reach``; None for none."""
    if valid[0] >= reach and (len(valid) == 1 or bool((valid[1:] >= valid[:-1]).all())):
        return None
    highest = np.maximum.accumulate(valid)
    if reach > highest[0]:
        highest = np.maximum(highest, reach)
    return valid < highest
