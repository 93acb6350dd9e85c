"""A cache of parsed texts, bounded by the length of the texts.

A parser makes up to a kilobyte for each character, so a few long texts need as much memory as
hundreds of short ones.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from functools import update_wrapper
from typing import Final, Generic, TypeVar

T = TypeVar("T")

CHARACTERS: Final = 256 * 1024
"""The greatest total length of the cached texts. The text parsed last stays in any case."""
LEAST: Final = 512
"""The length that a shorter text counts as; the cache therefore contains at most 512 texts."""


class TextCache(Generic[T]):
    """Decorates a function of a text with a cache of its last results. Exceptions are not cached.
    Thread-safe. Cost of a cached text: a look-up."""

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
            # Another thread may have parsed it meanwhile: all callers get the same result.
            if text not in self._known:
                self._known[text] = found
                self._size += _size(text)
                while self._size > CHARACTERS and len(self._known) > 1:
                    self._size -= _size(self._known.popitem(last=False)[0])
            return self._known[text]


def _size(text: str) -> int:
    return max(LEAST, len(text))
