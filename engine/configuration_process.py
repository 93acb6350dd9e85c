"""Configuration processes: ``foreach`` ([DyKnow10 Def. 4.6])."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..languages.kpl import ForeachDeclaration, GeneratorDeclaration, instantiate
from ..streams.generator import StreamGenerator
from ..streams.sample import SampleBatch
from ..streams.time import TIME_MIN
from .object_sets import sets_of
from .supervision import ErrorCounters, ProcessEvent, describe


@dataclass(frozen=True, slots=True)
class _Instance:
    """A generator of one object; it sees what is available after ``after`` (ns)."""

    declaration: GeneratorDeclaration
    after: int


class ConfigurationProcess:
    """Keeps the generators of a ``foreach`` equal to the set of objects that its input names.

    What it makes for an object sees the samples that become available from the moment of the set
    on, and is gone when the set does not name the object any more. ``start`` makes a generator, or
    says why it cannot; it is tried again when `review` says that streams came or went. ``stop``
    takes one away.

    What comes is only noted; `settle` acts on it, set by set. A sample that names objects in no
    way that is known is counted, told and left out.
    """

    def __init__(
        self,
        name: str,
        declaration: ForeachDeclaration,
        members: StreamGenerator,
        *,
        start: Callable[[GeneratorDeclaration, int], str | None],
        stop: Callable[[GeneratorDeclaration], None],
        is_there: Callable[[GeneratorDeclaration], bool],
        on_event: Callable[[ConfigurationProcess, ProcessEvent, str], None],
        on_news: Callable[[ConfigurationProcess], None],
    ) -> None:
        self.name = name
        self.declaration = declaration
        self.inputs = (members,)
        self.counters = ErrorCounters()
        self.failure: str | None = None
        self._start = start
        self._stop = stop
        self._is_there = is_there
        self._on_event = on_event
        self._on_news = on_news
        self._pending: list[tuple[int, tuple[str, ...]]] = []
        self._instances: dict[str, tuple[_Instance, ...]] = {}
        self._running: dict[str, _Instance] = {}
        self._waiting: dict[str, tuple[_Instance, str]] = {}
        self._is_subscribed = False

    @property
    def objects(self) -> tuple[str, ...]:
        """The objects that there are generators for."""
        return tuple(self._instances)

    @property
    def waiting(self) -> dict[str, str]:
        """Labels that could not be made, and why."""
        return {key: reason for key, (_, reason) in self._waiting.items()}

    def begin(self) -> None:
        """Subscribe to the sets; the one that holds now is the beginning."""
        (members,) = self.inputs
        newest = members.stream.newest(1)
        if len(newest):
            self.receive(members, newest)
        members.subscribe(self)
        self._is_subscribed = True

    def stop(self) -> None:
        """Leave the sets, and take away what was made."""
        if self._is_subscribed:
            self.inputs[0].unsubscribe(self)
            self._is_subscribed = False
        for object in list(self._instances):
            self._remove(object)

    def receive(self, source: StreamGenerator, batch: SampleBatch) -> None:
        """Samples of the sets."""
        try:
            self._pending += zip(batch.available.tolist(), sets_of(batch), strict=True)
        except ValueError as error:
            if len(batch) > 1:  # the others are good
                for row in range(len(batch)):
                    self.receive(source, batch.take(slice(row, row + 1)))
                return
            self.counters.note(describe(error), int(batch.available[0]))
            self._on_event(self, ProcessEvent.FAILED, str(error))
        self._on_news(self)

    def advance(self, source: StreamGenerator, watermark: int) -> None:
        """Sets count when they come."""

    def ended(self, source: StreamGenerator) -> None:
        """The last set stays."""

    def settle(self) -> bool:
        """Make and take away what the sets since the last time ask for; tells whether any did."""
        pending, self._pending = self._pending, []
        for time, labels in pending:
            for object in [known for known in self._instances if known not in labels]:
                self._remove(object)
            for object in labels:
                if object not in self._instances:
                    self._add(object, max(time, TIME_MIN + 1) - 1)
        return bool(pending)

    def review(self) -> bool:
        """Streams came or went: make what could not be made, stop what lost its inputs."""
        acted = False
        for key, instance in list(self._running.items()):
            if not self._is_there(instance.declaration):
                self._stop(instance.declaration)
                del self._running[key]
                self._waiting[key] = (instance, "")
                acted = True
        for instance, _ in list(self._waiting.values()):
            acted = self._try(instance) or acted
        return acted

    def _add(self, object: str, after: int) -> None:
        made = instantiate(self.declaration, object)
        self._instances[object] = tuple(_Instance(declaration, after) for declaration in made)
        for instance in self._instances[object]:
            self._try(instance)

    def _remove(self, object: str) -> None:
        for instance in reversed(self._instances.pop(object)):
            key = instance.declaration.key
            if self._running.pop(key, None) is not None:
                self._stop(instance.declaration)
            self._waiting.pop(key, None)

    def _try(self, instance: _Instance) -> bool:
        key = instance.declaration.key
        reason = self._start(instance.declaration, instance.after)
        if reason is not None:
            self._waiting[key] = (instance, reason)
            return False
        self._waiting.pop(key, None)
        self._running[key] = instance
        return True
