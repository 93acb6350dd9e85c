"""Configuration processes: ``foreach`` ([DyKnow10 Def. 4.6])."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

from ...languages.kpl import ForeachDeclaration, GeneratorDeclaration, instantiate
from ...streams.generator import StreamGenerator
from ...streams.input_queues import NOTHING_KNOWN
from ...streams.sample import SampleBatch
from ...streams.time import TIME_MAX, TIME_MIN
from ..model.object_sets import sets_of
from ..processes.supervision import ErrorCounters, ProcessEvent


@dataclass(slots=True, eq=False)
class _Life:
    """A generator of one object; it sees what is available after ``after`` and up to ``until``
    (ns; None: it goes on). ``end`` is what ``until`` will be, where a set is known already that
    leaves the object out. ``reason`` says why it is not there. ``mates`` are those made for the
    object at the same moment, itself among them."""

    declaration: GeneratorDeclaration
    after: int
    mates: tuple[_Life, ...] = ()
    until: int | None = None
    end: int | None = None
    reason: str = ""

    @property
    def key(self) -> str:
        return self.declaration.key


class Generators(Protocol):
    """Whoever makes generators and takes them away."""

    def start(self, declaration: GeneratorDeclaration, after: int, until: int | None) -> str | None:
        """Make one that sees what is available after ``after`` and up to ``until`` (None: it goes
        on), or say why that cannot be."""

    def has_seen(self, declaration: GeneratorDeclaration) -> int:
        """The available time of the latest sample that it has seen."""

    def void(self, declaration: GeneratorDeclaration) -> None:
        """Take it away: it will be started anew, from its beginning."""

    def end(self, declaration: GeneratorDeclaration, until: int) -> None:
        """It is to see nothing that is available later than ``until``."""

    def is_over(self, declaration: GeneratorDeclaration) -> bool:
        """Whether it has seen all that it is to see."""

    def has_inputs(self, declaration: GeneratorDeclaration) -> bool:
        """Whether what it reads is there still."""

    def stop(self, declaration: GeneratorDeclaration) -> None:
        """Take it away."""


class ConfigurationProcess:
    """Keeps the generators of a ``foreach`` equal to the set of objects that its input names.

    What it makes for an object sees the samples that are available from the moment of the set on,
    until that of the first set without the object; when all its inputs have got so far, it is
    gone. A generator that cannot be made is tried again when `review` says that streams came or
    went.

    What comes is only noted; `step` acts on it, one set at a time, and `reap` takes away what is
    over. A sample that names objects in no way that is known is counted, told and left out.
    """

    transformation: Final = "foreach"
    knows_codes: Final = False

    def __init__(
        self,
        name: str,
        declaration: ForeachDeclaration,
        members: StreamGenerator,
        generators: Generators,
        *,
        on_event: Callable[[ConfigurationProcess, ProcessEvent, str], None],
        on_news: Callable[[ConfigurationProcess], None],
    ) -> None:
        self.name = name
        self.declaration = declaration
        self.inputs = (members,)
        made = declaration.generators
        self.makes = frozenset(each.label.feature for each in made)
        """The features whose generators are its own."""
        self.reads = frozenset(term.label.feature for each in made for term in each.terms)
        """The features that these read."""
        self.counters = ErrorCounters()
        self.failure: str | None = None
        self._generators = generators
        self._on_event = on_event
        self._on_news = on_news
        self._pending: deque[tuple[int, tuple[str, ...]]] = deque()
        self._lives: dict[str, tuple[_Life, ...]] = {}
        self._running: dict[str, _Life] = {}
        self._waiting: list[_Life] = []
        self._leaving: dict[str, _Life] = {}
        self._is_subscribed = False
        self.known = NOTHING_KNOWN
        """All sets that are available by then have come; TIME_MAX at their end."""

    @property
    def objects(self) -> tuple[str, ...]:
        """The objects that there are generators for."""
        return tuple(self._lives)

    @property
    def waiting(self) -> dict[str, str]:
        """Labels that could not be made, and why."""
        return {life.key: life.reason for life in self._waiting}

    @property
    def leaving(self) -> tuple[str, ...]:
        """Labels of objects that have left, whose inputs have not got so far."""
        return tuple(self._leaving)

    def begin(self) -> None:
        """Subscribe to the sets, with those that are kept."""
        (members,) = self.inputs
        for segment in members.stream.since(0):
            self.receive(members, segment.batch)
        members.subscribe(self)
        self._is_subscribed = True
        if members.is_ended:
            self.ended(members)

    def stop(self) -> None:
        """Leave the sets, and take away what was made."""
        if self._is_subscribed:
            self.inputs[0].unsubscribe(self)
            self._is_subscribed = False
        for life in reversed([*self._leaving.values(), *self._running.values()]):
            self._generators.stop(life.declaration)
        self._pending.clear()
        self._lives.clear()
        self._running.clear()
        self._waiting.clear()
        self._leaving.clear()

    def receive(self, source: StreamGenerator, batch: SampleBatch) -> None:
        """Samples of the sets."""
        self.known = max(self.known, source.promise_after(batch) - 1)
        for time, labels in sets_of(batch):
            if isinstance(labels, str):
                self.counters.note(labels, time)
                self._on_event(self, ProcessEvent.FAILED, labels)
            else:
                self._pending.append((time, labels))
        self._on_news(self)

    def advance(self, source: StreamGenerator, watermark: int) -> None:
        """Every later set is available at ``watermark`` or after it."""
        if not source.is_ended:
            self.known = max(self.known, watermark - 1)
            self._on_news(self)

    def ended(self, source: StreamGenerator) -> None:
        """The last set stays."""
        self.known = TIME_MAX
        self._on_news(self)

    def resumed(self, source: StreamGenerator) -> None:
        """Sets go on."""
        last = source.stream.last_available
        self.known = NOTHING_KNOWN if last is None else last - 1 + source.rules.gap

    def idleness_changed(self, source: StreamGenerator) -> None:
        """It reads nothing else that could go on meanwhile."""

    @property
    def promised(self) -> int:
        """What it is still to make says nothing that is available by then (ns)."""
        promised = self._pending[0][0] - 1 if self._pending else self.known
        if not self._leaving:
            return promised
        # Lives whose turn comes when an earlier one of the object has gone.
        turns = [
            life.after
            for life in self._waiting
            if any(self._leaving.get(mate.key) not in (None, mate) for mate in life.mates)
        ]
        return min(promised, *turns) if turns else promised

    def step(self) -> bool:
        """Act on the next set that changes anything; tells whether there was one."""
        while self._pending:
            time, labels = self._pending.popleft()
            gone = [known for known in self._lives if known not in labels]
            new = [label for label in labels if label not in self._lives]
            until = max(time, TIME_MIN + 1) - 1
            for object in gone:
                self._end(object, until)
            for object in new:
                made = instantiate(self.declaration, object)
                mates = tuple(_Life(declaration, until) for declaration in made)
                for life in mates:
                    life.mates = mates
                self._lives[object] = mates
                ahead = (at for at, later in self._pending if object not in later)
                end = next(ahead, None)
                for life in self._lives[object]:
                    life.end = None if end is None else end - 1
                    self._try(life)
            if gone or new:
                return True
        return False

    def reap(self) -> bool:
        """Take away what is over; tells whether anything was.

        Generators that were made together go together: they read each other, and a later life of
        one would pass by another that is still in its first.
        """
        ready = {
            life.key
            for life in self._leaving.values()
            if self._generators.is_over(life.declaration)
        }
        over = [
            life
            for life in self._leaving.values()
            if all(m.key in ready or self._leaving.get(m.key) is not m for m in life.mates)
        ]
        for life in reversed(over):
            del self._leaving[life.key]
            self._generators.stop(life.declaration)
        return bool(over)

    def review(self) -> bool:
        """Streams came or went: make what could not be made, stop what lost its inputs."""
        acted = False
        for life in list(self._running.values()):
            if not self._generators.has_inputs(life.declaration):
                self._generators.stop(life.declaration)
                del self._running[life.key]
                self._waiting.append(life)
                acted = True
        for life in list(self._waiting):
            acted = self._try(life) or acted
        return acted

    def _end(self, object: str, until: int) -> None:
        lives = self._lives.pop(object)
        # Its turn comes when what is there of an earlier life has gone.
        has_earlier = any(
            life.key in self._leaving
            or any(other.key == life.key and other is not life for other in self._waiting)
            for life in lives
        )
        running = []
        for life in lives:
            life.until = life.end = until
            if self._running.pop(life.key, None) is not None:
                running.append(life)
            elif not has_earlier:
                self._waiting.remove(life)
        if all(self._generators.has_seen(life.declaration) <= until for life in running):
            for life in running:
                self._generators.end(life.declaration, until)
                self._leaving[life.key] = life
            return
        # The set came after samples that it cuts off: what they have done is undone.
        for life in reversed(running):
            self._generators.void(life.declaration)
        for life in running:
            self._try(life)

    def _try(self, life: _Life) -> bool:
        """Make a generator if that can be; one whose time is over already sees it all at once."""
        reason = self._generators.start(life.declaration, life.after, life.end)
        if reason is not None:
            life.reason = reason
            if life not in self._waiting:
                self._waiting.append(life)
            return False
        if life in self._waiting:
            self._waiting.remove(life)
        if life.until is None:
            self._running[life.key] = life
        else:
            self._leaving[life.key] = life
        return True
