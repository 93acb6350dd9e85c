"""Published streams that have fallen silent, and those that have samples again (SPEC §7)."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from ...matching.space import StreamSpace
from ..model.arrivals import Arrivals
from .configuration import Configuration


class Silences:
    """The arrivals of samples by stream, and the streams that are silent.

    ``is_ours`` returns whether a plan makes a stream; such streams are never silent here, but their
    sources may be. Cost: O(1) an arrival; a pass over all streams for each time and staleness.
    Memory: some numbers for each stream.
    """

    def __init__(
        self, configuration: Configuration, space: StreamSpace, is_ours: Callable[[str], bool]
    ) -> None:
        self._configuration = configuration
        self._space = space
        self._is_ours = is_ours
        self._arrivals: dict[str, Arrivals] = {}
        self._used: dict[str, int] = {}
        """The number of used samples of each stream at the last `note_samples`."""
        self._passed_over: dict[str, int] = {}
        """Silent or ended streams that a subscription has left, until they have samples again, with
        their number of samples at that time."""
        self._cached_at = -1
        self._silent: dict[int | None, frozenset[str]] = {}
        """A cache for the time `_cached_at`: the silent streams by staleness."""

    def note_samples(self, stream: str) -> bool:
        """Return whether the stream has new samples since the last call. Late ones do not count."""
        self._silent.clear()  # even a late sample reopens an ended stream
        used = self._configuration.streams[stream].counters.used
        if used == self._used.get(stream, 0):
            return False
        self._used[stream] = used
        return True

    def note_arrival(self, stream: str, now: int) -> None:
        """Note that samples of a stream have arrived."""
        self._arrivals.setdefault(stream, Arrivals(now)).add(now)

    def note_end(self, stream: str) -> None:
        """Note that a stream has ended; it is silent from now on."""
        self._silent.clear()
        self.pass_over(stream)

    def refresh(self) -> None:
        """Drop the cache, since a stream was added or annotated."""
        self._silent.clear()

    def forget(self, stream: str) -> None:
        """Forget a removed stream: another one may get its name."""
        self._arrivals.pop(stream, None)
        self._used.pop(stream, None)
        self._passed_over.pop(stream, None)

    def has_arrivals(self, stream: str) -> bool:
        """Whether samples were ever published to it."""
        return stream in self._arrivals

    def is_new_or_silent(self, stream: str, now: int, staleness: int | None) -> bool:
        """Whether it is silent (see `Arrivals.silent_at`), or has had no samples yet."""
        return not self.has_arrivals(stream) or self._is_silent(stream, now, staleness)

    def silent_at(self, stream: str, staleness: int | None = None) -> int | None:
        """Return the time (ns) from which a stream is silent if nothing arrives; None: not known.
        See `Arrivals.silent_at`."""
        arrivals = self._arrivals.get(stream)
        return None if arrivals is None else arrivals.silent_at(staleness)

    def silent_streams(self, now: int, staleness: int | None) -> frozenset[str]:
        """Return the annotated streams that are silent or have ended at time ``now``."""
        if self._cached_at != now:
            self._cached_at = now
            self._silent.clear()
        found = self._silent.get(staleness)
        if found is None:
            streams = self._configuration.streams
            found = self._silent[staleness] = frozenset(
                name
                for name in self._space.streams
                if name in streams
                and not self._is_ours(name)
                and (streams[name].is_ended or self._is_silent(name, now, staleness))
            )
        return found

    def _is_silent(self, stream: str, now: int, staleness: int | None) -> bool:
        silent_at = self.silent_at(stream, staleness)
        return silent_at is not None and silent_at <= now

    # -- streams that have samples again -----------------------------------------------------

    def pass_over(self, stream: str) -> None:
        """Note that a subscription leaves a stream until it has samples again."""
        if stream not in self._passed_over and stream in self._configuration.streams:
            self._passed_over[stream] = self._configuration.streams[stream].counters.used

    def take_back(self, stream: str) -> bool:
        """Forget that a stream with new samples was passed over; return whether it was."""
        if stream not in self._passed_over:
            return False
        del self._passed_over[stream]
        self._silent.clear()
        return True

    def take_all_back(self) -> Iterator[str]:
        """Do `take_back` for each stream with samples since it was passed over, and return these.
        Cost: O(streams that were passed over)."""
        streams = self._configuration.streams
        for name, used in list(self._passed_over.items()):
            if name in streams and streams[name].counters.used != used and self.take_back(name):
                yield name
