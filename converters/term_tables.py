"""Term ids of texts by the codes of a string pool, and the other way round; texts of terms by their
ids."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..rdf.dictionary import NO_TERM, Ids, Term, TermDictionary, TermTable
from ..streams.string_pool import Codes, StringPool

_NO_CODE: Final = -1
_SHORT: Final = 256
"""Characters of a text up to which `TermTexts` keeps it."""


class PoolTable(TermTable):
    """Term ids by the codes of a pool; the table grows with the pool.

    It calls ``term`` for the id of a text's term when the text appears first, and again if the
    dictionary has forgotten the term. Cost: one gather a batch, and ``term`` once per distinct
    text. Memory: 4 bytes a text of the pool.
    """

    def __init__(self, term: Callable[[str], int], dictionary: TermDictionary) -> None:
        self._term = term
        self._pool: StringPool | None = None
        self._ids: Ids = np.empty(0, np.int32)
        self._known = 0
        dictionary.follow(self)

    def of_codes(self, codes: NDArray[np.int32], pool: StringPool) -> Ids:
        """The term ids of the texts with these codes, shape ``(n,)``."""
        if pool is not self._pool:
            self._pool, self._ids, self._known = pool, np.empty(0, np.int32), 0
        size = len(pool)
        if not size:  # an empty pool: every row is null
            return np.full(len(codes), NO_TERM, np.int32)
        if size > len(self._ids):
            larger = np.full(max(size, 2 * len(self._ids)), NO_TERM, np.int32)
            larger[: len(self._ids)] = self._ids
            self._ids = larger
        ids: Ids = self._ids[codes]
        if self._known < size and len(ids) and int(ids.min()) < 0:
            new = np.unique(codes[ids < 0])
            self._ids[new] = [self._term(pool[code]) for code in new.tolist()]
            self._known += len(new)
            ids = self._ids[codes]
        return ids

    def forget(self, freed: NDArray[np.bool_]) -> None:
        """See `dictionary.TermTable`."""
        gone = freed[self._ids]
        self._ids[gone] = NO_TERM
        self._known -= int(np.count_nonzero(gone))


class TextTable(TermTable):
    """Codes of the texts of terms, by their ids: the inverse of `PoolTable`.

    It calls ``text`` when the term appears first, and again if the dictionary has forgotten the
    term. Cost: one gather a batch, and ``text`` once per distinct term. Memory: 4 bytes per id of
    the dictionary.
    """

    def __init__(self, text: Callable[[Term], str], dictionary: TermDictionary) -> None:
        self._text = text
        self.dictionary = dictionary
        self._pool: StringPool | None = None
        self._codes: Codes = np.empty(0, np.int32)
        dictionary.follow(self)

    def of_ids(self, ids: Ids, pool: StringPool) -> Codes:
        """The codes in ``pool`` of the texts of these terms, shape ``(n,)``."""
        if pool is not self._pool:
            self._pool, self._codes = pool, np.empty(0, np.int32)
        if len(self._codes) < len(self.dictionary):
            larger = np.full(2 * len(self.dictionary), _NO_CODE, np.int32)
            larger[: len(self._codes)] = self._codes
            self._codes = larger
        codes: Codes = self._codes.take(ids)
        if len(codes) and int(codes.min()) < 0:
            new = np.unique(ids[codes < 0])
            texts = [self._text(self.dictionary.term(id)) for id in new.tolist()]
            self._codes[new] = pool.encode(texts)
            codes = self._codes.take(ids)
        return codes

    def forget(self, freed: NDArray[np.bool_]) -> None:
        """See `dictionary.TermTable`."""
        size = min(len(freed), len(self._codes))
        self._codes[:size][freed[:size]] = _NO_CODE


class TermTexts(TermTable):
    """The N-Triples of terms, by their ids.

    Cost: one gather a batch, and a text once per distinct term; the text of a long term each time.
    Memory: 8 bytes per id of the dictionary, and the texts that were asked for.
    """

    def __init__(self, dictionary: TermDictionary) -> None:
        self._dictionary = dictionary
        self._texts: NDArray[np.object_] = np.empty(0, np.object_)
        """None: not known."""
        dictionary.follow(self)

    def __getstate__(self) -> dict[str, object]:
        # A checkpoint needs no texts: they are made again.
        return {**self.__dict__, "_texts": self._texts[:0]}

    def of_ids(self, ids: Ids) -> list[str]:
        """The texts of these terms."""
        if len(self._texts) < len(self._dictionary):
            larger = np.empty(2 * len(self._dictionary), np.object_)
            larger[: len(self._texts)] = self._texts
            self._texts = larger
        found: list[str] = self._texts[ids].tolist()
        if None in found:
            new = {id for id, text in zip(ids.tolist(), found, strict=True) if text is None}
            texts = {id: str(self._dictionary.term(id)) for id in new}
            self._texts[list(texts)] = list(texts.values())
            found = self._texts[ids].tolist()
            self._texts[[id for id, text in texts.items() if len(text) > _SHORT]] = None
        return found

    def forget(self, freed: NDArray[np.bool_]) -> None:
        """See `dictionary.TermTable`."""
        size = min(len(freed), len(self._texts))
        self._texts[:size][freed[:size]] = None
