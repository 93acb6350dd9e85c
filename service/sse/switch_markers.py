"""Where the switches of an adaptive subscription stand between its samples
([Introspection15 §4.4]): after sample ``position``, before the next one."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence

from ...engine.requests.adaptive_subscription import Rematch


class Marks:
    """What one client is still to be told of ``switches``, which grow while it listens.

    Those before sample ``position`` are its past; of the newest it hears when they are shown
    (``is_shown``: if one is, those before it are). Of switches that are no longer kept nothing is
    said. Cost: O(1) a switch. Memory: the switches that wait for their sample.
    """

    def __init__(
        self,
        switches: Sequence[Rematch],
        position: int,
        is_shown: Callable[[Rematch], bool] = lambda _: True,
    ) -> None:
        self._switches = switches
        self._is_shown = is_shown
        self._from = position
        self._read: Rematch | None = None
        self._waiting: deque[Rematch] = deque()

    @property
    def next(self) -> int | None:
        """The sample after which the next one stands, if there is one."""
        self._look()
        return self._waiting[0].position if self._waiting else None

    def before(self, number: int) -> Iterator[Rematch]:
        """Those that stand before sample ``number``, each once."""
        self._look()
        while self._waiting and self._waiting[0].position < number:
            yield self._waiting.popleft()

    def _look(self) -> None:
        """Take in what is new: from the end back to what was read last."""
        if not self._switches or self._switches[-1] is self._read:
            return
        new: list[Rematch] = []
        for switch in reversed(self._switches):
            if switch is self._read:
                break
            if new or self._is_shown(switch):
                new.append(switch)
        if new:
            self._read = new[0]
        self._waiting.extend(each for each in reversed(new) if each.position >= self._from)
