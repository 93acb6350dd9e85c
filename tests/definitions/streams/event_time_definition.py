"""Event time word for word (docs/explanation/semantics.md): sample by sample, with no thought of
speed.

Available times are small integers; a sample is ``(available, number)``.
"""

START = -(10**9)


class Stream:
    """A declared stream whose samples bring their own available times, and what the clock does."""

    def __init__(self, lateness, idle, readers):
        self.lateness, self.idle, self.readers = lateness, idle, readers
        self.pending, self.taken = [], []
        self.greatest = self.watermark = None
        self.late = []
        self.is_ended = self.is_idle = False
        self.spoke = 0

    def offer(self, samples, now):
        """Several samples at once are as one after the other."""
        if samples:
            self.spoke = now
            self.is_ended = self.is_idle = False
        for sample in samples:
            self._offer(sample)

    def _offer(self, sample):
        available, number = sample
        limit = START if self.greatest is None else self.greatest - self.lateness
        if self.watermark is not None:
            limit = max(limit, self.watermark)
        if available < limit:
            # It came when the stream had got so far.
            note_late(self.late, max(self.greatest, self.watermark), number)
        elif sample not in [*self.pending, *self.taken]:
            self.pending.append(sample)
            self.greatest = available if self.greatest is None else max(self.greatest, available)
            self.release(self.greatest - self.lateness)

    def release(self, until):
        """Nothing can be overtaken any more that is available by then."""
        due = [sample for sample in self.pending if sample[0] <= until]
        due.sort(key=lambda sample: sample[0])  # those of an instant stay as they came
        self.pending = [sample for sample in self.pending if sample[0] > until]
        self.taken += due
        for reader in self.readers:
            for sample in due:
                reader.take(self, sample)
        self.watermark = until if self.watermark is None else max(self.watermark, until)
        for reader in self.readers:
            reader.reach(self, self.watermark)

    def end(self):
        if self.pending:
            self.release(self.greatest)
        self.is_ended, self.is_idle = True, False

    def tick(self, now):
        if self.idle is None or self.is_ended or self.is_idle or now - self.spoke < self.idle:
            return
        if self.greatest is not None:
            self.release(self.greatest)
        self.is_idle = True


class Reader:
    """A query of several streams with a window ``(end - range, end]`` at each multiple of step."""

    def __init__(self, range, step):
        self.range, self.step = range, step
        self.streams = ()
        self.known = {}
        self.elements = []
        self.seen = START
        self.closed = START
        self.results = []
        self.late = {}

    def take(self, stream, sample):
        available, number = sample
        due = max(self.known.get(stream, START), self.closed + 1)
        if available < due:
            note_late(self.late.setdefault(stream, []), max(self.seen, due), number)
        else:
            self.elements.append(sample)
            self.seen = max(self.seen, available)

    def reach(self, stream, watermark):
        self.known[stream] = max(watermark, self.known.get(stream, START))

    def settle(self):
        """Idle streams hold nobody back; what is before the least watermark is over."""
        going_on = [stream for stream in self.streams if not stream.is_ended]
        active = [stream for stream in going_on if not stream.is_idle]
        if active:
            places = [self.known.get(stream) for stream in active]
            place = None if None in places else min(places)
        else:
            place = max(self.known.values(), default=None)
        if place is not None:
            for stream in going_on:
                if stream.is_idle:
                    self.reach(stream, place)
        places = [self.known.get(stream) for stream in going_on]
        if None not in places:
            self._close(min(places, default=None))

    def _close(self, watermark):
        last = max((available for available, _ in self.elements), default=START)
        stop = last + self.range if watermark is None else min(watermark, last + self.range + 1)
        first = min((available for available, _ in self.elements), default=last)
        end = max(first, self.closed + 1) // self.step * self.step
        while end <= stop if watermark is None else end < stop:
            content = [n for available, n in self.elements if end - self.range < available <= end]
            if end > self.closed and content:
                self.results.append((end, sorted(content)))
                self.closed = end
            end += self.step


def note_late(noted, came, number):
    """A late sample is available when it came, and not before the one before it."""
    noted.append((max(came, noted[-1][0]) if noted else came, number))
