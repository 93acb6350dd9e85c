"""The term dictionary: an RDF term becomes a small integer, and stays one while anybody has it.

Numbers on the way of a sample are *not* here: they stay float64 or int64 in their columns
(`timed.ObjectColumn`). The dictionary holds IRIs, strings, blank nodes and the literals that
fit no column.

Streams say new terms without end, and so do those who ask, so terms are of two kinds. *Pinned* ones
stay: features, sorts and the static side. *Transient* ones, of streams, computed, and constants of
queries and annotations (`HeldTerms`), are forgotten by mark and sweep when no *holder* has their ids
any more (docs/design/0006-terms-that-pass.md).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import Any, Protocol, TypeAlias
from weakref import ref

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import BlankNode, Literal, NamedNode

Term: TypeAlias = NamedNode | BlankNode | Literal
Ids: TypeAlias = NDArray[np.int32]

NO_TERM = -1
"""The id of no term: an unbound variable, a value that is absent."""

SWEEP_FLOOR = 32_768
"""So many transient terms are not worth a sweep."""
_SHARE = 16
_NONE: Ids = np.empty(0, np.int32)
_FREE, _TRANSIENT, _PINNED = 0, 1, 2


class ForgottenTerm(LookupError):
    """An id was read that has no term any more: whoever had it did not hold it."""


class Holder(Protocol):
    """Keeps ids of transient terms beyond one call, and says so (`TermDictionary.hold`)."""

    def held_ids(self) -> Iterable[NDArray[Any] | Sequence[int]]:
        """The ids that it has, in arrays of integers, in any order, again and again; negative ones
        are none. What stands where there is no value is not given: it may be anything."""


class TermTable(ABC):
    """What is known by id or as an id, and found anew if need be (`TermDictionary.follow`)."""

    def implied(self, marked: NDArray[np.bool_]) -> Ids:
        """The ids that have to stay because those stay that are ``marked``."""
        return _NONE

    @abstractmethod
    def forget(self, freed: NDArray[np.bool_]) -> None:
        """The ids ``freed`` have no terms any more, and will have others. Of shape one more than
        there are ids: the last one stands for `NO_TERM`, and is never freed."""


class HeldTerms:
    """What somebody names: its terms stay as long as this does."""

    __slots__ = ("__weakref__", "ids")

    def __init__(self, dictionary: TermDictionary, terms: Iterable[Term]) -> None:
        self.ids = dictionary.transient_ids(terms)
        """Theirs, in their order, shape ``(n,)``."""
        dictionary.hold(self)

    def held_ids(self) -> Sequence[Ids]:
        """See `Holder`."""
        return (self.ids,)


class TermArena:
    """Who keeps ids in places that nobody asks (keys inside kernels) has them from here: the terms
    stay as long as this does. Memory: a byte an id of the dictionary."""

    __slots__ = ("__weakref__", "_dictionary", "_has")

    def __init__(self, dictionary: TermDictionary) -> None:
        self._dictionary = dictionary
        self._has = bytearray()
        """By id whether it was given."""
        dictionary.hold(self)

    def id(self, term: Term) -> int:
        """The id of ``term``, given now if it is new."""
        found = self._dictionary.transient_id(term)
        if found >= len(self._has):
            self._has.extend(bytes(max(found + 1 - len(self._has), len(self._has))))
        self._has[found] = 1
        return found

    def held_ids(self) -> Sequence[NDArray[Any]]:
        """See `Holder`."""
        return (np.flatnonzero(np.frombuffer(bytes(self._has), np.uint8)),)


class TermDictionary:
    """Distinct terms by small integers.

    Law: ``d.term(d.id(t)) == t``; equal terms have equal ids, and an id never changes its meaning
    while its term is pinned or somebody holds it. Equality is RDF term equality
    (``"1"^^xsd:integer`` and ``"01"^^xsd:integer`` differ).

    `id` pins a term for good. `transient_id` gives an id that holds until the next `collect` after
    which no holder has it. `collect` is called only where no ids are on their way: between two
    batches. What is not called stays: without `collect` every term does.

    Ids are dense and used again. Cost: a dict look-up per term encoded; a sweep a pass over what is
    held and Python a forgotten term, which is O(1) for each term that came since the last. Memory:
    the pinned terms, and at most the greatest of twice those in use, a sixteenth of the ids that
    are held, and `SWEEP_FLOOR`.
    """

    __slots__ = (
        "_due",
        "_free",
        "_holders",
        "_ids",
        "_next",
        "_state",
        "_tables",
        "_terms",
        "_transient",
        "reused",
    )

    def __init__(self) -> None:
        self._terms: list[Term | None] = []
        self._ids: dict[Term, int] = {}
        self._state = bytearray()
        self._free: list[int] = []
        self._next = 0
        """The id that the next new term gets: no term has it."""
        self._transient = 0
        self._due = SWEEP_FLOOR
        self._holders: set[ref[Holder]] = set()
        self._tables: set[ref[TermTable]] = set()
        self.reused: list[int] = []
        """Ids below the last new one that got a term since the last sweep, in order: for tables
        that follow the dictionary as it grows."""

    def __len__(self) -> int:
        """How many ids there are: each is less than this. Some may have no term now."""
        return len(self._terms)

    @property
    def count(self) -> int:
        """How many terms there are."""
        return len(self._ids)

    def id(self, term: Term) -> int:
        """The id of ``term``, given now if it is new; it stays for good."""
        found = self._ids.setdefault(term, self._next)
        if found == self._next:
            self._give(term, _PINNED)
        elif self._state[found] == _TRANSIENT:
            self._state[found] = _PINNED
            self._transient -= 1
        return found

    def transient_id(self, term: Term) -> int:
        """The id of ``term``, given now if it is new; it stays while it is held."""
        found = self._ids.setdefault(term, self._next)
        if found == self._next:
            self._give(term, _TRANSIENT)
            self._transient += 1
        return found

    def find(self, term: Term) -> int:
        """The id of ``term``, or `NO_TERM`: a look-up that adds nothing."""
        return self._ids.get(term, NO_TERM)

    def term(self, id: int) -> Term:
        """The term with this id; raises `ForgottenTerm` where it has none any more."""
        found = self._terms[id]
        if found is None:
            raise ForgottenTerm(f"the term with id {id} has been forgotten")
        return found

    def ids(self, terms: Iterable[Term]) -> Ids:
        """Ids of many terms, shape ``(n,)``; they stay for good."""
        return np.fromiter(map(self.id, terms), np.int32)

    def transient_ids(self, terms: Iterable[Term]) -> Ids:
        """Ids of many terms, shape ``(n,)``; they stay while they are held."""
        return np.fromiter(map(self.transient_id, terms), np.int32)

    def terms(self, start: int = 0) -> Sequence[Term | None]:
        """The terms from id ``start`` on, for tables that follow the dictionary as it grows; None
        where an id has no term now."""
        return self._terms[start:]

    def __getstate__(self) -> dict[str, object]:
        """As it is copied: with those who hold and follow it, as far as they live."""
        state = {name: getattr(self, name) for name in self.__slots__}
        for name in ("_holders", "_tables"):
            state[name] = [value for reference in state[name] if (value := reference()) is not None]
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            setattr(self, name, value)
        self._holders = {ref(holder) for holder in state["_holders"]}
        self._tables = {ref(table) for table in state["_tables"]}

    def hold(self, holder: Holder) -> None:
        """Ask ``holder`` at each sweep what it has, as long as it lives."""
        self._holders.add(ref(holder, self._holders.discard))

    def follow(self, table: TermTable) -> None:
        """Tell ``table`` at each sweep what is forgotten, as long as it lives."""
        self._tables.add(ref(table, self._tables.discard))

    def collect(self) -> int:
        """Forget the transient terms that nobody holds, if enough have come to be worth it; returns
        how many. To be called where no ids are on their way, between two batches."""
        return self._sweep() if self._transient >= self._due else 0

    def _give(self, term: Term, state: int) -> None:
        """``term``, which is new, gets the next id."""
        id = self._next
        if self._free:
            self._free.pop()
            self._terms[id] = term
            self._state[id] = state
            self.reused.append(id)
        else:
            self._terms.append(term)
            self._state.append(state)
        self._next = self._free[-1] if self._free else len(self._terms)

    def _sweep(self) -> int:
        size, rows = len(self._terms), 0
        marked = np.zeros(size + 1, np.bool_)
        # Copies: another thread that reads results may make holders meanwhile.
        for reference in self._holders.copy():
            holder = reference()
            if holder is not None:
                for ids in holder.held_ids():
                    marked[np.asarray(ids, None if len(ids) else np.int32)] = True
                    rows += len(ids)
        state = np.frombuffer(bytes(self._state), np.uint8)
        marked[:size] |= state == _PINNED
        tables = [table for reference in self._tables.copy() if (table := reference()) is not None]
        for table in tables:
            marked[table.implied(marked)] = True
        gone = np.flatnonzero((state == _TRANSIENT) & ~marked[:size])
        freed = np.zeros(size + 1, np.bool_)
        freed[gone] = True
        for table in tables:
            table.forget(freed)
        self.reused = []
        self._remove(gone.tolist())
        survivors = self._transient
        self._due = max(SWEEP_FLOOR, 2 * survivors, survivors + (rows + size) // _SHARE)
        return len(gone)

    def _remove(self, gone: Sequence[int]) -> None:
        # Backwards, so that the least id is given first.
        for id in reversed(gone):
            term = self._terms[id]
            assert term is not None
            del self._ids[term]
            self._terms[id] = None
            self._state[id] = _FREE
        self._free.extend(reversed(gone))
        self._transient -= len(gone)
        self._next = self._free[-1] if self._free else len(self._terms)
