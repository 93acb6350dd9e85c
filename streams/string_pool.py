"""Dictionary encoding of text: strings become small integers once, and stay integers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Codes = NDArray[np.int32]
_FEW: Final = 16
"""Strings put in their place with each one that is encoded alone."""
_MANY: Final = 8192
"""And with those that are encoded together; these are some milliseconds of work."""
OVERHEAD: Final = 128
"""Bytes that a text is reckoned with beside its characters: it is an object, and in tables."""
_WIDE: Final = 4
"""Bytes of a character where not all of a text are ASCII, at most."""


def size_of(text: str) -> int:
    """Bytes that a text is reckoned with: 128 and its characters, four times as many where they are
    not all ASCII."""
    return OVERHEAD + (len(text) if text.isascii() else _WIDE * len(text))


class Place(NamedTuple):
    """What codes the strings of one pool have in ``pool``: ``codes`` by their codes here. Of those
    are ``fresh``, in order, what it lacks, if it then still has as many as ``start``."""

    pool: StringPool
    start: int
    codes: Codes
    fresh: Sequence[str]
    late: dict[str, int]
    """The codes of these."""

    @property
    def holds(self) -> bool:
        """Whether it is still so."""
        # Codes never change meaning, so only the fresh ones depend on texts that others add.
        return not self.fresh or len(self.pool) == self.start


class StringPool:
    """An append-only list of distinct strings; a string's code is its position.

    Law: ``pool[pool.code(s)] == s``, and a code once given never changes meaning, so columns of
    codes may be shared, sliced and cached. One pool serves one field of one stream.

    Many new strings at once take long, half a microsecond each. For strings in a pool of their own
    `find_place` finds the codes beforehand, in another thread; `codes_in` is quick then.

    Cost: a dict look-up per string encoded, nothing per string carried. Memory: every distinct
    string once, for as long as the pool lives: that is as long as somebody keeps codes of the
    stream (`FluentStream.forget_texts`).
    """

    __slots__ = (
        "_characters",
        "_codes",
        "_late",
        "_longest",
        "_measured",
        "_moved",
        "_place",
        "_sized",
        "_sizes",
        "_strings",
    )

    def __init__(self, strings: Iterable[str] = ()) -> None:
        self._strings: list[str] = []
        self._codes: dict[str, int] = {}
        self._late: dict[str, int] = {}
        """Codes of the last strings where these are not in ``_codes``, or but the first of them."""
        self._moved = 0
        """The first one that is not."""
        self._place: Place | None = None
        self._measured = self._characters = self._longest = 0
        """Of so many strings these are known."""
        self._sized = 0
        """Of so many the sizes are known one by one."""
        self._sizes: NDArray[np.int64] = np.empty(0, np.int64)
        for string in strings:
            self.code(string)

    def __len__(self) -> int:
        return len(self._strings)

    def __getitem__(self, code: int) -> str:
        return self._strings[code]

    def code(self, string: str) -> int:
        """The code of ``string``, given now if it is new."""
        if self._late:
            # Each call moves a few late strings, so that no single call pays for a large batch.
            self._move(_FEW)
            late = self._late.get(string)
            if late is not None:
                return late
        found = self._codes.setdefault(string, len(self._strings))
        if found == len(self._strings):
            self._strings.append(string)
        return found

    def find(self, string: str) -> int:
        """The code of ``string``, or -1 if it has none: a look-up that adds nothing."""
        return self._codes.get(string, -1) if not self._late else self._find_late(string)

    def _find_late(self, string: str) -> int:
        # Another thread may move a string from `_late` to `_codes` meanwhile, so `_late` is first.
        found = self._late.get(string)
        return self._codes.get(string, -1) if found is None else found

    def encode(self, strings: Sequence[str]) -> Codes:
        """Codes of many strings, shape ``(n,)``."""
        if self._late:
            self._move(_MANY)
        try:  # that all are known is the common case, and three times faster to find out
            return np.fromiter(map(self._codes.__getitem__, strings), np.int32, len(strings))
        except KeyError:
            code = self.code
            if not self._late:
                for string in dict.fromkeys(strings):
                    code(string)
                return np.fromiter(map(self._codes.__getitem__, strings), np.int32, len(strings))
            return np.fromiter((code(s) for s in strings), np.int32, len(strings))

    def strings(self, start: int = 0) -> Sequence[str]:
        """The strings from code ``start`` on, for tables that follow the pool as it grows."""
        return self._strings[start:]

    @property
    def characters(self) -> int:
        """Those of all strings. Cost: 20 ns a new string, once."""
        self._measure()
        return self._characters

    @property
    def longest(self) -> int:
        """No string has more bytes (`size_of`). Cost: as `characters`."""
        self._measure()
        return OVERHEAD + _WIDE * self._longest

    def sizes(self) -> NDArray[np.int64]:
        """Bytes of each string (`size_of`) by its code, shape ``(n,)``. Cost: O(1), and 0.1 µs a
        new string, once."""
        done, there = self._sized, len(self._strings)
        if done < there:
            if there > len(self._sizes):
                longer = np.empty(max(there, 2 * done), np.int64)
                longer[:done] = self._sizes[:done]
                self._sizes = longer
            new = self._strings[done:]
            self._sizes[done:there] = np.fromiter(map(size_of, new), np.int64, len(new))
            self._sized = there
        return self._sizes[:there]

    def _measure(self) -> None:
        if self._measured < len(self._strings):
            lengths = list(map(len, self._strings[self._measured :]))
            self._measured += len(lengths)
            self._characters += sum(lengths)
            self._longest = max(self._longest, max(lengths))

    def find_place(self, pool: StringPool) -> None:
        """Find the codes that all strings of this one have in ``pool``, or will have once
        `codes_in` puts them there.

        May run in another thread than that of ``pool``, which may grow meanwhile: then the place
        holds no more. `find` looks in `_late` first, from which `_move` empties strings only after
        they are in `_codes`, so a string that ``pool`` has is always found.
        """
        self._place = None
        # The length is read before the search: the place does not hold if the pool grows meanwhile.
        start = len(pool)
        codes = np.fromiter(map(pool.find, self._strings), np.int32, len(self))
        lacking = np.flatnonzero(codes < 0)
        codes[lacking] = np.arange(start, start + len(lacking), dtype=np.int32)
        fresh = [self._strings[i] for i in lacking.tolist()]
        late = dict(zip(fresh, range(start, start + len(fresh)), strict=True))
        self._place = Place(pool, start, codes, fresh, late)

    def has_place(self, pool: StringPool) -> bool:
        """Whether `codes_in` is quick."""
        return self._place is not None and self._place.pool is pool and self._place.holds

    def codes_in(self, pool: StringPool) -> Codes:
        """The codes of all its strings in ``pool``, which gets those that it lacks. Cost: O(1)
        Python where `has_place`; else `encode`."""
        place, self._place = self._place, None
        if place is None or place.pool is not pool or not place.holds:
            return pool.encode(self._strings)
        if place.fresh:
            # A pool has one table of late strings, so the earlier ones are moved first.
            pool._move(len(pool._late))
            pool._late, pool._moved = place.late, len(pool)
            pool._strings.extend(place.fresh)
        return place.codes

    def _move(self, count: int) -> None:
        """Put so many of the late ones in their place."""
        end = min(self._moved + count, len(self._strings))
        part = self._strings[self._moved : end]
        self._codes.update(zip(part, range(self._moved, end), strict=True))
        self._moved = end
        # `_late` is emptied last: another thread finds each string in one of the two at any time.
        if end == len(self._strings):
            self._late = {}


_EACH: Final = 256
"""One text of so many is sampled, by its hash."""
_FEWEST: Final = 4
"""Sampled texts from which on a share is estimated: one alone would say all or nothing."""
_GHOSTS: Final = 1024
"""Hashes that are remembered: those of the last 262,144 forgotten texts."""


class Ghosts:
    """A sample of the texts that a field has forgotten: whether they come again.

    The hash decides which texts are sampled, so those that come again are the same ones. Cost:
    50 ns a text. Memory: at most 0.1 MB.
    """

    def __init__(self) -> None:
        self._hashes: dict[int, None] = {}
        """The oldest one first."""

    def add(self, pool: StringPool, kept: StringPool) -> None:
        """Note that the texts of ``pool`` are forgotten but for those in ``kept``."""
        kept_hashes = set(_sampled(kept))
        self._hashes |= dict.fromkeys(h for h in _sampled(pool) if h not in kept_hashes)
        while len(self._hashes) > _GHOSTS:
            del self._hashes[next(iter(self._hashes))]

    def share(self, pool: StringPool) -> float:
        """The estimated share of the texts of ``pool`` that had been forgotten; 0 if too few are
        sampled to tell."""
        sampled = _sampled(pool)
        if len(sampled) < _FEWEST:
            return 0.0
        return sum(each in self._hashes for each in sampled) / len(sampled)


def _sampled(pool: StringPool) -> list[int]:
    return [found for found in map(hash, pool.strings()) if not found % _EACH]
