"""Mediation processes: ``aggregate`` and ``select`` ([DyKnow10 Def. 4.7])."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from ...streams.generator import StreamGenerator
from ...streams.joins.mediation import Mediation
from ...streams.sample import SampleBatch
from ..model.object_sets import read_sets
from ..processes.supervision import ProcessEvent
from .base import ComputationalUnit

Inputs = Sequence[StreamGenerator]


@dataclass(frozen=True, slots=True, eq=False)
class Past:
    """The stream of an object's life that is over, as a policy has made it: ``life`` tells it from
    others, nothing in it is available later than ``until`` (ns)."""

    life: StreamGenerator
    batches: Sequence[SampleBatch]
    until: int


class MediationUnit(ComputationalUnit):
    """The streams of the objects that its first input names, as one.

    ``feature`` is what the objects' streams are of. ``stream_of`` gives the stream of an object, or
    None while there is none, ``past_of`` those that it had before and that say something later
    than a moment (ns); those to come say nothing that is available by ``promised()``. ``life_of``
    gives the stream of the object's life behind a policy: it knows when that life is over, and
    whether all is said anew by the one in its place. ``on_inputs`` hears which inputs came and
    went, ``on_news`` that there is something to settle. With ``select`` only the object named last
    in a set is in it.

    What comes is only noted. `connect_inputs` follows the sets while other processes make and
    remove streams; `pass_on` is for when they have done so. So what is passed on does not depend
    on who hears of a set first. A sample that names objects in no way that is known is counted,
    told by ``on_event`` and left out.
    """

    def __init__(
        self,
        *args: Any,
        kernel: Mediation,
        feature: str,
        select: bool,
        stream_of: Callable[[str], StreamGenerator | None],
        promised: Callable[[], int],
        past_of: Callable[[str, int], Sequence[Past]],
        life_of: Callable[[StreamGenerator], StreamGenerator],
        on_inputs: Callable[[MediationUnit, Inputs, Inputs], None],
        on_news: Callable[[MediationUnit], None],
        on_event: Callable[[ComputationalUnit, ProcessEvent, str], None],
    ) -> None:
        super().__init__(*args)
        self.feature = feature
        self._members = self.inputs[0]
        self._kernel = kernel
        self._select = select
        self._stream_of = stream_of
        self._promised = promised
        self._past_of = past_of
        self._lives: defaultdict[str, set[StreamGenerator]] = defaultdict(set)
        self._life_of = life_of
        self._on_inputs = on_inputs
        self._on_news = on_news
        self._on_event = on_event
        self._labels: dict[str, StreamGenerator] = {}
        self._read_by: dict[StreamGenerator, list[str]] = {}
        self._is_news = False
        self._seen = kernel.wanted
        self.unmet: tuple[str, ...] = ()
        """Objects in the set whose stream is not there."""

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        if source is self._members:
            self._note_sets(batch)
        for label in self._read_by.get(source, ()):
            self._kernel.push(label, batch)
            self._kernel.advance(label, source.promise_after(batch))
        self._on_news(self)

    def _note_sets(self, batch: SampleBatch) -> None:
        times, sets = [], []
        for time, labels in read_sets(batch):
            if isinstance(labels, str):
                self.counters.note(labels, time)
                self._on_event(self, ProcessEvent.FAILED, labels)
                continue
            times.append(time)
            sets.append(labels[-1:] if self._select else labels)
        self._kernel.push_members(times, sets)
        if times:
            self._kernel.advance_members(times[-1] + self.output.rules.gap)
        self._is_news = True

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
            self._end(label, source)
        self._on_news(self)

    def _end(self, label: str, source: StreamGenerator) -> None:
        until = self._life_of(source).ends_at
        if until is None:
            self._kernel.end(label)
        else:
            self._kernel.end_at(label, until)

    def resume(self, source: StreamGenerator) -> None:
        super().resume(source)
        if source is self._members:
            self._kernel.resume_members()
        for label in self._read_by.get(source, ()):
            self._kernel.resume(label)

    @property
    def done(self) -> int:
        """What was available by then has been passed on."""
        return self._kernel.done

    @property
    def may_find(self) -> bool:
        """Whether a stream that comes to be there may be one that it needs."""
        return bool(self.unmet or self._ended)

    def look_again(self) -> None:
        """Streams came or went: the next `connect_inputs` looks for those of its objects."""
        self._is_news = True
        self._on_news(self)

    def connect_inputs(self) -> None:
        """Take the streams of objects that came. What they keep waits for `pass_on`."""
        self._guarded(self._connect)

    def pass_on(self) -> None:
        """Send what is decided, and leave the streams of objects that went."""
        self._guarded(self._pass_on)

    def _pass_on(self) -> None:
        self._kernel.promised = self._promised()
        made = self._kernel.take()
        if made is not None:
            self.output.emit(made)
        self._disconnect()
        self.output.advance(self._kernel.reached + 1)
        if self._kernel.has_ended and not self.output.is_ended:
            self.output.end()

    def _connect(self) -> None:
        missing: Iterable[str] = self.unmet
        if self._is_news:
            self._is_news = False
            self._leave_replaced()
            missing = self._kernel.wanted.difference(self._labels)
        for label in missing:
            self._read_past(label)
        found = {label: self._stream_of(label) for label in sorted(missing)}
        self.unmet = tuple(label for label, generator in found.items() if generator is None)
        gained = {label: stream for label, stream in found.items() if stream is not None}
        if not gained:
            return
        self.inputs += tuple(gained.values())
        self.sources = tuple(dict.fromkeys(self.inputs))
        self._on_inputs(self, tuple(gained.values()), ())
        for label, generator in gained.items():
            self._read(label, generator)

    def _leave_replaced(self) -> None:
        """Leave streams that have ended where objects have others by now, and those that do not
        hold."""
        # In the order of the inputs: that of a set is another one when it is done again.
        for generator in [s for s in self.sources if s in self._ended and s in self._read_by]:
            is_void = self._life_of(generator).is_void
            for label in list(self._read_by[generator]):
                there = self._stream_of(label)
                if there is generator or (there is None and not is_void):
                    continue
                if is_void:
                    self._kernel.forget(label)
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

    def _read_past(self, label: str) -> None:
        """Take in what an object said in lives that were over before it was asked for."""
        for past in self._past_of(label, self.done):
            if past.life in self._lives[label]:
                continue
            self._note_life(label, past.life)
            self._kernel.attach(label)
            for batch in past.batches:
                self._kernel.push(label, batch)
            self._kernel.end_at(label, past.until)

    def _read(self, label: str, generator: StreamGenerator) -> None:
        """Begin to read the stream of an object with what it keeps."""
        self._labels[label] = generator
        self._note_life(label, self._life_of(generator))
        self._kernel.attach(label)
        for segment in generator.stream.since(0):
            self._kernel.push(label, segment.batch)
        if generator.watermark is not None:
            self._kernel.advance(label, generator.watermark)
        if generator.is_ended:
            self._end(label, generator)
        self._read_by.setdefault(generator, []).append(label)
        if generator not in self._subscribed:
            self.connect(generator)

    def _note_life(self, label: str, life: StreamGenerator) -> None:
        """A life is read once; those that all is passed on of are forgotten."""
        read = {one for one in self._lives[label] if one.ends_at is None or one.ends_at > self.done}
        self._lives[label] = read | {life}

    def _disconnect(self) -> None:
        if self._kernel.wanted is self._seen:
            return
        self._seen = self._kernel.wanted
        for label in self._lives.keys() - self._kernel.wanted:
            del self._lives[label]  # should the object come back, it is read anew
        lost = [self._leave(label) for label in sorted(self._labels.keys() - self._kernel.wanted)]
        if lost:
            self._on_inputs(self, (), lost)
