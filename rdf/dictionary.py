"""The term dictionary: it maps RDF terms to small integers.

Numbers of samples are *not* here: they stay float64 or int64 in their columns
(`timed.ObjectColumn`). The dictionary stores IRIs, strings, blank nodes and the literals that fit
no column.

Streams and clients bring new terms without end, so there are two kinds of terms. *Pinned* terms
stay for good: features, sorts and the static side. *Transient* terms come from streams,
computations, and constants of queries and annotations (`HeldTerms`). A mark and sweep frees those
whose ids no *holder* reports (docs/explanation/design/0006-terms-that-pass.md).
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
"""The id that stands for an unbound variable or an absent value."""

SWEEP_FLOOR = 32_768
"""Below this number of transient terms no sweep runs: it would cost more than it frees."""
_SHARE = 16
_NONE: Ids = np.empty(0, np.int32)
_FREE, _TRANSIENT, _PINNED = 0, 1, 2


class ForgottenTerm(LookupError):
    """A caller read an id whose term was freed: the caller did not hold it."""


class Holder(Protocol):
    """Keeps ids of transient terms beyond one call, and reports them at each sweep
    (`TermDictionary.hold`)."""

    def held_ids(self) -> Iterable[NDArray[Any] | Sequence[int]]:
        """Return the ids that it keeps, as arrays of integers in any order; negative ids are
        ignored. Each sweep calls it. It must leave out the filler where a column has no value:
        filler may be any number."""


class TermTable(ABC):
    """A cache keyed by ids or with ids as values. The entries can be rebuilt, so they keep no term
    alive by themselves (`TermDictionary.follow`)."""

    def implied(self, marked: NDArray[np.bool_]) -> Ids:
        """Return the ids that must stay because the ``marked`` ids stay."""
        return _NONE

    @abstractmethod
    def forget(self, freed: NDArray[np.bool_]) -> None:
        """Drop the entries of the ``freed`` ids, which the dictionary will reuse. The mask has one
        entry more than there are ids: the last one stands for `NO_TERM` and is never freed."""


class HeldTerms:
    """Terms that stay in the dictionary as long as this object lives."""

    __slots__ = ("__weakref__", "ids")

    def __init__(self, dictionary: TermDictionary, terms: Iterable[Term]) -> None:
        self.ids = dictionary.transient_ids(terms)
        """Their ids, in the order of the terms, shape ``(n,)``."""
        dictionary.hold(self)

    def held_ids(self) -> Sequence[Ids]:
        """See `Holder`."""
        return (self.ids,)


class TermArena:
    """Interns terms that stay as long as this object lives. It serves code that keeps ids where no
    holder can report them, such as keys inside kernels. Memory: a byte for each id of the
    dictionary."""

    __slots__ = ("__weakref__", "_dictionary", "_has")

    def __init__(self, dictionary: TermDictionary) -> None:
        self._dictionary = dictionary
        self._has = bytearray()
        """For each id, 1 if this arena interned it."""
        dictionary.hold(self)

    def id(self, term: Term) -> int:
        """Return the id of ``term``; a new term gets one."""
        found = self._dictionary.transient_id(term)
        if found >= len(self._has):
            self._has.extend(bytes(max(found + 1 - len(self._has), len(self._has))))
        self._has[found] = 1
        return found

    def held_ids(self) -> Sequence[NDArray[Any]]:
        """See `Holder`."""
        return (np.flatnonzero(np.frombuffer(bytes(self._has), np.uint8)),)


class TermDictionary:
    """Maps distinct terms to small integers.

    Law: ``d.term(d.id(t)) == t``; equal terms have equal ids, and an id keeps its meaning while its
    term is pinned or held. Equality is RDF term equality (``"1"^^xsd:integer`` and
    ``"01"^^xsd:integer`` differ).

    `id` pins a term for good. The id from `transient_id` is valid until the next `collect` at which
    no holder reports it. The engine calls `collect` between two batches only, where no code has ids
    in local variables. Without `collect` every term stays.

    Ids are dense and reused. Cost: a dict look-up for each encoded term. A sweep costs a pass over
    the held ids and some Python for each freed term, which is O(1) for each term that came since
    the last sweep. Memory: the pinned terms, and at most the greatest of twice the terms in use, a
    sixteenth of the held ids, and `SWEEP_FLOOR`.
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
        """The id that the next new term gets."""
        self._transient = 0
        self._due = SWEEP_FLOOR
        self._holders: set[ref[Holder]] = set()
        self._tables: set[ref[TermTable]] = set()
        self.reused: list[int] = []
        """Reused ids that got a term since the last sweep, in order: for tables that grow with the
        dictionary."""

    def __len__(self) -> int:
        """Return the number of ids. Every id is less than it; some ids may have no term now."""
        return len(self._terms)

    @property
    def count(self) -> int:
        """The number of terms."""
        return len(self._ids)

    def id(self, term: Term) -> int:
        """Return the id of ``term`` and pin it; a new term gets an id."""
        found = self._ids.setdefault(term, self._next)
        if found == self._next:
            self._give(term, _PINNED)
        elif self._state[found] == _TRANSIENT:
            self._state[found] = _PINNED
            self._transient -= 1
        return found

    def transient_id(self, term: Term) -> int:
        """Return the id of ``term``; a new term gets one that stays while a holder reports it."""
        found = self._ids.setdefault(term, self._next)
        if found == self._next:
            self._give(term, _TRANSIENT)
            self._transient += 1
        return found

    def find(self, term: Term) -> int:
        """Return the id of ``term``, or `NO_TERM`. Adds nothing."""
        return self._ids.get(term, NO_TERM)

    def term(self, id: int) -> Term:
        """Return the term with this id. Raises `ForgottenTerm` if it was freed."""
        found = self._terms[id]
        if found is None:
            raise ForgottenTerm(f"the term with id {id} has been freed")
        return found

    def ids(self, terms: Iterable[Term]) -> Ids:
        """Return the ids of many terms and pin them, shape ``(n,)``."""
        return np.fromiter(map(self.id, terms), np.int32)

    def transient_ids(self, terms: Iterable[Term]) -> Ids:
        """Return transient ids of many terms, shape ``(n,)``."""
        listed = tuple(terms)
        found = list(map(self._ids.get, listed))
        if None in found:
            found = list(map(self.transient_id, listed))
        return np.array(found, np.int32)

    def terms(self, start: int = 0) -> Sequence[Term | None]:
        """Return the terms from id ``start`` on, for tables that grow with the dictionary. A free
        id has None."""
        return self._terms[start:]

    def __getstate__(self) -> dict[str, object]:
        """Return the state for a copy, with the holders and tables that are alive: weak references
        cannot be pickled."""
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
        """Ask ``holder`` for its ids at each sweep, as long as it lives."""
        self._holders.add(ref(holder, self._holders.discard))

    def follow(self, table: TermTable) -> None:
        """Tell ``table`` at each sweep which ids are freed, as long as it lives."""
        self._tables.add(ref(table, self._tables.discard))

    def collect(self) -> int:
        """Free the transient terms that no holder reports, once there are enough new ones. Returns
        how many. Call it between two batches only."""
        return self._sweep() if self._transient >= self._due else 0

    def _give(self, term: Term, state: int) -> None:
        """Give the next id to the new ``term``."""
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
        # Copies, since a thread that reads results may add a holder during the sweep.
        for reference in self._holders.copy():
            holder = reference()
            if holder is not None:
                for ids in holder.held_ids():
                    marked[np.asarray(ids, None if len(ids) else np.int32)] = True
                    rows += len(ids)
        state = np.frombuffer(bytes(self._state), np.uint8)
        marked[:size] |= state == _PINNED
        tables = [table for reference in self._tables.copy() if (table := reference()) is not None]
        # After all holders: what a table implies depends on every id that stays.
        for table in tables:
            marked[table.implied(marked)] = True
        freed_ids = np.flatnonzero((state == _TRANSIENT) & ~marked[:size])
        freed = np.zeros(size + 1, np.bool_)
        freed[freed_ids] = True
        for table in tables:
            table.forget(freed)
        self.reused = []
        self._remove(freed_ids.tolist())
        survivors = self._transient
        self._due = max(SWEEP_FLOOR, 2 * survivors, survivors + (rows + size) // _SHARE)
        return len(freed_ids)

    def _remove(self, ids: Sequence[int]) -> None:
        # In reverse, so that the lowest id is reused first.
        for id in reversed(ids):
            term = self._terms[id]
            assert term is not None
            del self._ids[term]
            self._terms[id] = None
            self._state[id] = _FREE
        self._free.extend(reversed(ids))
        self._transient -= len(ids)
        self._next = self._free[-1] if self._free else len(self._terms)
