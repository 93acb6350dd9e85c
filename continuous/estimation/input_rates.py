"""How much comes in the streams of a query: told, measured, or assumed. `estimates` reads it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from pyoxigraph import NamedNode

from ...rdf.dictionary import Term, TermDictionary
from ...rdf.namespaces import RDF_TYPE
from ...rdf.timed import Kind, TimedTriples
from ...streams.time import SECOND


@dataclass(frozen=True, slots=True)
class Said:
    """What a stream says with one predicate: triples a second, distinct subjects, and distinct
    objects (None: not known, as of numbers)."""

    rate: float
    subjects: float
    objects: float | None = None


SILENCE = Said(0.0, 0.0, 0.0)
ASSUMED_RATE, ASSUMED_SUBJECTS = 1_000.0, 100.0


@dataclass(frozen=True, slots=True)
class Flow:
    """What is known of one stream: samples a second, and how many subjects they are of (None: not
    known, so assumed).

    ``predicates``: what was counted by predicate, by IRI. Where that is None a sample is taken to
    say one triple of each predicate that a query asks for and the static side does not have.
    ``seconds``: how long the stream has been read.
    """

    rate: float | None = None
    subjects: float | None = None
    predicates: Mapping[str, Said] | None = None
    seconds: float | None = None

    def said(self, predicate: str) -> Said:
        """What the stream says with ``predicate``."""
        if self.predicates is not None:
            return self.predicates.get(predicate, SILENCE)
        return self.any

    @property
    def any(self) -> Said:
        """What it says in a sample."""
        rate = ASSUMED_RATE if self.rate is None else self.rate
        return Said(rate, ASSUMED_SUBJECTS if self.subjects is None else self.subjects)

    def __str__(self) -> str:
        said = self.any
        shown = f"{said.rate:.3g}" if said.rate < 100 else f"{said.rate:,.0f}"
        rate = f"{shown} {'sample' if shown == '1' else 'samples'} a second"
        subjects = f"{said.subjects:,.0f} {'subject' if said.subjects == 1 else 'subjects'}"
        match self.rate, self.subjects:
            case None, None:
                return f"{rate} of {subjects} (assumed)"
            case _, None:
                return f"{rate} of {subjects} (the subjects are assumed)"
            case None, _:
                return f"{rate} (assumed) of {subjects}"
            case _:
                return f"{rate} of {subjects}"


NOTHING_KNOWN = Flow()


@dataclass(slots=True)
class _Counted:
    triples: int = 0
    subjects: set[int] = field(default_factory=set)
    objects: set[int] | None = field(default_factory=set)


class Traffic:
    """Counts what comes in one stream, whose terms are of one dictionary.

    Cost: a sort of the ids of a table; memory: the distinct subjects and objects by predicate. It
    holds their terms, so that none is counted twice.
    """

    def __init__(self) -> None:
        self._dictionary: TermDictionary | None = None
        self._rows = 0
        self._at_last = 0
        self._first: int | None = None
        self._last = 0
        self._subjects: set[int] = set()
        self._counted: dict[int, _Counted] = {}

    def add(self, triples: TimedTriples) -> None:
        """Rows that came."""
        if self._dictionary is None:
            self._dictionary = triples.dictionary
            self._dictionary.hold(self)
        times = [table.time for table in triples.tables if len(table)]
        if not times:
            return
        moments = np.concatenate(times)
        first, last = int(moments.min()), int(moments.max())
        self._first = first if self._first is None else min(self._first, first)
        if last > self._last or not self._rows:
            self._last, self._at_last = last, 0
        self._at_last += int(np.count_nonzero(moments == self._last))
        self._rows += len(moments)
        types = triples.dictionary.id(RDF_TYPE)
        for table in triples.tables:
            subjects = set(np.unique(table.subject).tolist())
            self._subjects |= subjects
            if table.sort is not None:
                counted = self._of(types)
                counted.triples += len(table)
                counted.subjects |= subjects
                assert counted.objects is not None
                counted.objects.add(table.sort)
            for predicate, column in table.objects.items():
                counted, there = self._of(predicate), column.present
                counted.triples += int(np.count_nonzero(there))
                counted.subjects |= set(np.unique(table.subject[there]).tolist())
                if column.kind is not Kind.TERM:
                    counted.objects = None
                elif counted.objects is not None:
                    counted.objects |= set(np.unique(column.values[there]).tolist())

    def held_ids(self) -> Iterator[Sequence[int]]:
        """See `dictionary.Holder`."""
        yield list(self._subjects)
        for predicate, counted in self._counted.items():
            yield [predicate, *counted.subjects, *(counted.objects or ())]

    def flow(self) -> Flow | None:
        """What was counted; None before two moments have come, since that is no rate yet."""
        dictionary = self._dictionary
        if dictionary is None or self._first is None or self._last == self._first:
            return None
        seconds = (self._last - self._first) / SECOND
        # What comes at the last moment begins a stretch of which nothing else is seen.
        share = (1 - self._at_last / self._rows) / seconds
        predicates = {
            _iri(dictionary.term(id)): Said(
                counted.triples * share,
                len(counted.subjects),
                None if counted.objects is None else len(counted.objects),
            )
            for id, counted in self._counted.items()
        }
        return Flow(self._rows * share, len(self._subjects), predicates, seconds)

    def _of(self, predicate: int) -> _Counted:
        return self._counted.setdefault(predicate, _Counted())


def _iri(predicate: Term) -> str:
    return predicate.value if isinstance(predicate, NamedNode) else ""
