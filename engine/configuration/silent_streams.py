"""Which streams from outside are silent, and which of them speak again (SPEC §7)."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from ...matching.space import StreamSpace
from ..model.arrivals import Arrivals
from .configuration import Configuration


class Silences:
    """When samples were published to streams, and who has not spoken for too long since.

    ``is_ours`` says of a stream whether a plan makes it: such are not looked at. Cost: an arrival
    O(1); a look at all streams once for each moment and staleness. Memory: some numbers for each
    stream.
    """

    def __init__(
        self, configuration: Configuration, space: StreamSpace, is_ours: Callable[[str], bool]
    ) -> None:
        self._configuration = configuration
        self._space = space
        self._is_ours = is_ours
        self._arrivals: dict[str, Arrivals] = {}
        self._used: dict[str, int] = {}
        """How many samples of each stream there were when it was last looked."""
        self._gone: dict[str, int] = {}
        """Streams that were passed over as silent or ended, until they speak again, with how many
        samples they had then."""
        self._looked = -1
        self._silent: dict[int | None, frozenset[str]] = {}

    def has_news(self, stream: str) -> bool:
        """Whether samples have come since this was last asked: late ones are none."""
        self._silent.clear()  # an ended stream goes on with a late one, too
        used = self._configuration.streams[stream].counters.used
        if used == self._used.get(stream, 0):
            return False
        self._used[stream] = used
        return True

    def came(self, stream: str, now: int) -> None:
        """Samples of a stream have come."""
        self._arrivals.setdefault(stream, Arrivals(now)).came(now)

    def ended(self, stream: str) -> None:
        """A stream has come to its end: that is noticed at once."""
        self._silent.clear()
        self.pass_over(stream)

    def changed(self) -> None:
        """A stream is there that was not, or nobody knew of."""
        self._silent.clear()

    def forget(self, stream: str) -> None:
        """A stream is no more, and one of the same name would be another."""
        self._arrivals.pop(stream, None)
        self._used.pop(stream, None)
        self._gone.pop(stream, None)

    def has_spoken(self, stream: str) -> bool:
        """Whether anything was ever published to it."""
        return stream in self._arrivals

    def is_new_or_silent(self, stream: str, now: int, staleness: int | None) -> bool:
        """Whether it is silent (see `Arrivals.silent_at`), or has not spoken yet."""
        return not self.has_spoken(stream) or self._is_silent(stream, now, staleness)

    def silent_at(self, stream: str, staleness: int | None = None) -> int | None:
        """From when on (ns) a stream is silent; None: nobody knows."""
        arrivals = self._arrivals.get(stream)
        return None if arrivals is None else arrivals.silent_at(staleness)

    def at(self, now: int, staleness: int | None) -> frozenset[str]:
        """The streams that mean something and are silent by now, or have ended."""
        if self._looked != now:
            self._looked = now
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

    # -- who comes back ----------------------------------------------------------------------

    def pass_over(self, stream: str) -> None:
        """Somebody does without a stream until it speaks again."""
        if stream not in self._gone and stream in self._configuration.streams:
            self._gone[stream] = self._configuration.streams[stream].counters.used

    def is_back(self, stream: str) -> bool:
        """Whether a stream speaks that was passed over; this is said once."""
        if stream not in self._gone:
            return False
        del self._gone[stream]
        self._silent.clear()
        return True

    def back(self) -> Iterator[str]:
        """All of which that is so by now. Cost: a look at each that was passed over."""
        streams = self._configuration.streams
        for name, used in list(self._gone.items()):
            if name in streams and streams[name].counters.used != used and self.is_back(name):
                yield name
