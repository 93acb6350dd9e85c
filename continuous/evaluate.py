"""Recorded streams through a continuous query, without a server: `dyknow.evaluate`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Sized
from dataclasses import dataclass
from itertools import groupby, islice
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from pyoxigraph import BlankNode, Literal, NamedNode

from ..languages.csparql import parse_query
from ..languages.csparql.ast import ContinuousQuery, Dialect
from ..rdf.dictionary import Term, TermDictionary
from ..rdf.timed import TimedTriples, TripleRows, from_terms
from .algebra.options import Bounds, Options, Report, Semantics
from .estimation.input_rates import Flow, Traffic
from .evaluation.evaluator import ContinuousEvaluator
from .operators.background import Background
from .operators.profile import Profile
from .operators.results import WindowResult

TimedTerm: TypeAlias = tuple[int, Term, NamedNode, Term]
_BATCH = 4096


@dataclass(frozen=True, slots=True)
class Window:
    """A window's result: ``end`` (ns) and what the query gives for it.

    ``solutions``: for SELECT a list of dicts name -> term (unbound names left out), for CONSTRUCT
    a list of triples ``(subject, predicate, object)``, for ASK a bool. ``late``: how many elements
    had been dropped as late by then. ``merged``: the bag was asked for, yet
    equal triples counted once (docs/explanation/semantics.md says where).
    """

    start: int
    end: int
    solutions: list[dict[str, Term]] | list[tuple[Term, NamedNode, Term]] | bool
    late: int = 0
    merged: bool = False


def evaluate(
    query_text: str,
    streams: Mapping[str, Iterable[TimedTerm] | TimedTriples],
    static: Iterable[str | Path] | Mapping[str, str | Path] = (),
    semantics: Semantics | None = None,
    bounds: Bounds = "(]",
    origin: int | None = None,
    lateness: int | None = None,
    report: Report = "non-empty",
    explained: Explained | None = None,
    late: Callable[[TimedTerm], object] | None = None,
) -> Iterator[Window]:
    """The windows of a continuous query over recorded streams, one by one, as they close.

    ``streams`` gives the triples by stream IRI. A collection with a length is sorted by time
    first; an iterator is read lazily, only as far as the next window needs, and an element more
    than ``lateness`` ns (0 unless given) behind the greatest time seen is dropped and counted, and
    ``late`` is called with it as it came. Streams are merged by time; there is no clock here, so
    none is idle: one that says no more has ended. ``static`` are RDF files: a list of what is read
    whatever the query's FROM clauses are, or a mapping from the names of graphs to files, of which
    it reads those of FROM (all if it has none) and FROM NAMED. ``semantics`` is "bag" for C-SPARQL
    and "set" for RSP-QL unless given; ``origin`` is 0; for ``report`` see `options`; ``explained``
    takes how the query was computed. Raises `LanguageError`
    for the text, ``ValueError`` for streams without a window, and when ``streams`` are not those
    that the query's FROM STREAM clauses name (a query without them reads what it is given) or a
    graph is not given, ``TypeError`` for what is no tuple ``(time in ns, subject, predicate,
    object)`` of pyoxigraph's terms.
    """
    query = parse_query(query_text)
    named = {clause.iri for clause in query.streams}
    if named and named != set(streams):
        strange, lacking = sorted(set(streams) - named), sorted(named - set(streams))
        raise ValueError(
            "; ".join(
                [f"the query does not read <{iri}>" for iri in strange]
                + [f"the query reads <{iri}>, which is not given" for iri in lacking]
            )
        )
    usual: Semantics = "set" if query.dialect is Dialect.RSP_QL else "bag"
    options = Options(semantics or usual, bounds, origin or 0, report)
    columns = [given for given in streams.values() if isinstance(given, TimedTriples)]
    dictionary = columns[0].dictionary if columns else TermDictionary()
    evaluator = ContinuousEvaluator(
        query, dictionary, _background(query, static), tuple(streams), options
    )
    if explained is not None:
        explained.attach(evaluator)
    counts = any(window.counted for window in evaluator.schedule.windows)
    feeds = [_Feed(name, given, lateness, counts, late) for name, given in streams.items()]
    return _run(evaluator, feeds, dictionary, explained)


class Explained:
    """How a query is computed: each stage, and what operators cost; as far as `evaluate` has come.

    ``clock`` tells ns (`time.perf_counter_ns`). Costs are estimated from what the streams have
    given; of one that has given nothing yet, from its ``rates`` (samples a second, by IRI), or as
    `input_rates` assumes. Measuring costs about a microsecond an operator, and a sort of the ids of
    what is read.
    """

    def __init__(self, clock: Callable[[], int], rates: Mapping[str, float] | None = None) -> None:
        self._profile = Profile(clock)
        self._told = {name: Flow(rate) for name, rate in (rates or {}).items()}
        self._traffic: dict[str, Traffic] = {}
        self._evaluator: ContinuousEvaluator | None = None

    def attach(self, evaluator: ContinuousEvaluator) -> None:
        """Measure ``evaluator``."""
        evaluator.profile = self._profile
        self._evaluator = evaluator
        self._traffic = {name: Traffic() for name in evaluator.inputs}

    def count(self, name: str, triples: TimedTriples) -> None:
        """Triples came in the stream ``name``."""
        self._traffic[name].add(triples)

    def __str__(self) -> str:
        if self._evaluator is None:
            return ""
        measured = {name: traffic.flow() for name, traffic in self._traffic.items()}
        known = {name: flow for name, flow in measured.items() if flow is not None}
        return self._evaluator.explain(self._told | known)


def _background(
    query: ContinuousQuery, static: Iterable[str | Path] | Mapping[str, str | Path]
) -> Background:
    known = static if isinstance(static, Mapping) else {}
    wanted = (*query.static, *query.static_named) if known else query.static_named
    lacking = [iri for iri in wanted if iri not in known]
    if lacking:
        given = ", ".join(f"<{iri}>" for iri in known) or "no graph with a name"
        raise ValueError(
            f"the query names the graph <{lacking[0]}>, and `static` gives {given}: "
            "give a mapping from the names of graphs to files"
        )
    if not isinstance(static, Mapping):
        return Background.from_files(static)
    default = query.static or tuple(iri for iri in known if iri not in query.static_named)
    used = {iri: known[iri] for iri in dict.fromkeys((*default, *query.static_named))}
    return Background.from_files(used, default)


def _run(
    evaluator: ContinuousEvaluator,
    feeds: Sequence[_Feed],
    dictionary: TermDictionary,
    explained: Explained | None,
) -> Iterator[Window]:
    """Always the feed that is furthest behind goes on."""
    open_feeds = list(feeds)
    batch: TimedTriples | None = None
    while open_feeds:
        batch = None
        dictionary.collect()
        feed = min(open_feeds, key=lambda one: one.progress)
        batch = feed.read(dictionary, evaluator.next_end())
        if batch is None:
            open_feeds.remove(feed)
            results = evaluator.end(feed.name)
        else:
            if explained is not None:
                explained.count(feed.name, batch)
            evaluator.push(feed.name, batch)
            waits = any(one.greatest is None for one in open_feeds)
            # Nothing closes before every stream has been looked at.
            results = [] if waits or feed.watermark is None else _advance(evaluator, open_feeds)
        late = sum(one.late for one in feeds) + evaluator.late
        for result in results:
            yield _window(result, late)


def _advance(evaluator: ContinuousEvaluator, feeds: Sequence[_Feed]) -> list[WindowResult]:
    results: list[WindowResult] = []
    # The least watermark first: it holds the others back even when they are new.
    for feed in sorted(feeds, key=lambda one: one.progress):
        if feed.watermark is not None:
            results.extend(evaluator.advance(feed.name, feed.watermark))
    return results


def _window(result: WindowResult, late: int) -> Window:
    solutions: list[dict[str, Term]] | list[tuple[Term, NamedNode, Term]] | bool
    if result.solutions is not None:
        solutions = result.solutions.rows()
    elif result.triples is not None:
        solutions = [(s, p, o) for _, s, p, o in result.triples]
    else:
        solutions = bool(result.answer)
    return Window(result.start, result.end, solutions, late, result.merged)


class _Feed:
    """One stream on its way in: how far it has come, what was late."""

    def __init__(
        self,
        name: str,
        given: Iterable[TimedTerm] | TimedTriples,
        lateness: int | None,
        counts: bool,
        hear_late: Callable[[TimedTerm], object] | None,
    ) -> None:
        self.name = name
        self.greatest: int | None = None
        self.late = 0
        self.lateness = lateness or 0
        self._counts = counts
        self._hear_late = hear_late
        self._columns = given if isinstance(given, TimedTriples) else None
        self._sorted = isinstance(given, Sized)
        if self._columns is None and self._sorted:
            self._items: Iterator[TimedTerm] = iter(
                sorted(given, key=lambda item: _checked(item)[0])
            )
        else:
            self._items = iter(()) if self._columns is not None else iter(given)

    @property
    def watermark(self) -> int | None:
        if self.greatest is None:
            return None
        return self.greatest if self._sorted else self.greatest - self.lateness

    @property
    def progress(self) -> float:
        return -np.inf if self.watermark is None else self.watermark

    def read(self, dictionary: TermDictionary, until: int | None) -> TimedTriples | None:
        """The next elements, up to the first that could close the window at ``until``."""
        if self._columns is not None:
            columns, self._columns = self._columns, None
            times = [int(table.time.max()) for table in columns.tables if len(table)]
            self.greatest = max(times, default=0)
            if columns.dictionary is dictionary:
                return columns
            return from_terms(list(columns), dictionary)
        taken: list[TimedTerm] = []
        for item in islice(self._items, _BATCH):
            time = _checked(item)[0]
            if self.watermark is not None and time < self.watermark:
                self.late += 1
                if self._hear_late is not None:
                    self._hear_late(item)
                continue
            taken.append(item)
            self.greatest = time if self.greatest is None else max(self.greatest, time)
            if until is None or (self.watermark is not None and self.watermark > until):
                break
        if not taken and self._exhausted():
            return None
        taken.sort(key=lambda item: item[0])
        return _in_order(taken, dictionary) if self._counts else from_terms(taken, dictionary)

    def _exhausted(self) -> bool:
        following = next(self._items, None)
        if following is None:
            return True
        rest = self._items
        self._items = _chain(following, rest)
        return False


def _in_order(taken: Sequence[TimedTerm], dictionary: TermDictionary) -> TimedTriples:
    """A table each time the predicate or the kind of object changes: for windows that count, which
    of two triples of one time came first matters."""
    tables: list[TripleRows] = []
    for _, run in groupby(taken, key=_shape):
        tables.extend(from_terms(run, dictionary).tables)
    return TimedTriples(dictionary, tuple(tables))


def _shape(item: TimedTerm) -> tuple[NamedNode, str]:
    object = item[3]
    return item[2], object.datatype.value if isinstance(object, Literal) else ""


def _chain(first: TimedTerm, rest: Iterator[TimedTerm]) -> Iterator[TimedTerm]:
    yield first
    yield from rest


def _checked(item: Any) -> TimedTerm:
    """``item`` if it is a timed triple; else ``TypeError``, for anything else would only match
    nothing."""
    if not isinstance(item, tuple) or len(item) != 4:
        raise TypeError(f"a timed triple is (time, subject, predicate, object), not {item!r}")
    time, subject, predicate, object = item
    if (
        not isinstance(time, int | np.integer)
        or not isinstance(subject, NamedNode | BlankNode)
        or not isinstance(predicate, NamedNode)
        or not isinstance(object, NamedNode | BlankNode | Literal)
    ):
        raise TypeError(
            "a timed triple is an int in ns and terms of pyoxigraph: "
            f"(time, NamedNode, NamedNode, NamedNode | Literal), not {item!r}"
        )
    return int(time), subject, predicate, object
