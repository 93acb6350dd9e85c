"""`dyknow.evaluate`: a continuous query over recorded streams, without a server."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Sized
from dataclasses import dataclass
from itertools import chain, groupby, islice
from operator import itemgetter
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import numpy as np
from pyoxigraph import BlankNode, Literal, NamedNode

from ..languages.csparql import parse_query
from ..languages.csparql.ast import ContinuousQuery, Dialect
from ..rdf.dictionary import Term, TermDictionary
from ..rdf.terms_to_columns import TermColumns, columns_of, from_term_columns, from_terms
from ..rdf.timed import TimedTriples, TripleRows
from .algebra.options import Bounds, Options, Report, Semantics
from .estimation.input_rates import Flow, Traffic
from .evaluation.evaluator import ContinuousEvaluator
from .operators.background import Background
from .operators.profile import Profile
from .operators.results import ResultBatch, WindowResult

TimedTerm: TypeAlias = tuple[int, Term, NamedNode, Term]
_BATCH = 4096
"""Elements of an iterator that are read at once."""
_CHUNK = 65_536
"""Elements of a collection that are evaluated at once: windows in bulk cost less."""

_TYPES: tuple[set[type], ...] = (
    {int},
    {NamedNode, BlankNode},
    {NamedNode},
    {NamedNode, BlankNode, Literal},
)
"""The usual types of times, subjects, predicates and objects."""


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
    feeds = [_feed(name, stream, lateness, counts, late) for name, stream in streams.items()]
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
        feed = min(open_feeds, key=_progress)
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
    for feed in sorted(feeds, key=_progress):
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


class _Feed(Protocol):
    """One input stream.

    ``greatest`` is the greatest time read so far, ``watermark`` the time below which nothing else
    comes; None before the first element. ``late`` counts dropped elements.
    """

    name: str
    greatest: int | None
    late: int

    @property
    def watermark(self) -> int | None: ...

    def read(self, dictionary: TermDictionary, until: int | None) -> TimedTriples | None:
        """Return some elements more, in the order of time; None after the last."""


def _progress(feed: _Feed) -> float:
    return -np.inf if feed.watermark is None else feed.watermark


class _Whole:
    """A stream whose elements are all at hand."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.greatest: int | None = None
        self.late = 0

    @property
    def watermark(self) -> int | None:
        return self.greatest


class _Columns(_Whole):
    """Triples in columns already."""

    def __init__(self, name: str, stream: TimedTriples) -> None:
        super().__init__(name)
        self._stream: TimedTriples | None = stream

    def read(self, dictionary: TermDictionary, until: int | None) -> TimedTriples | None:
        stream, self._stream = self._stream, None
        if stream is None:
            return None
        times = [int(table.time.max()) for table in stream.tables if len(table)]
        self.greatest = max(times, default=0)
        return stream if stream.dictionary is dictionary else from_terms(stream, dictionary)


class _Collection(_Whole):
    """A collection of triples, which is sorted by time."""

    def __init__(self, name: str, stream: Iterable[TimedTerm], counts: bool) -> None:
        super().__init__(name)
        self._columns = _in_order_of_time(_checked_columns(tuple(stream)))
        self._counts = counts
        self._next = 0

    def read(self, dictionary: TermDictionary, until: int | None) -> TimedTriples | None:
        times, subjects, predicates, objects = self._columns
        part = slice(self._next, self._next + _CHUNK)
        self._next += _CHUNK
        if not times[part]:
            return None
        self.greatest = int(times[part][-1])
        columns = times[part], subjects[part], predicates[part], objects[part]
        if self._counts:
            return _in_order(tuple(zip(*columns, strict=True)), dictionary)
        return from_term_columns(columns, dictionary)


class _Elements:
    """An iterator of triples, in order of time but for ``lateness``; it is read as late as may
    be."""

    def __init__(
        self,
        name: str,
        stream: Iterable[TimedTerm],
        lateness: int,
        counts: bool,
        report_late: Callable[[TimedTerm], object] | None,
    ) -> None:
        self.name = name
        self.greatest: int | None = None
        self.late = 0
        self._items = iter(stream)
        self._lateness = lateness
        self._counts = counts
        self._report_late = report_late

    @property
    def watermark(self) -> int | None:
        return None if self.greatest is None else self.greatest - self._lateness

    def read(self, dictionary: TermDictionary, until: int | None) -> TimedTriples | None:
        """Return the next elements, up to the first that could close the window at ``until``."""
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
        items.sort(key=itemgetter(0))
        return _in_order(items, dictionary) if self._counts else from_terms(items, dictionary)

    def _exhausted(self) -> bool:
        first = next(self._items, None)
        if first is None:
            return True
        self._items = chain((first,), self._items)
        return False


def _feed(
    name: str,
    stream: Iterable[TimedTerm] | TimedTriples,
    lateness: int | None,
    counts: bool,
    report_late: Callable[[TimedTerm], object] | None,
) -> _Feed:
    if isinstance(stream, TimedTriples):
        return _Columns(name, stream)
    if isinstance(stream, Sized):
        return _Collection(name, stream, counts)
    return _Elements(name, stream, lateness or 0, counts, report_late)


def _checked_columns(items: Sequence[TimedTerm]) -> TermColumns:
    """Return the columns of timed triples. Raises ``TypeError`` (`_checked`)."""
    if not (set(map(type, items)) <= {tuple} and set(map(len, items)) <= {4}):
        items = tuple(map(_checked, items))
    columns = columns_of(items)
    if not all(set(map(type, one)) <= may for one, may in zip(columns, _TYPES, strict=True)):
        for item in items:
            _checked(item)
    return columns


def _in_order_of_time(columns: TermColumns) -> TermColumns:
    times = np.array(columns[0], np.int64)
    if not np.any(times[1:] < times[:-1]):
        return columns
    order = np.argsort(times, kind="stable").tolist()
    in_order: Any = tuple(list(map(column.__getitem__, order)) for column in columns)
    return in_order  # type: ignore[no-any-return]  # mypy does not know columns of several types


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
