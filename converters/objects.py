"""Names of objects: a value of an id field <-> an IRI ([Events14 §V.A], SPEC §4).

Laws: ``object_iri(object_name(iri)) == iri`` for every IRI; ``object_name(object_iri(name))``
names the same object as ``name``, in its shortest spelling.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import NamedNode

from ..rdf.dictionary import NO_TERM, Ids, Term, TermArena, TermDictionary, TermTable
from ..rdf.namespaces import PREFIXES
from ..streams.sample import Column, Mask
from .term_tables import PoolTable

_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.\-]*:")
# RFC 3987: the characters of a path beside letters and digits of any script. `_encoded` also
# encodes "%", so that decoding inverts it, and "#" and "?", so that a name stays in its namespace.
_KEPT = frozenset("-._~!$&'()*+,;=:@/")
_PLAIN = re.compile(r"[A-Za-z0-9\-._~!$&'()*+,;=:@/]*").fullmatch


def object_iri(name: str, namespace: str) -> str:
    """The IRI of the object called ``name``.

    A name with a shared prefix (``dyknow:uav1``) is expanded, an absolute IRI is itself, any other
    text becomes an IRI in ``namespace``, percent-encoded where an IRI may not hold a character.
    """
    if _SCHEME.match(name):
        prefix, _, local = name.partition(":")
        iri = PREFIXES[prefix] + local if prefix in PREFIXES else name
        if _is_iri(iri):
            return iri
    if _PLAIN(name):
        return namespace + name
    return namespace + "".join(c if _may_stand(c) else _encoded(c) for c in name)


def object_in_text(text: str, namespace: str) -> str:
    """The IRI of the object that a text names as `object_iri` does, or by its IRI in brackets."""
    return object_iri(text.removeprefix("<").removesuffix(">"), namespace)


def object_name(iri: str, namespace: str) -> str:
    """The shortest name that `object_iri` takes to ``iri``: local in ``namespace``, else full."""
    # Thousands of long names would take gigabytes.
    return _known_name(iri, namespace) if len(iri) <= _SHORT else _name(iri, namespace)


def spellings(iri: str, namespace: str) -> tuple[str, ...]:
    """All names that `object_iri` takes to ``iri``: local, with a shared prefix, and in full."""
    names = [object_name(iri, namespace), iri]
    names += [f"{p}:{iri[len(n) :]}" for p, n in PREFIXES.items() if iri.startswith(n)]
    return tuple(dict.fromkeys(name for name in names if object_iri(name, namespace) == iri))


def _name(iri: str, namespace: str) -> str:
    if iri.startswith(namespace):
        try:
            name = unquote(iri.removeprefix(namespace), errors="strict")
        except UnicodeDecodeError:
            return iri
        if object_iri(name, namespace) == iri:
            return name
    return iri


_SHORT = 256
"""Characters of an IRI up to which its name is cached."""
_known_name = lru_cache(maxsize=65_536)(_name)
_SMALL = 1 << 20
"""Integers from 0 to here index a table; a binary search finds others."""


@dataclass(frozen=True, slots=True)
class _Interning:
    """Interns names. It refers to no table: a cycle would keep unused tables for longer."""

    intern: Callable[[Term], int]
    namespace: str

    def __call__(self, name: str) -> int:
        return self.intern(NamedNode(object_iri(name, self.namespace)))


class ObjectTable(TermTable):
    """Term ids of the objects that a field names: a table by the codes of the field's pool, or by
    its integers.

    With ``keeps`` the terms stay in the dictionary as long as the table does, for callers that
    store their ids and are no holders (docs/explanation/design/0006). Else the table forgets a
    term with the dictionary.

    Law (tests/laws): each row has the id that `of_name` gives its name; a known name adds nothing.
    Cost: one gather a batch (a binary search for large integers), and an IRI per distinct name.
    Memory: 4 bytes a name of the pool, 4 per integer up to the greatest small one, 12 a large one.
    """

    def __init__(self, dictionary: TermDictionary, namespace: str, *, keeps: bool = False) -> None:
        intern = TermArena(dictionary).id if keeps else dictionary.transient_id
        self.of_name = _Interning(intern, namespace)
        """The term id of the object with this name."""
        self._texts = PoolTable(self.of_name, dictionary)
        self._small: Ids = np.empty(0, np.int32)
        self._large: NDArray[np.int64] = np.empty(0, np.int64)
        self._large_ids: Ids = np.empty(0, np.int32)
        dictionary.follow(self)

    def ids(self, column: Column) -> tuple[Ids, Mask]:
        """The term ids that a text or integer field names, and the rows that name one; ``(n,)``."""
        return self.of_column(column), column.present

    def of_column(self, column: Column) -> Ids:
        """The term ids alone; those of null rows have no meaning."""
        values = column.values
        if column.null is not None:  # any value may stand under a null bit
            values = np.where(column.null, values.dtype.type(0), values)
        if column.pool is None:
            return self.of_integers(values)
        return self._texts.of_codes(values, column.pool)

    def of_integers(self, values: NDArray[np.int64]) -> Ids:
        """The term ids of objects whose names are integers, shape ``(n,)``."""
        if not len(values):
            return np.empty(0, np.int32)
        greatest = int(values.max())
        if greatest >= _SMALL or int(values.min()) < 0:
            return self._of_large(values)
        if greatest >= len(self._small):
            table = np.full(1 << greatest.bit_length(), NO_TERM, np.int32)
            table[: len(self._small)] = self._small
            self._small = table
        ids = self._small[values]
        if int(ids.min()) < 0:
            new = np.unique(values[ids < 0])
            self._small[new] = self._of_new(new)
            ids = self._small[values]
        return ids

    def _of_large(self, values: NDArray[np.int64]) -> Ids:
        places = self._large.searchsorted(values)
        if len(self._large):
            known = self._large.take(places, mode="clip") == values
        else:
            known = np.zeros(len(values), np.bool_)
        if not known.all():
            new = np.unique(values[~known])
            where = self._large.searchsorted(new)
            self._large_ids = np.insert(self._large_ids, where, self._of_new(new))
            self._large = np.insert(self._large, where, new)
            places = self._large.searchsorted(values)
        ids: Ids = self._large_ids[places]
        return ids

    def _of_new(self, values: NDArray[np.int64]) -> Ids:
        return np.array([self.of_name(str(value)) for value in values.tolist()], np.int32)

    def forget(self, freed: NDArray[np.bool_]) -> None:
        """See `dictionary.TermTable`."""
        self._small[freed[self._small]] = NO_TERM
        gone = freed[self._large_ids]
        if gone.any():
            self._large, self._large_ids = self._large[~gone], self._large_ids[~gone]


def _is_iri(text: str) -> bool:
    try:
        NamedNode(text)
    except ValueError:
        return False
    return True


def _may_stand(character: str) -> bool:
    if character.isascii():
        return character.isalnum() or character in _KEPT
    code = ord(character)
    return (
        0xA0 <= code <= 0xD7FF
        or 0xF900 <= code <= 0xFDCF
        or 0xFDF0 <= code <= 0xFFEF
        or (0x10000 <= code <= 0xDFFFD and code & 0xFFFF <= 0xFFFD)
    )


def _encoded(character: str) -> str:
    return "".join(f"%{byte:02X}" for byte in character.encode())
