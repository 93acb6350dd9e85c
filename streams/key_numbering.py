"""Numbers for keys, from 0 on: what is kept of each object then stands in arrays."""

from __future__ import annotations

from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .string_pool import Codes, StringPool

Keys: TypeAlias = NDArray[np.int64]
"""Names of objects as 64-bit integers, shape ``(n,)``."""
Numbers: TypeAlias = NDArray[np.int64]

_FEW: Final = 32
"""Up to this number of keys a look-up one by one is faster."""
_SPARSE: Final = 16
"""Places of the table per key at most; keys that lie further apart are looked up in a dict."""
_ROOM: Final = 2**16
"""Places that the table may have in any case."""


class Numbering:
    """Each distinct key has a number; they are 0, 1, 2 … in the order in which keys first came.

    Law: numbers are equal if and only if their keys are, and a number never changes. Cost: O(n)
    numpy for n small keys that are not negative, such as ids of terms; for others, for few and for
    new ones a dict look-up each, some 50 ns. Memory: a dict entry a distinct key, and a table of
    at most 16 places of 8 bytes for each (of 65,536 in any case), for as long as it lives.
    """

    def __init__(self) -> None:
        self._known = _Known()
        # What is known of keys from 0 on, as far as many have been asked for at once: -1 for none.
        self._table: Numbers = np.empty(0, np.int64)

    def __len__(self) -> int:
        return len(self._known)

    def of(self, keys: Keys) -> Numbers:
        """The numbers of ``keys``, shape ``(n,)``; a key that is new gets the next one."""
        if len(keys) < _FEW or not self._has_room_for(keys):
            return self._looked_up(keys)
        numbers = self._table[keys]
        if int(numbers.min()) < 0:
            new = keys[numbers < 0]
            self._table[new] = self._looked_up(new)
            numbers = self._table[keys]
        return numbers

    def _looked_up(self, keys: Keys) -> Numbers:
        return np.fromiter(map(self._known.__getitem__, keys.tolist()), np.int64, len(keys))

    def _has_room_for(self, keys: Keys) -> bool:
        """Whether all of the keys have a place in the table, which may grow for them."""
        greatest, room = int(keys.max()), len(self._table)
        most = max(_ROOM, _SPARSE * len(self._known))
        if greatest >= most or int(keys.min()) < 0:
            return False
        if greatest >= room:
            table = np.full(min(2 * (greatest + 1), most), -1)
            table[:room] = self._table
            self._table = table
        return True


class TextNumbering:
    """The same for texts, by their codes in a pool that may be another one at any time.

    Cost: one gather a batch, Python per text that is new, and per text in use once for each pool.
    Memory: each distinct text, and 8 bytes for each of the pool, for as long as it lives.
    """

    def __init__(self) -> None:
        self._known: dict[str, int] = {}
        self._pool: StringPool | None = None
        self._table: Numbers = np.empty(0, np.int64)

    def of(self, codes: Codes, pool: StringPool) -> Numbers:
        """The numbers of the texts that have these ``codes``, shape ``(n,)``."""
        if pool is not self._pool:
            self._pool, self._table = pool, np.empty(0, np.int64)
        if len(self._table) < len(pool):
            table = np.full(2 * len(pool), -1)
            table[: len(self._table)] = self._table
            self._table = table
        numbers: Numbers = self._table[codes]
        if len(numbers) and int(numbers.min()) < 0:
            for code in codes[numbers < 0].tolist():
                self._table[code] = self._known.setdefault(pool[code], len(self._known))
            numbers = self._table[codes]
        return numbers


def paired(firsts: Keys, seconds: Keys) -> Keys:
    """A key for each pair; both of a pair are in 0 … 2**31 - 1, and no two pairs have one key."""
    return firsts << 32 | seconds


class _Known(dict[int, int]):
    def __missing__(self, key: int) -> int:
        number = self[key] = len(self)
        return number
