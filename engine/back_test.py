"""Back tests: what a query or a request would have given on the samples that are kept.

An engine of its own has the definitions of this one, and gets the kept samples of the streams that
clients publish to, in order of available time. So nothing of the running system changes, and the
answer is that of a request that had begun with the oldest of these samples. It leaves out
user-written processes, which may have effects, and the registered queries, which would cost as much
again; streams that these make are missing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from pyoxigraph import RdfFormat, Store

from ..continuous.columns.budget import UNLIMITED, Budget, Stopped
from ..converters.wire import Incoming
from ..languages.csparql.ast import EventRequest
from ..ontology import graphs
from ..ontology.ontology import Ontology
from ..streams.generator import StreamGenerator
from ..streams.history import FluentStream, Retention
from ..streams.past_queries import Moment
from ..streams.sample import SampleBatch
from ..streams.time import SECOND
from .engine import Engine
from .model.beginning import parse_beginning
from .model.errors import BadArguments, DyknowError
from .model.views import Since
from .processes.registry import Processes

_SLICE: Final = 10 * SECOND
"""Streams come in slices of available time, at least so long."""
_MOST: Final = 10_000
"""Samples of a slice on average, and at most of one stream: between two looks at the clock."""


@dataclass(frozen=True, slots=True)
class Trial:
    """What a back test has read and found.

    ``samples`` with available times from ``since`` to ``until`` (ns; None if there are none) gave
    ``results``, of which ``first`` and ``last`` are valid times. ``is_complete``: it has read all
    that is kept; otherwise its time was over. ``failure`` is the reason why it could not start, or
    why it ended; None if it has not failed.
    """

    since: int | None
    until: int | None
    samples: int
    results: int
    first: int | None
    last: int | None
    is_complete: bool
    failure: str | None


def back_test(
    engine: Engine,
    wanted: str | EventRequest,
    since: str,
    *,
    strategy: str = "fast",
    budget: Budget = UNLIMITED,
    is_over: Callable[[], bool] = lambda: False,
) -> Trial:
    """Evaluate the text of a query, or a request, on what ``engine`` keeps, until time ``is_over``.

    ``since``: ``start``, a time, or a duration before the newest sample of the streams that are
    read. Raises `BadArguments` for another text. Cost: an engine with these ontologies, and that of
    the samples. It leaves cyclic garbage of that size, so a service runs it in a fork.
    """
    begin = parse_beginning(since)
    if begin is Since.NOW:
        raise BadArguments("a back test reads what is kept", "write since=start, a time, or 10m")
    live = {each.name: each for each in engine.published()}
    ontology = Ontology.from_quads(_definitions(engine.ontology.static_store))
    trying = Engine(
        ontology=ontology, processes=Processes(), budget=replace(budget, pauses=_Stops(is_over))
    )
    trial = Trial(None, None, 0, 0, None, None, is_complete=False, failure=None)
    # What left-out queries and processes make is restored as streams without samples.
    ghosts = [each.name for each in trying.published() if each.name not in live]
    for name in ghosts:
        with suppress(DyknowError):
            trying.remove_stream(name)
    try:
        stream, failure = _start(trying, wanted, strategy)
    except DyknowError as error:
        return replace(trial, failure=str(error))
    for name in ghosts:
        if trying.has_stream(name) and trying.generator(name).subscribers:
            return replace(trial, failure=f"it reads stream {name!r}, whose maker is left out")
    found = _Results(trying.generator(stream))
    read = {
        name: source
        for name, source in live.items()
        if trying.has_stream(name) and trying.generator(name).subscribers
    }
    if isinstance(begin, Moment):
        begin = begin.among(source.stream for source in read.values())
    kept = {name: _kept(source.stream, begin) for name, source in read.items()}
    kept = {name: batch for name, batch in kept.items() if len(batch)}
    begun = min((int(each.available[0]) for each in kept.values()), default=None)
    trial = replace(trial, since=begun)
    for name in read:
        source = trying.accepting(name)
        source.lateness = 0  # What is kept is in order.
        source.stream.retention = Retention(samples=1)  # Units keep what they need.
    for name, batch in _parts(kept):
        time = int(batch.available[-1])
        trying.publish(name, _incoming(trying, name, batch), time)
        until = time if trial.until is None else max(trial.until, time)
        trial = replace(trial, until=until, samples=trial.samples + len(batch))
        # Others may have failed, too, such as a unit of a specification.
        failed = failure() if trying.failures else None
        if is_over() or failed is not None:
            return found.told(trial, None if is_over() else failed)
    for name, source in read.items():
        _pass_state(source, trying, name)
    return found.told(replace(trial, is_complete=True), failure() if trying.failures else None)


@dataclass(frozen=True, slots=True)
class _Stops:
    """Pauses that end the evaluation of a window when the time is over."""

    is_over: Callable[[], bool]

    def pause(self) -> None:
        if self.is_over():
            raise Stopped("the time of the back test is over")

    @contextmanager
    def released(self, *, waits: bool = False) -> Iterator[None]:
        yield
        self.pause()


class _Results:
    """Counts the samples of a stream, which keeps some of them only."""

    def __init__(self, output: StreamGenerator) -> None:
        self._count = 0
        self._times: tuple[int, int] | None = None
        output.listen(self)

    def receive(self, source: StreamGenerator, batch: SampleBatch) -> None:
        self._count += len(batch)
        first, last = int(batch.valid.min()), int(batch.valid.max())
        if self._times is not None:
            first, last = min(first, self._times[0]), max(last, self._times[1])
        self._times = first, last

    def ended(self, source: StreamGenerator) -> None:
        pass

    def told(self, trial: Trial, failure: str | None) -> Trial:
        first, last = self._times or (None, None)
        return replace(trial, results=self._count, first=first, last=last, failure=failure)


def _pass_state(source: StreamGenerator, engine: Engine, name: str) -> None:
    """Give the stream of ``engine`` the watermark of ``source``, or end it, or mark it idle."""
    own = engine.generator(name)
    if source.is_ended:
        engine.end(name)
        return
    if source.watermark is not None:
        own.advance(source.watermark)
    if source.is_idle:
        own.fall_idle()


def _kept(stream: FluentStream, begin: Moment | Since) -> SampleBatch:
    return stream.between(begin.time, None) if isinstance(begin, Moment) else stream.all()


def _definitions(store: Store) -> bytes:
    """The quads of an ontology without the queries that run."""
    dumped = store.dump(format=RdfFormat.N_QUADS)
    assert dumped is not None  # None only with an output file
    left_out = f" {graphs.QUERIES} .\n".encode()
    return b"".join(line for line in dumped.splitlines(True) if not line.endswith(left_out))


def _start(
    engine: Engine, wanted: str | EventRequest, strategy: str
) -> tuple[str, Callable[[], str | None]]:
    """Start the query or request; return its stream, and a function that returns its failure."""
    if isinstance(wanted, EventRequest):
        request = engine.request_event(wanted, strategy)
        return request.stream, lambda: engine.event(request.id).failure
    query = engine.queries.register(wanted, strategy=strategy)
    return query.name, lambda: engine.queries.view(query.name).failure


def _parts(kept: Mapping[str, SampleBatch]) -> Iterator[tuple[str, SampleBatch]]:
    """The samples of all streams in order of available time, in slices."""
    begun = dict.fromkeys(kept, 0)
    spans = [int(each.available[-1]) - int(each.available[0]) for each in kept.values()]
    length = max(_SLICE, max(spans, default=0) * _MOST // max(1, sum(map(len, kept.values()))))
    while begun:
        end = length + min(int(kept[name].available[start]) for name, start in begun.items())
        for name, start in tuple(begun.items()):
            batch = kept[name]
            stop = min(int(np.searchsorted(batch.available, end)), start + _MOST)
            if stop > start:
                yield name, batch.take(slice(start, stop))
                begun[name] = stop
            if begun[name] == len(batch):
                del begun[name]


def _incoming(engine: Engine, name: str, batch: SampleBatch) -> Incoming:
    """The samples in the texts of the engine's own stream."""
    pools = engine.accepting(name).stream.pools
    columns = {
        field: column.recoded(pools[field]) if field in pools else column
        for field, column in batch.columns.items()
    }
    return Incoming(SampleBatch(batch.available, batch.valid, columns), stamped=False)
