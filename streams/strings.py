"""Dictionary encoding of text: strings become small integers once, and stay integers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

Codes = NDArray[np.int32]


class StringPool:
    """An append-only list of distinct strings; a string's code is its position.

    Law: ``pool[pool.code(s)] == s``, and a code once given never changes meaning, so columns of
    codes may be shared, sliced and cached. One pool serves one field of one stream.

    Cost: a dict look-up per string encoded, nothing per string carried. Memory: every distinct
    string once, for as long as the pool lives: that is as long as somebody keeps codes of the
    stream (`FluentStream.forget_texts`).
    """

    __slots__ = ("_codes", "_strings")

    def __init__(self, strings: Iterable[str] = ()) -> None:
        self._strings: list[str] = []
        self._codes: dict[str, int] = {}
        for string in strings:
            self.code(string)

    def __len__(self) -> int:
        return len(self._strings)

    def __getitem__(self, code: int) -> str:
        return self._strings[code]

    def code(self, string: str) -> int:
        """The code of ``string``, given now if it is new."""
        found = self._codes.setdefault(string, len(self._strings))
        if found == len(self._strings):
            self._strings.append(string)
        return found

    def find(self, string: str) -> int:
        """The code of ``string``, or -1 if it has none: a look-up that adds nothing."""
        return self._codes.get(string, -1)

    def encode(self, strings: Sequence[str]) -> Codes:
        """Codes of many strings, shape ``(n,)``."""
        try:  # that all are known is the common case, and three times faster to find out
            return np.fromiter(map(self._codes.__getitem__, strings), np.int32, len(strings))
        except KeyError:
            code = self.code
            return np.fromiter((code(s) for s in strings), np.int32, len(strings))

    def strings(self, start: int = 0) -> Sequence[str]:
        """The strings from code ``start`` on, for tables that follow the pool as it grows."""
        return self._strings[start:]
