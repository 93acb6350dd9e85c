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
from ..model.object_sets import read_sets
from ..processes.supervision import ErrorCounters, ProcessEvent


@dataclass(slots=True, eq=False)
class _Life:
    """One life of an object's generator: from a set that has the object to the first one without.

    It sees the samples available after ``after`` and up to ``until`` (ns; None: it goes on).
    ``end`` is the later ``until``, if a set without the object has arrived already. ``reason`` is
    why the generator could not be made. ``mates`` are the lives that began for the object at the
    same time, itself included.
    """

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
    """Makes and removes generators (`KplApplication`)."""

    def start(self, declaration: GeneratorDeclaration, after: int, until: int | None) -> str | None:
        """Make a generator that sees the samples available after ``after`` and up to ``until``
        (None: it goes on), or return why that is impossible."""

    def last_processed(self, declaration: GeneratorDeclaration) -> int:
        """Return the greatest available time that the generator has processed."""

    def void(self, declaration: GeneratorDeclaration) -> None:
        """Remove the generator with its results; it will start again from its beginning."""

    def end(self, declaration: GeneratorDeclaration, until: int) -> None:
        """Let the generator ignore samples that are available later than ``until``."""

    def is_over(self, declaration: GeneratorDeclaration) -> bool:
        """Whether the generator has processed all samples up to its end."""

    def has_inputs(self, declaration: GeneratorDeclaration) -> bool:
        """Whether the inputs of the generator still exist."""

    def stop(self, declaration: GeneratorDeclaration) -> None:
        """Remove the generator."""


class ConfigurationProcess:
    """Keeps the generators of a ``foreach`` equal to the set of objects that its input names.

    A generator sees the samples available from the time of the set with its object until the first
    set without. It is removed when all its inputs have reached that time. If a generator cannot be
    made, `review` tries again when streams were added or removed.

    Methods that receive samples only note the sets. `step` acts on them, one set at a time, and
    `reap` removes the generators that are over. A sample that does not name objects in a known form
    is counted, reported and ignored.
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
        generators_declared = declaration.generators
        self.makes = frozenset(each.label.feature for each in generators_declared)
        """The features of its generators."""
        self.reads = frozenset(
            term.label.feature for each in generators_declared for term in each.terms
        )
        """The features that its generators read."""
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
        self.complete_until = NOTHING_KNOWN
        """All sets that are available by then (ns) have arrived; TIME_MAX at their end."""

    @property
    def objects(self) -> tuple[str, ...]:
        """The objects in the present set."""
        return tuple(self._lives)

    @property
    def waiting(self) -> dict[str, str]:
        """The generators that could not be made, by label, with the reasons."""
        return {life.key: life.reason for life in self._waiting}

    @property
    def leaving(self) -> tuple[str, ...]:
        """Labels of generators whose object has left, until their inputs reach that time."""
        return tuple(self._leaving)

    def begin(self) -> None:
        """Subscribe to the sets, and note the retained ones."""
        (members,) = self.inputs
        for segment in members.stream.since(0):
            self.receive(members, segment.batch)
        members.subscribe(self)
        self._is_subscribed = True
        if members.is_ended:
            self.ended(members)

    def stop(self) -> None:
        """Unsubscribe from the sets, and remove all generators."""
        if self._is_subscribed:
            self.inputs[0].unsubscribe(self)
            self._is_subscribed = False
        # Generators start after those that they read, so the reversed order stops readers first.
        for life in reversed([*self._leaving.values(), *self._running.values()]):
            self._generators.stop(life.declaration)
        self._pending.clear()
        self._lives.clear()
        self._running.clear()
        self._waiting.clear()
        self._leaving.clear()

    def receive(self, source: StreamGenerator, batch: SampleBatch) -> None:
        """Note the sets of a batch."""
        self.complete_until = max(self.complete_until, source.promise_after(batch) - 1)
        for time, labels in read_sets(batch):
            if isinstance(labels, str):
                self.counters.note(labels, time)
                self._on_event(self, ProcessEvent.FAILED, labels)
            else:
                self._pending.append((time, labels))
        self._on_news(self)

    def advance(self, source: StreamGenerator, watermark: int) -> None:
        """Note that no further set is available before ``watermark``."""
        if not source.is_ended:
            self.complete_until = max(self.complete_until, watermark - 1)
            self._on_news(self)

    def ended(self, source: StreamGenerator) -> None:
        """Keep the last set for good."""
        self.complete_until = TIME_MAX
        self._on_news(self)

    def resumed(self, source: StreamGenerator) -> None:
        """Wait for sets again."""
        last = source.stream.last_available
        # Without a gap between samples, further sets of the last instant may come.
        self.complete_until = NOTHING_KNOWN if last is None else last - 1 + source.rules.gap

    def idleness_changed(self, source: StreamGenerator) -> None:
        """Do nothing, since it has no other input that could go on."""

    @property
    def promised(self) -> int:
        """The time (ns) up to which generators that it is still to make have no samples."""
        promised = self._pending[0][0] - 1 if self._pending else self.complete_until
        if not self._leaving:
            return promised
        # A later life of an object begins only when the earlier one has been removed.
        turns = [
            life.after
            for life in self._waiting
            if any(self._leaving.get(mate.key) not in (None, mate) for mate in life.mates)
        ]
        return min(promised, *turns) if turns else promised

    def step(self) -> bool:
        """Act on the next set that changes anything; return whether there was one."""
        while self._pending:
            time, labels = self._pending.popleft()
            lost = [object for object in self._lives if object not in labels]
            gained = [label for label in labels if label not in self._lives]
            until = max(time, TIME_MIN + 1) - 1
            for object in lost:
                self._end_lives(object, until)
            for object in gained:
                declarations = instantiate(self.declaration, object)
                mates = tuple(_Life(declaration, until) for declaration in declarations)
                for life in mates:
                    life.mates = mates
                self._lives[object] = mates
                end = next((at for at, later in self._pending if object not in later), None)
                for life in self._lives[object]:
                    life.end = None if end is None else end - 1
                    self._try_start(life)
            if lost or gained:
                return True
        return False

    def reap(self) -> bool:
        """Remove generators that are over; return whether there were any.

        Mates are removed together: they read each other, and a second life of one must not read
        the first life of another.
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
        """Stop generators without inputs and retry those that could not be made, after streams were
        added or removed; return whether anything changed."""
        has_changed = False
        for life in list(self._running.values()):
            if not self._generators.has_inputs(life.declaration):
                self._generators.stop(life.declaration)
                del self._running[life.key]
                self._waiting.append(life)
                has_changed = True
        for life in list(self._waiting):
            has_changed = self._try_start(life) or has_changed
        return has_changed

    def _end_lives(self, object: str, until: int) -> None:
        """End the present lives of an object that has left the set."""
        lives = self._lives.pop(object)
        # With an earlier life of the object still there, these lives wait for it to be removed.
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
        if all(self._generators.last_processed(life.declaration) <= until for life in running):
            for life in running:
                self._generators.end(life.declaration, until)
                self._leaving[life.key] = life
            return
        # The set arrived after samples that it excludes. Their results are wrong, so start again.
        for life in reversed(running):
            self._generators.void(life.declaration)
        for life in running:
            self._try_start(life)

    def _try_start(self, life: _Life) -> bool:
        """Make a life's generator if possible; return whether. One whose end is known already reads
        all its retained samples at once."""
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
