"""`dyknow.evaluate`: a continuous query over recorded streams, without a server."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Sized
from dataclasses import dataclass
from itertools import chain, groupby, islice
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
from .operators.results import ResultBatch, WindowResult

TimedTerm: TypeAlias = tuple[int, Term, NamedNode, Term]
_BATCH = 4096


@dataclass(frozen=True, slots=True)
class Window:
    """The result of one window, which ends at ``end`` (ns).

    ``solutions``: for SELECT a list of dicts name -> term (without unbound names), for CONSTRUCT a
    list of triples ``(subject, predicate, object)``, for ASK a bool. ``late``: the number of
    elements dropped as late so far. ``merged``: equal triples counted once although the query has
    bag semantics (docs/explanation/semantics.md lists the cases).
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
    """Yield the windows of a continuous query over recorded streams as they close.

    ``streams``: the triples by stream IRI. A collection with a length is sorted by time first. An
    iterator is read lazily, only as far as the next window needs; an element more than ``lateness``
    ns (default 0) behind the greatest time is dropped and counted, and passed to ``late``. Streams
    are merged by time. There is no clock, so none is idle: a stream without further elements has
    ended.

    ``static``: RDF files. The query reads all files of a list, whatever its FROM clauses. Of a
    mapping from graph names to files it reads those of FROM (all without FROM) and FROM NAMED.

    ``semantics``: by default "bag" for C-SPARQL and "set" for RSP-QL; ``origin``: by default 0;
    ``report``: see `options`; ``explained`` records how the query is computed.

    Raises `LanguageError` for the text. Raises ``ValueError`` for a stream without a window, a
    missing graph, and if the FROM STREAM clauses name other streams than ``streams`` (a query
    without them reads all). Raises ``TypeError`` for an element that is no tuple ``(time in ns,
    subject, predicate, object)`` of pyoxigraph's terms.
    """
    query = parse_query(query_text)
    named = {clause.iri for clause in query.streams}
    if named and named != set(streams):
        unread, missing = sorted(set(streams) - named), sorted(named - set(streams))
        raise ValueError(
            "; ".join(
                [f"the query does not read <{iri}>" for iri in unread]
                + [f"the query reads <{iri}>, which is not given" for iri in missing]
            )
        )
    default: Semantics = "set" if query.dialect is Dialect.RSP_QL else "bag"
    options = Options(semantics or default, bounds, origin or 0, report)
    columns = [stream for stream in streams.values() if isinstance(stream, TimedTriples)]
    dictionary = columns[0].dictionary if columns else TermDictionary()
    evaluator = ContinuousEvaluator(
        query, dictionary, _background(query, static), tuple(streams), options
    )
    if explained is not None:
        explained.attach(evaluator)
    counts = any(window.counted for window in evaluator.schedule.windows)
    feeds = [_Feed(name, stream, lateness, counts, late) for name, stream in streams.items()]
    return _run(evaluator, feeds, dictionary, explained)


class Explained:
    """A record of how `evaluate` computes a query: each stage, and the cost of the operators so
    far.

    ``clock`` returns ns (`time.perf_counter_ns`). Cost estimates use the rates measured so far; for
    a stream without elements, those of ``rates`` (samples a second, by IRI), or else the
    assumptions of `input_rates`. Measuring costs about a microsecond per operator, and a sort of
    the ids of the rows.
    """

    def __init__(self, clock: Callable[[], int], rates: Mapping[str, float] | None = None) -> None:
        self._profile = Profile(clock)
        self._assumed = {name: Flow(rate) for name, rate in (rates or {}).items()}
        self._traffic: dict[str, Traffic] = {}
        self._evaluator: ContinuousEvaluator | None = None

    def attach(self, evaluator: ContinuousEvaluator) -> None:
        """Measure ``evaluator``."""
        evaluator.profile = self._profile
        self._evaluator = evaluator
        self._traffic = {name: Traffic() for name in evaluator.inputs}

    def count(self, name: str, triples: TimedTriples) -> None:
        """Count triples of the stream ``name``."""
        self._traffic[name].add(triples)

    def __str__(self) -> str:
        if self._evaluator is None:
            return ""
        flows = {name: traffic.flow() for name, traffic in self._traffic.items()}
        measured = {name: flow for name, flow in flows.items() if flow is not None}
        return self._evaluator.explain(self._assumed | measured)


def _background(
    query: ContinuousQuery, static: Iterable[str | Path] | Mapping[str, str | Path]
) -> Background:
    by_name = static if isinstance(static, Mapping) else {}
    wanted = (*query.static, *query.static_named) if by_name else query.static_named
    missing = [iri for iri in wanted if iri not in by_name]
    if missing:
        names = ", ".join(f"<{iri}>" for iri in by_name) or "no graph with a name"
        raise ValueError(
            f"the query names the graph <{missing[0]}>, and `static` gives {names}: "
            "give a mapping from the names of graphs to files"
        )
    if not isinstance(static, Mapping):
        return Background.from_files(static)
    default = query.static or tuple(iri for iri in by_name if iri not in query.static_named)
    used = {iri: by_name[iri] for iri in dict.fromkeys((*default, *query.static_named))}
    return Background.from_files(used, default)


def _run(
    evaluator: ContinuousEvaluator,
    feeds: Sequence[_Feed],
    dictionary: TermDictionary,
    explained: Explained | None,
) -> Iterator[Window]:
    """Push batches, always from the feed that is furthest behind, and yield the windows."""
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
            # No window closes before each stream has delivered its first element.
            results = [] if waits or feed.watermark is None else _advance(evaluator, open_feeds)
        late = sum(one.late for one in feeds) + evaluator.late
        for result in results:
            for each in result.windows():
                yield _window(each, late)


def _advance(
    evaluator: ContinuousEvaluator, feeds: Sequence[_Feed]
) -> list[WindowResult | ResultBatch]:
    results: list[WindowResult | ResultBatch] = []
    # The least watermark first: a new stream holds the others back.
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
    """One input stream: its elements, its watermark, its count of late elements."""

    def __init__(
        self,
        name: str,
        stream: Iterable[TimedTerm] | TimedTriples,
        lateness: int | None,
        counts: bool,
        report_late: Callable[[TimedTerm], object] | None,
    ) -> None:
        self.name = name
        self.greatest: int | None = None
        self.late = 0
        self.lateness = lateness or 0
        self._counts = counts
        self._report_late = report_late
        self._columns = stream if isinstance(stream, TimedTriples) else None
        self._sorted = isinstance(stream, Sized)
        if self._columns is None and self._sorted:
            self._items: Iterator[TimedTerm] = iter(
                sorted(stream, key=lambda item: _checked(item)[0])
            )
        else:
            self._items = iter(()) if self._columns is not None else iter(stream)

    @property
    def watermark(self) -> int | None:
        if self.greatest is None:
            return None
        return self.greatest if self._sorted else self.greatest - self.lateness

    @property
    def progress(self) -> float:
        return -np.inf if self.watermark is None else self.watermark

    def read(self, dictionary: TermDictionary, until: int | None) -> TimedTriples | None:
        """Return the next elements, up to the first that could close the window at ``until``."""
        if self._columns is not None:
            columns, self._columns = self._columns, None
            times = [int(table.time.max()) for table in columns.tables if len(table)]
            self.greatest = max(times, default=0)
            if columns.dictionary is dictionary:
                return columns
            return from_terms(list(columns), dictionary)
        items: list[TimedTerm] = []
        for item in islice(self._items, _BATCH):
            time = _checked(item)[0]
            if self.watermark is not None and time < self.watermark:
                self.late += 1
                if self._report_late is not None:
                    self._report_late(item)
                continue
            items.append(item)
            self.greatest = time if self.greatest is None else max(self.greatest, time)
            if until is None or (self.watermark is not None and self.watermark > until):
                break
        if not items and self._exhausted():
            return None
        items.sort(key=lambda item: item[0])
        return _in_order(items, dictionary) if self._counts else from_terms(items, dictionary)

    def _exhausted(self) -> bool:
        first = next(self._items, None)
        if first is None:
            return True
        self._items = chain((first,), self._items)
        return False


def _in_order(items: Sequence[TimedTerm], dictionary: TermDictionary) -> TimedTriples:
    """Return a table per run of equal predicate and kind of object. Counting windows need the order
    of triples of one time, which one table per shape would lose."""
    tables: list[TripleRows] = []
    for _, run in groupby(items, key=_shape):
        tables.extend(from_terms(run, dictionary).tables)
    return TimedTriples(dictionary, tuple(tables))


def _shape(item: TimedTerm) -> tuple[NamedNode, str]:
    object = item[3]
    return item[2], object.datatype.value if isinstance(object, Literal) else ""


def _checked(item: Any) -> TimedTerm:
    """Return ``item`` if it is a timed triple. Raises ``TypeError`` for anything else, which would
    silently match nothing."""
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
