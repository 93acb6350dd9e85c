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
    """The samples of a life of an object's stream that is over, adapted by the policy. ``life`` is
    the unadapted stream, which identifies the life. No sample is available later than ``until``
    (ns)."""

    life: StreamGenerator
    batches: Sequence[SampleBatch]
    until: int


class MediationUnit(ComputationalUnit):
    """Merges the streams of the objects that its first input names.

    ``feature`` is the feature of the objects' streams. ``stream_of`` returns the stream of an
    object, or None while there is none. ``past_of`` returns the earlier lives of an object with
    samples later than a time (ns). Future lives have no samples available by ``promised()``.
    ``unadapted`` returns the stream before a policy: it knows when the life is over (`ends_at`),
    and whether another one replaces its samples (`is_void`). ``on_inputs`` is called with the
    gained and lost inputs, ``on_news`` when there is something to settle. With ``select`` a set
    contains only its last object.

    Methods that receive samples only note them. `connect_inputs` follows the sets while other
    processes make and remove streams; `pass_on` emits when they are done. The output therefore does
    not depend on which process receives a set first. A sample that does not name objects in a known
    form is counted, reported by ``on_event`` and ignored.
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
        unadapted: Callable[[StreamGenerator], StreamGenerator],
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
        self._unadapted = unadapted
        self._on_inputs = on_inputs
        self._on_news = on_news
        self._on_event = on_event
        self._labels: dict[str, StreamGenerator] = {}
        self._read_by: dict[StreamGenerator, list[str]] = {}
        self._must_connect = False
        self._wanted_before = kernel.wanted
        self.missing: tuple[str, ...] = ()
        """Objects in the set that have no stream."""

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
        self._must_connect = True

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
        until = self._unadapted(source).ends_at
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
        """The time (ns) up to which all samples have been passed on."""
        return self._kernel.done

    @property
    def may_find(self) -> bool:
        """Whether an added stream may be one of its inputs."""
        return bool(self.missing or self._ended)

    def look_again(self) -> None:
        """Let the next `connect_inputs` look for the streams of all objects, since streams were
        added or removed."""
        self._must_connect = True
        self._on_news(self)

    def connect_inputs(self) -> None:
        """Subscribe to the streams of new objects. `pass_on` emits their retained samples."""
        self._guarded(self._connect)

    def pass_on(self) -> None:
        """Emit the decided samples, and leave the streams of objects that have left the set."""
        self._guarded(self._pass_on)

    def _pass_on(self) -> None:
        self._kernel.promised = self._promised()
        batch = self._kernel.take()
        if batch is not None:
            self.output.emit(batch)
        self._disconnect()
        self.output.advance(self._kernel.reached + 1)
        if self._kernel.has_ended and not self.output.is_ended:
            self.output.end()

    def _connect(self) -> None:
        missing: Iterable[str] = self.missing
        if self._must_connect:
            self._must_connect = False
            self._leave_replaced()
            missing = self._kernel.wanted.difference(self._labels)
        for label in missing:
            self._read_past(label)
        # The order of a set may differ at replay, and `_stream_of` starts units.
        found = {label: self._stream_of(label) for label in sorted(missing)}
        self.missing = tuple(label for label, generator in found.items() if generator is None)
        gained = {label: stream for label, stream in found.items() if stream is not None}
        if not gained:
            return
        self.inputs += tuple(gained.values())
        self.sources = tuple(dict.fromkeys(self.inputs))
        self._on_inputs(self, tuple(gained.values()), ())
        for label, generator in gained.items():
            self._read(label, generator)

    def _leave_replaced(self) -> None:
        """Leave streams that have ended, if their object has another one or if they are void."""
        # In the order of the inputs, since that of a Python set may differ at replay.
        for generator in [s for s in self.sources if s in self._ended and s in self._read_by]:
            is_void = self._unadapted(generator).is_void
            for label in list(self._read_by[generator]):
                current = self._stream_of(label)
                if current is generator or (current is None and not is_void):
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
        """Read the samples of an object's lives that were over before this unit wanted it."""
        for past in self._past_of(label, self.done):
            if past.life in self._lives[label]:
                continue
            self._note_life(label, past.life)
            self._kernel.attach(label)
            for batch in past.batches:
                self._kernel.push(label, batch)
            self._kernel.end_at(label, past.until)

    def _read(self, label: str, generator: StreamGenerator) -> None:
        """Subscribe to the stream of an object, and read its retained samples."""
        self._labels[label] = generator
        self._note_life(label, self._unadapted(generator))
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
        """Note that a life was read, so that it is read once. Forget lives that are over and passed
        on."""
        read = {one for one in self._lives[label] if one.ends_at is None or one.ends_at > self.done}
        self._lives[label] = read | {life}

    def _disconnect(self) -> None:
        if self._kernel.wanted is self._wanted_before:
            return
        self._wanted_before = self._kernel.wanted
        for label in self._lives.keys() - self._kernel.wanted:
            del self._lives[label]  # if the object returns, its lives are read again
        lost = [self._leave(label) for label in sorted(self._labels.keys() - self._kernel.wanted)]
        if lost:
            self._on_inputs(self, (), lost)
