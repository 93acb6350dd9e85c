"""Idle streams, by the clock of the engine (docs/explanation/semantics.md, "Idle streams").

A stream declared with ``idle`` is idle when it has had no samples for that time. Its readers then
close windows without waiting for it. (`silent_streams` answers another question: whether an
adaptive subscription should look for a better source.)
"""

from __future__ import annotations

from collections.abc import Iterable

from ...streams.generator import StreamGenerator


class Idleness:
    """The times of streams' last samples. Cost: O(streams) a `tick`. Memory: two numbers each.

    Late samples and duplicates count: a stream that has them is not idle.
    """

    def __init__(self) -> None:
        self._last: dict[StreamGenerator, tuple[int, int]] = {}
        """The number of accepted samples, and the time (ns) when it last changed."""

    def note_samples(self, generator: StreamGenerator, now: int) -> None:
        """Note the time if the stream is new or has new samples."""
        accepted = generator.counters.accepted
        last = self._last.get(generator)
        if generator.idle is not None and (last is None or last[0] != accepted):
            self._last[generator] = accepted, now

    def tick(self, streams: Iterable[StreamGenerator], now: int) -> None:
        """Let streams fall idle that have had no samples for long enough at time ``now``. For a
        stream that is new here the silence begins now."""
        watched = [generator for generator in streams if generator.idle is not None]
        for generator in watched:
            self.note_samples(generator, now)
            _, last = self._last[generator]
            # The watermark of a stream stamped on arrival follows the clock, so readers never wait.
            if not (generator.is_ended or generator.is_idle or generator.stamped):
                assert generator.idle is not None
                if now - last >= generator.idle:
                    generator.fall_idle()
        if len(watched) < len(self._last):
            self._last = {generator: self._last[generator] for generator in watched}
