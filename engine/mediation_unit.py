"""Mediation processes: ``aggregate`` and ``select`` ([DyKnow10 Def. 4.7])."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from ..streams.generator import StreamGenerator
from ..streams.mediation import Mediation
from ..streams.sample import SampleBatch
from .object_sets import sets_of
from .unit import ComputationalUnit

Inputs = Sequence[StreamGenerator]


class MediationUnit(ComputationalUnit):
    """The streams of the objects that its first input names, as one.

    ``stream_of`` gives the stream of an object, or None while there is none; ``on_inputs`` hears
    which inputs came and went. With ``select`` only the object named last in a set is in it.

    What comes is only noted; `settle` acts on it, once every process that makes or removes streams
    has done so. So what is passed on does not depend on who hears of a set first.
    """

    def __init__(
        self,
        *args: Any,
        kernel: Mediation,
        select: bool,
        stream_of: Callable[[str], StreamGenerator | None],
        on_inputs: Callable[[MediationUnit, Inputs, Inputs], None],
    ) -> None:
        super().__init__(*args)
        self._members = self.inputs[0]
        self._kernel = kernel
        self._select = select
        self._stream_of = stream_of
        self._on_inputs = on_inputs
        self._labels: dict[str, StreamGenerator] = {}
        self.unmet: tuple[str, ...] = ()
        """Objects in the set whose stream is not there."""

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        if source is self._members:
            sets = sets_of(batch)
            if self._select:
                sets = [labels[-1:] for labels in sets]
            self._kernel.push_members(batch.available.tolist(), sets)
        for label in self._labels_of(source):
            self._kernel.push(label, batch)

    def progress(self, source: StreamGenerator, watermark: int) -> None:
        if source is self._members:
            self._kernel.advance_members(watermark)
        for label in self._labels_of(source):
            self._kernel.advance(label, watermark)

    def finish(self, source: StreamGenerator) -> None:
        if source is self._members:
            self._kernel.end_members()
        for label in self._labels_of(source):
            self._kernel.end(label)

    def settle(self) -> bool:
        """Take the streams of objects that came, leave those of objects that went, pass on what is
        decided; tells whether anything was done."""
        acted = False

        def act() -> None:
            nonlocal acted
            acted = self._connect()
            made = self._kernel.take()
            if made is not None:
                self.output.offer(made)
                acted = True
            acted = self._disconnect() or acted
            self.output.advance(self._kernel.done + 1)
            if self._kernel.has_ended and not self.output.is_ended:
                self.output.end()

        self._guarded(act)
        return acted

    def _connect(self) -> bool:
        gained = []
        unmet = []
        for label in sorted(self._kernel.wanted - self._labels.keys()):
            found = self._stream_of(label)
            if found is None:
                unmet.append(label)
            else:
                self._labels[label] = found
                gained.append(found)
        self.unmet = tuple(unmet)
        if not gained:
            return False
        self.inputs += tuple(gained)
        self.sources = tuple(dict.fromkeys(self.inputs))
        self._on_inputs(self, gained, ())
        for label, generator in self._labels.items():
            if generator in gained:
                self._kernel.attach(label)
        for generator in dict.fromkeys(gained):
            for segment in generator.stream.since(0):
                self.process(generator, segment.batch)
            if generator not in self._subscribed:
                self.connect(generator)
        return True

    def _disconnect(self) -> bool:
        wanted = self._kernel.wanted
        gone = [label for label in self._labels if label not in wanted]
        if not gone:
            return False
        lost = [self._labels.pop(label) for label in gone]
        inputs = list(self.inputs)
        for generator in lost:
            inputs.remove(generator)
            if generator not in inputs:
                self._subscribed.remove(generator)
                generator.unsubscribe(self)
                self._watermarks.pop(generator, None)
                self._ended.discard(generator)
        self.inputs = tuple(inputs)
        self.sources = tuple(dict.fromkeys(inputs))
        self._on_inputs(self, (), lost)
        return True

    def _labels_of(self, source: StreamGenerator) -> list[str]:
        return [label for label, generator in self._labels.items() if generator is source]
