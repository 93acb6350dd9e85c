"""What was read of the last texts, by how long they are: a few long ones hold as much as hundreds
of short ones, and what a parser makes of a text takes up to a kilobyte a character."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from functools import update_wrapper
from typing import Final, Generic, TypeVar

T = TypeVar("T")

CHARACTERS: Final = 256 * 1024
"""Of all texts of which something is remembered, and the last one."""
LEAST: Final = 512
"""As so many a text counts that has fewer: so there are at most 512 of them."""


class TextCache(Generic[T]):
    """A function of a text that remembers what it gave for the last ones; not what it raised. Any
    thread may call. Cost of a text that is known: a look-up."""

    def __init__(self, work: Callable[[str], T]) -> None:
        self._work = work
        self._known: OrderedDict[str, T] = OrderedDict()
        self._size = 0
        self._lock = threading.Lock()
        update_wrapper(self, work)

    def __call__(self, text: str) -> T:
        with self._lock:
            if text in self._known:
                self._known.move_to_end(text)
                return self._known[text]
        found = self._work(text)
        with self._lock:
            # Another thread may have read it meanwhile: all are given the same.
            if text not in self._known:
                self._known[text] = found
                self._size += _size(text)
                while self._size > CHARACTERS and len(self._known) > 1:
                    self._size -= _size(self._known.popitem(last=False)[0])
            return self._known[text]


def _size(text: str) -> int:
    return max(LEAST, len(text))
