"""Units that derive streams without computing values: adaptation to a policy, `join`, state
synchronization ([DyKnow10 Def. 5.11, 5.35], SPEC §1).

The kernels are in `streams`; these units connect them to generators.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from ...languages.kpl import object_field
from ...streams.generator import StreamGenerator
from ...streams.joins.join import Join
from ...streams.policies.keyed_adaptation import adapt_each
from ...streams.policies.policy import Policy, PolicyCounters
from ...streams.sample import FieldType, SampleBatch, SampleError, empty_batch
from ...streams.synchronization.synchronization import (
    StateCounters,
    Synchronization,
)
from ...streams.tuples import TupleBatch, flat_names, flat_schema
from .base import ComputationalUnit
from .violations import Violations


class PolicyUnit(ComputationalUnit):
    """A unit with a policy; ``violations`` gets the samples that the policy refuses."""

    def __init__(self, *args: Any, violations: Violations | None = None) -> None:
        super().__init__(*args)
        self.violations = violations

    @property
    @abstractmethod
    def policy_counters(self) -> PolicyCounters | StateCounters | None:
        """The fates of the samples; None for a unit without a policy."""

    def stop(self) -> None:
        super().stop()
        if self.violations is not None:
            self.violations.end()

    def finish(self, source: StreamGenerator) -> None:
        super().finish(source)
        if self.violations is not None and self.all_ended:
            self.violations.end()


def counts_of(unit: PolicyUnit) -> dict[str, object]:
    """Return the counters of a unit by name. Dropped samples are counted by kind of constraint."""
    counters = unit.policy_counters
    counts: dict[str, object] = {} if counters is None else asdict(counters)
    if isinstance(counters, PolicyCounters):
        counts["dropped"] = {str(kind): count for kind, count in counters.dropped.items()}
    else:
        counts["late"] = unit.late + (0 if counters is None else counters.late)
    if isinstance(unit, TupleUnit) and unit.held:
        counts |= {"held": unit.held, "waits for fields of": unit.open_inputs}
    return counts


class AdaptationUnit(PolicyUnit):
    """A subscription with a policy: its output is in eval_fsterm(label with policy) (Def. 5.35).

    ``keys`` are fields that name objects; with them the policy holds for each object separately.
    """

    def __init__(
        self,
        *args: Any,
        policy: Policy,
        keys: Sequence[str] = (),
        violations: Violations | None = None,
    ) -> None:
        super().__init__(*args, violations=violations)
        self.policy = policy
        self.keys = tuple(keys)
        on_drop = None if violations is None else violations.add_dropped
        self._adaptation = adapt_each(policy, keys, on_drop, rules=self.output.rules)

    @property
    def policy_counters(self) -> PolicyCounters:
        """The fates of the samples: sent, dropped with the reason, delayed, approximated."""
        return self._adaptation.counters

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        self._offer(self._adaptation.push(batch))
        self._offer(self._adaptation.advance(source.promise_after(batch)))

    def progress(self, source: StreamGenerator, watermark: int) -> None:
        self._offer(self._adaptation.advance(watermark))
        super().progress(source, watermark)

    def finish(self, source: StreamGenerator) -> None:
        self._offer(self._adaptation.end())
        super().finish(source)

    def _offer(self, batches: Sequence[SampleBatch]) -> None:
        for batch in batches:
            # Without keys the times increase. Several objects may have samples at one time, which
            # the rules `UNIQUE_TIMES` do not allow.
            stamps = self.output.stamps_at(batch.available) if self.keys else batch.available
            self.output.emit(batch.with_available(stamps))


class TupleUnit(PolicyUnit):
    """``join(w1 … wn)`` or ``sync(w1 … wn; policy)``: one sample for each tuple. Its fields are
    those of the inputs under the names of `flat_names`, with no_value for an input without sample.

    ``identifiers`` name the inputs, which may contain a stream twice. With ``inner_times`` the
    available and valid time (ns) of each input's sample are the fields ``NAME_available`` and
    ``NAME_valid``. While an input is open, tuples wait until it has fields or ends without any.
    More waiting tuples than the output retains are an error.
    """

    def __init__(
        self,
        *args: Any,
        kernel: Join | Synchronization,
        identifiers: Sequence[str],
        inner_times: bool = False,
        violations: Violations | None = None,
    ) -> None:
        super().__init__(*args, violations=violations)
        self._kernel = kernel
        self.inner_times = inner_times
        self._identifiers = tuple(identifiers)
        self._names: list[list[str]] | None = None
        self._held: list[TupleBatch] = []
        self.held = 0
        """Tuples that wait for the fields of `open_inputs`."""
        self._find_names()

    @property
    def kernel(self) -> Join | Synchronization:
        """What makes the tuples."""
        return self._kernel

    @property
    def field_names(self) -> Sequence[Sequence[str]]:
        """The names of each input's fields in a tuple; empty before they are known."""
        return self._names or [[] for _ in self.inputs]

    @property
    def policy_counters(self) -> StateCounters | None:
        """The fates of samples and states; None for a join, which has no policy."""
        return self._kernel.counters if isinstance(self._kernel, Synchronization) else None

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        for place in self._places(source):
            own = None if self._names is None else len(self._names[place]) - 2 * self.inner_times
            if own is not None and own != len(batch.columns):
                raise SampleError(
                    f"stream {source.name!r} has fields now, but it had ended without any, and "
                    f"{self.output.name} has gone on without them: declare them in its sort"
                )
            self._offer(self._kernel.push(place, batch))
            self._offer(self._kernel.advance(place, source.promise_after(batch)))

    def decided(self, source: StreamGenerator) -> int:
        # All places of one stream get the same calls, so any of them has the answer.
        return self._kernel.decided(self._places(source)[0])

    def resume(self, source: StreamGenerator) -> None:
        super().resume(source)
        for place in self._places(source):
            self._kernel.resume(place)

    def progress(self, source: StreamGenerator, watermark: int) -> None:
        for place in self._places(source):
            self._offer(self._kernel.advance(place, watermark))
        known = self._kernel.known
        if known is not None and not self._held:
            self.output.advance(known + 1)

    def finish(self, source: StreamGenerator) -> None:
        for place in self._places(source):
            self._offer(self._kernel.end(place))
        super().finish(source)

    def _places(self, source: StreamGenerator) -> list[int]:
        return [i for i, given in enumerate(self.inputs) if given is source]

    def _offer(self, found: TupleBatch | Sequence[TupleBatch] | None) -> None:
        """Emit tuples, or hold them while the fields are not known."""
        batches = [found] if isinstance(found, TupleBatch) else found or []
        tuples = [batch for batch in batches if len(batch)]
        self._held += tuples
        self.held += sum(map(len, tuples))
        names = self._find_names()
        if names is None:
            self._hold(tuples)
            return
        held, self._held, self.held = self._held, [], 0
        for part in held:
            # A batch from before the input had fields has no columns.
            inputs = tuple(
                batch if batch.columns else empty_batch(source.schema, source.stream.pools)
                for batch, source in zip(part.inputs, self.inputs, strict=True)
            )
            complete = TupleBatch(part.available, part.valid, inputs, part.rows)
            self.output.emit(complete.flatten(names, self.inner_times))

    @property
    def open_inputs(self) -> list[str]:
        """Inputs that have no fields yet and have not ended."""
        open = [source for source in self.sources if source.is_open]
        return [source.name for source in open if source not in self._ended]

    def _hold(self, tuples: Sequence[TupleBatch]) -> None:
        """Compact the tuples that were just added, since they may wait for long."""
        if tuples:
            self._held[-len(tuples) :] = [batch.compact() for batch in tuples]
        if self.held > self.output.stream.retention.samples:
            raise SampleError(
                f"{self.held} tuples wait for the fields of {', '.join(self.open_inputs)}: "
                "declare them in the sort of its source or unit"
            )

    def _find_names(self) -> list[list[str]] | None:
        """Return the names of each input's fields, None while they are not known. The output adopts
        the fields."""
        if self._names is not None:
            return self._names
        open = [source for source in self.sources if source.is_open]
        if open and not (self._held and self._ended.issuperset(open)):
            return None
        schemas = [source.schema for source in self.inputs]
        names = self._names = flat_names(self._identifiers, schemas, self.inner_times)
        pools = {
            name: source.stream.pools[field.name]
            for own, source in zip(names, self.inputs, strict=True)
            for name, field in zip(own, source.schema.fields, strict=False)
            if field.type is FieldType.STRING
        }
        self.output.adopt(flat_schema(names, schemas, self.inner_times), pools)
        return names


class ObjectSelectionUnit(ComputationalUnit):
    """``selectObject(w)``: passes on the samples of one object, unchanged.

    The field ``object``, else ``id``, else the first text field names the object of a sample; it is
    compared with ``object`` as text. Cost: one comparison a sample.
    """

    def __init__(self, *args: Any, object: str) -> None:
        super().__init__(*args)
        self._object = object

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        texts = [n for n, column in batch.columns.items() if column.type is FieldType.STRING]
        name = object_field(texts)
        if name is None:
            raise SampleError("no field names the object of a sample: there is no text field")
        column = batch.columns[name]
        assert column.pool is not None
        selected = (column.values == column.pool.find(self._object)) & column.present
        if bool(selected.any()):
            self.output.emit(batch.take(selected))
