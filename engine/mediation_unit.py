"""Mediation processes: ``aggregate`` and ``select`` ([DyKnow10 Def. 4.7])."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
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
    which inputs came and went, ``on_news`` that there is something to settle. With ``select`` only
    the object named last in a set is in it.

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
        on_news: Callable[[MediationUnit], None],
    ) -> None:
        super().__init__(*args)
        self._members = self.inputs[0]
        self._kernel = kernel
        self._select = select
        self._stream_of = stream_of
        self._on_inputs = on_inputs
        self._on_news = on_news
        self._labels: dict[str, StreamGenerator] = {}
        self._read_by: dict[StreamGenerator, list[str]] = {}
        self._is_news = False
        self._seen = kernel.wanted
        self.unmet: tuple[str, ...] = ()
        """Objects in the set whose stream is not there."""

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        if source is self._members:
            sets = sets_of(batch)
            if self._select:
                sets = [labels[-1:] for labels in sets]
            self._kernel.push_members(batch.available.tolist(), sets)
            self._is_news = True
        for label in self._read_by.get(source, ()):
            self._kernel.push(label, batch)
        self._on_news(self)

    def progress(self, source: StreamGenerator, watermark: int) -> None:
        if source is self._members:
            self._kernel.advance_members(watermark)
        for label in self._read_by.get(source, ()):
            self._kernel.advance(label, watermark)
        self._on_news(self)

    def finish(self, source: StreamGenerator) -> None:
        if source is self._members:
            self._kernel.end_members()
        for label in self._read_by.get(source, ()):
            self._kernel.end(label)
        self._on_news(self)

    @property
    def may_find(self) -> bool:
        """Whether a stream that comes to be there may be one that it needs."""
        return bool(self.unmet or self._ended)

    def look_again(self) -> None:
        """Streams came or went: with the next `settle` it looks for those of its objects."""
        self._is_news = True
        self._on_news(self)

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
        missing: Iterable[str] = self.unmet
        if self._is_news:
            self._is_news = False
            self._leave_replaced()
            missing = self._kernel.wanted.difference(self._labels)
        found = {label: self._stream_of(label) for label in sorted(missing)}
        self.unmet = tuple(label for label, generator in found.items() if generator is None)
        gained = {label: stream for label, stream in found.items() if stream is not None}
        if not gained:
            return False
        self.inputs += tuple(gained.values())
        self.sources = tuple(dict.fromkeys(self.inputs))
        self._on_inputs(self, tuple(gained.values()), ())
        for label, generator in gained.items():
            self._read(label, generator)
        return True

    def _leave_replaced(self) -> None:
        """Leave streams that have ended where objects have others by now."""
        for generator in [ended for ended in self._ended if ended in self._read_by]:
            for label in list(self._read_by[generator]):
                if self._stream_of(label) not in (None, generator):
                    self._on_inputs(self, (), (self._leave(label),))

    def _leave(self, label: str) -> StreamGenerator:
        generator = self._labels.pop(label)
        self._read_by[generator].remove(label)
        inputs = list(self.inputs)
        inputs.remove(generator)
        self.inputs = tuple(inputs)
        if generator not in inputs:
            del self._read_by[generator]
            self._subscribed.remove(generator)
            generator.unsubscribe(self)
            self._watermarks.pop(generator, None)
            self._ended.discard(generator)
        self.sources = tuple(dict.fromkeys(inputs))
        return generator

    def _read(self, label: str, generator: StreamGenerator) -> None:
        """Begin to read the stream of an object with what it keeps."""
        self._labels[label] = generator
        self._kernel.attach(label)
        for segment in generator.stream.since(0):
            self._kernel.push(label, segment.batch)
        if generator.watermark is not None:
            self._kernel.advance(label, generator.watermark)
        if generator.is_ended:
            self._kernel.end(label)
        self._read_by.setdefault(generator, []).append(label)
        if generator not in self._subscribed:
            self.connect(generator)

    def _disconnect(self) -> bool:
        if self._kernel.wanted is self._seen:
            return False
        self._seen = self._kernel.wanted
        lost = [self._leave(label) for label in sorted(self._labels.keys() - self._kernel.wanted)]
        if lost:
            self._on_inputs(self, (), lost)
        return bool(lost)
