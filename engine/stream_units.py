"""Units that make streams of streams without computing values: adaptation to a policy, `join`,
state synchronization ([DyKnow10 Def. 5.11, 5.35], SPEC §1).

The kernels stand in `streams`; here they are connected to generators.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..streams.adapting import adapt
from ..streams.generator import StreamGenerator
from ..streams.joining import Join
from ..streams.policy import Policy, PolicyCounters
from ..streams.sample import SampleBatch, empty_batch
from ..streams.synchronization import Synchronization
from ..streams.tuples import TupleBatch, flat_names
from .unit import ComputationalUnit


class AdaptationUnit(ComputationalUnit):
    """A subscription with a policy: its output is in eval_fsterm(label with policy) (Def. 5.35)."""

    def __init__(self, *args: Any, policy: Policy) -> None:
        super().__init__(*args)
        self._adaptation = adapt(policy)

    @property
    def policy_counters(self) -> PolicyCounters:
        """What became of the samples: sent, dropped and why, delayed, approximated."""
        return self._adaptation.counters

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        self._offer(self._adaptation.push(batch))

    def progress(self, source: StreamGenerator, watermark: int) -> None:
        self._offer(self._adaptation.advance(watermark))
        super().progress(source, watermark)

    def finish(self, source: StreamGenerator) -> None:
        self._offer(self._adaptation.end())
        super().finish(source)

    def _offer(self, batches: Sequence[SampleBatch]) -> None:
        for batch in batches:
            self.output.offer(batch)


class TupleUnit(ComputationalUnit):
    """``join(w1 … wn)`` or ``sync(w1 … wn; policy)``: one sample a tuple, whose fields are those of
    the inputs under the names of `flat_names`; where an input has none they are no_value.

    ``identifiers`` name the inputs. The same stream may be given twice.
    """

    def __init__(
        self, *args: Any, kernel: Join | Synchronization, identifiers: Sequence[str]
    ) -> None:
        super().__init__(*args)
        self._kernel = kernel
        self._identifiers = tuple(identifiers)

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        for place in self._places(source):
            self._offer(self._kernel.push(place, batch))

    def progress(self, source: StreamGenerator, watermark: int) -> None:
        for place in self._places(source):
            self._offer(self._kernel.advance(place, watermark))
        known = self._kernel.known
        if known is not None:
            self.output.advance(known + 1)

    def finish(self, source: StreamGenerator) -> None:
        for place in self._places(source):
            self._offer(self._kernel.end(place))
        super().finish(source)

    def _places(self, source: StreamGenerator) -> list[int]:
        return [i for i, given in enumerate(self.inputs) if given is source]

    def _offer(self, made: TupleBatch | Sequence[TupleBatch] | None) -> None:
        batches = [made] if isinstance(made, TupleBatch) else made or []
        for tuples in batches:
            if not len(tuples):
                continue
            # An input that has no sample yet has no columns either.
            inputs = tuple(
                batch if batch.columns else empty_batch(source.schema, source.stream.pools)
                for batch, source in zip(tuples.inputs, self.inputs, strict=True)
            )
            whole = TupleBatch(tuples.available, tuples.valid, inputs, tuples.rows)
            names = flat_names(self._identifiers, [source.schema for source in self.inputs])
            self.output.offer(whole.flatten(names))
