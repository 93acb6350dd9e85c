"""Which streams have fallen idle, by the clock of the engine (docs/explanation/semantics.md, "Idle
streams").

Nobody waits for a stream that was declared with ``idle`` and has brought nothing for so long: the
windows of whoever reads others too go on without it. (`silent_streams` asks another thing: whether
an adaptive subscription has something better to read.)
"""

from __future__ import annotations

from collections.abc import Iterable

from ...streams.generator import StreamGenerator


class Idleness:
    """When streams last brought something. Cost: O(streams) a `tick`. Memory: two numbers each.

    Samples that are late or duplicates are something, too: the stream is not idle.
    """

    def __init__(self) -> None:
        self._last: dict[StreamGenerator, tuple[int, int]] = {}
        """How many samples a stream had brought, and when (ns) it was seen to bring the last."""

    def came(self, generator: StreamGenerator, now: int) -> None:
        """The stream has been declared, or may have brought something."""
        brought = generator.counters.accepted
        known = self._last.get(generator)
        if generator.idle is not None and (known is None or known[0] != brought):
            self._last[generator] = brought, now

    def tick(self, streams: Iterable[StreamGenerator], now: int) -> None:
        """The time is ``now``. A stream that nobody has told of begins to be silent now."""
        watched = [generator for generator in streams if generator.idle is not None]
        for generator in watched:
            self.came(generator, now)
            _, last = self._last[generator]
            # Those that are stamped on arrival are as far as the clock.
            if not (generator.is_ended or generator.is_idle or generator.stamped):
                assert generator.idle is not None
                if now - last >= generator.idle:
                    generator.fall_idle()
        if len(watched) < len(self._last):
            self._last = {generator: self._last[generator] for generator in watched}
