"""What an adaptive subscription reads when, and what its client receives, by definition
(SPEC §7, [Introspection15 §4.4]): plain Python over the events of one history, nothing remembered
that could be looked up.

A *source* is a stream that is there, says that it holds the feature, and is known to be as good as
it is. It is *usable* when it has not ended and is not silent. The subscription reads the best
usable source; what is lost is replaced at once, what is better only when it has been there for its
hold-off and goes on speaking; where nothing is usable it goes on with what it reads as long as
that means the same, or takes what might speak again, or waits.
"""

import itertools
from dataclasses import dataclass, field

SECOND = 10**9
FAST, QUALITY = "fast", "quality"
LONG_AGO = -(2**63)


def patience(arrivals):
    """Five times the usual gap, which is an exponentially weighted mean, at least a second; None
    before five gaps."""
    times = sorted(set(arrivals))
    gaps = [after - before for before, after in itertools.pairwise(times)]
    if len(gaps) < 5:
        return None
    usual = float(gaps[0])
    for gap in gaps[1:]:
        usual += 0.2 * (gap - usual)
    return max(SECOND, int(5 * usual))


@dataclass
class Source:
    """One stream: its samples as (available, value), when they came, and what is said of it."""

    place: int
    factor: float | None = None
    """What makes its values the feature's; None: it holds something else."""
    quality: float = 1.0
    ended: bool = False
    has_left: bool = False
    """It has ended, and no sample has come since; a late one resumes it without being one."""
    samples: list[tuple[int, float]] = field(default_factory=list)
    arrivals: list[int] = field(default_factory=list)

    def silent_at(self, staleness, unless=None):
        """From when on it is silent; None: nobody knows. Before it spoke: since ``unless``."""
        last = max(self.arrivals, default=unless)
        allowed = patience(self.arrivals) if staleness is None else staleness
        return None if last is None or allowed is None else last + allowed

    def is_silent(self, now, staleness, unless=None):
        silent_at = self.silent_at(staleness, unless)
        return silent_at is not None and silent_at <= now


@dataclass
class Subscription:
    """The definition at work: call what happens, in order. ``from_start`` is since=start."""

    strategy: str
    bound: float
    staleness: int | None
    hold_off: int
    from_start: bool
    now: int = 0
    sources: dict[str, Source] = field(default_factory=dict)
    reading: str | None = None
    factor: float | None = None
    state: str = "waiting"
    received: list[float] = field(default_factory=list)
    path: list[tuple[int, str | None]] = field(default_factory=list)
    """When what was read, one after another."""
    _since: dict[str, int] = field(default_factory=dict)
    """Since when what might be better is there."""
    _given_up: set[str] = field(default_factory=set)
    _begun_at: int = 0
    _begun_after: int = LONG_AGO
    _reached: int = LONG_AGO
    _begun: bool = False
    _places: int = 0
    _left: tuple[str, int] | None = None
    """What was read last and how many samples it had, while nothing else has begun in its stead:
    its next sample is known by its number, as its instant may go on.
    """

    # -- what happens ------------------------------------------------------------------------

    def add(self, name):
        self._places += 1
        self.sources[name] = Source(self._places)

    def subscribe(self):
        self._rematch()
        if not self.path:
            self.path.append((self.now, None))

    def tick(self, now):
        self.now = max(self.now, now)
        if self.reading is None or self.reading in self._given_up:
            return
        if self.sources[self.reading].is_silent(self.now, self.staleness, self._begun_at):
            self._given_up.add(self.reading)
            self._rematch()

    def publish(self, name, now, samples):
        """``samples`` are those that came into the stream: none of those that were late."""
        source = self.sources[name]
        was_gone = (
            not source.arrivals
            or source.has_left
            or name in self._given_up
            or source.is_silent(max(self.now, now), self.staleness)
        )
        self.overhear(name, now, samples)
        if not samples:
            return
        self._given_up.discard(name)
        if name == self.reading:
            # What comes in the very moment of a switch is kept by then, as it were.
            is_kept = self.now == self._begun_at
            self._deliver([s for s in samples if not is_kept or s[0] > self._begun_after])
            if self.state != "running":
                self._rematch()
        elif self._may_be_better(name):
            if self.state != "running":
                self._rematch()
                return
            if was_gone:
                self._since[name] = self.now
            if name in self._since and self.now - self._since[name] >= self.hold_off:
                del self._since[name]
                self._improve()

    def overhear(self, name, now, samples):
        """The same before there is a subscription."""
        self.now = max(self.now, now)
        source = self.sources[name]
        source.ended = False
        if samples:
            source.has_left = False
            source.samples += samples
            source.arrivals.append(self.now)

    def end(self, name):
        self.sources[name].ended = self.sources[name].has_left = True
        self._gone(name)

    def remove(self, name):
        removed = self.sources.pop(name)
        self._given_up.discard(name)
        if self.reading == name:
            self.sources[name] = removed
            self._rematch(without={name})
            del self.sources[name]
        if self._left is not None and self._left[0] == name:
            self._left = None
        self._since.pop(name, None)

    def annotate(self, name, factor):
        source = self.sources[name]
        source.factor = factor
        if name == self.reading:
            if factor != self.factor:
                self._rematch()
        elif self._may_be_better(name):
            self._appears(name)
        else:
            self._since.pop(name, None)

    def rate(self, name, quality):
        source = self.sources[name]
        before, source.quality = source.quality, quality
        if self.strategy != QUALITY and self.bound == 0:
            return
        if name == self.reading:
            has_fallen = self.strategy == QUALITY and quality < before
            if has_fallen or quality < self.bound or self.state != "running":
                self._rematch()
        elif self._may_be_better(name):
            self._appears(name)
        else:
            self._since.pop(name, None)

    # -- what follows ------------------------------------------------------------------------

    def _gone(self, name):
        self._since.pop(name, None)
        if name == self.reading:
            self._rematch()

    def _may_be_better(self, name):
        source = self.sources[name]
        if source.factor is None:
            return False
        if self.state != "running" or (self.strategy != QUALITY and self.bound == 0):
            return True
        if source.quality < self.bound:
            return False
        return self.strategy != QUALITY or source.quality > self.sources[self.reading].quality

    def _appears(self, name):
        if self.state != "running":
            self._rematch()
        else:
            self._since.setdefault(name, self.now)

    def _usable(self):
        return {
            name
            for name, source in self.sources.items()
            if source.factor is not None
            and not source.ended
            and name not in self._given_up
            and not source.is_silent(self.now, self.staleness)
        }

    def _best(self, names):
        if not names:
            return None
        good = {name for name in names if self.sources[name].quality >= self.bound}
        if self.strategy == FAST and good:
            return min(good, key=lambda name: self.sources[name].place)
        return max(names, key=lambda name: self.sources[name].quality)

    def _improve(self):
        chosen = self._best(self._usable() - self._since.keys())
        if chosen is None or chosen == self.reading:
            return
        better = self.sources[chosen].quality > self.sources[self.reading].quality
        if self.strategy == FAST or better:
            self._set_state(chosen)
            self._switch(chosen)

    def _rematch(self, without=frozenset()):
        chosen = self._best(self._usable() - without)
        if chosen is not None:
            self._set_state(chosen)
        elif self.reading is not None and not without and self._still_means():
            self.state = "stale"
            return
        else:
            holding = {name for name, s in self.sources.items() if s.factor is not None}
            chosen = self._best(holding - without)
            self.state = "waiting" if chosen is None else "stale"
        if chosen != self.reading or (chosen is not None and not self._still_means()):
            self._switch(chosen)

    def _still_means(self):
        return self.sources[self.reading].factor == self.factor

    def _set_state(self, chosen):
        self.state = "running" if self.sources[chosen].quality >= self.bound else "stale"

    def _switch(self, chosen):
        self.path.append((self.now, chosen))
        is_new = chosen != self.reading
        if is_new and self.reading is not None:
            self._left = self.reading, len(self.sources[self.reading].samples)
        self.reading = chosen
        if chosen is None:
            return
        source = self.sources[chosen]
        self.factor = source.factor
        self._since.pop(chosen, None)
        if not is_new:
            return
        self._begun_at = self.now
        if not self._begun and not self.from_start:
            # It begins with what comes: what there is already is behind it.
            self._reached = source.samples[-1][0] if source.samples else LONG_AGO
        self._begun = True
        self._begun_after = self._reached
        name, count = self._left or (None, 0)
        self._left = None
        if name == chosen:
            self._begun_after -= 1
            self._deliver(source.samples[count:])
        else:
            self._deliver([sample for sample in source.samples if sample[0] > self._reached])

    def _deliver(self, samples):
        for available, value in samples:
            self._reached = available
            self.received.append(value * self.factor)
