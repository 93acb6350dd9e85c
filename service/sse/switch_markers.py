"""The places of an adaptive subscription's switches between its samples
([Introspection15 §4.4]): after sample ``position``, before the next one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence

from ...engine.requests.adaptive_subscription import Rematch


class SwitchMarkers:
    """The ``switches`` that one client has not got yet; the sequence grows meanwhile.

    Switches before sample ``position`` are past. New ones count once they are visible to clients
    (``is_visible``; if one is, so are those before it). Evicted switches are left out. Cost: O(1)
    for each switch. Memory: the switches that wait for their sample.
    """

    def __init__(
        self,
        switches: Sequence[Rematch],
        position: int,
        is_visible: Callable[[Rematch], bool] = lambda _: True,
    ) -> None:
        self._switches = switches
        self._is_visible = is_visible
        self._position = position
        self._last_read: Rematch | None = None
        self._waiting: deque[Rematch] = deque()

    @property
    def next(self) -> int | None:
        """The number of the sample before the next switch, if there is one."""
        self._read_new()
        return self._waiting[0].position if self._waiting else None

    def before(self, number: int) -> Iterator[Rematch]:
        """Yield the switches before sample ``number``, each once."""
        self._read_new()
        while self._waiting and self._waiting[0].position < number:
            yield self._waiting.popleft()

    def _read_new(self) -> None:
        """Read the new switches, from the end back to the one that was read last."""
        if not self._switches or self._switches[-1] is self._last_read:
            return
        new: list[Rematch] = []
        for switch in reversed(self._switches):
            if switch is self._last_read:
                break
            if new or self._is_visible(switch):
                new.append(switch)
        if new:
            self._last_read = new[0]
        self._waiting.extend(each for each in reversed(new) if each.position >= self._position)
