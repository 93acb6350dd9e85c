"""Back tests: what a query or a request would have given on the samples that are kept.

An engine of its own has the definitions of this one, and gets the kept samples of the streams that
clients publish to, in order of available time. So nothing of the running system changes, and the
answer is that of a service that had the query all the time. Neither user-written processes nor
queries that run are part of it: processes may have effects, and queries cost as much again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
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


class BackTest:
    """The kept samples of an engine since some moment, to try queries on.

    Make it in the engine's thread, which takes as long as the views of its histories; any thread
    may `run` it, since batches are immutable and the store has its own lock. ``since``: ``start``,
    a time, or a duration before the newest sample. Raises `BadArguments` for another text.
    """

    def __init__(self, engine: Engine, since: str) -> None:
        begin = parse_beginning(since)
        if begin is Since.NOW:
            raise BadArguments(
                "a back test reads what is kept", "write since=start, a time, or 10m"
            )
        streams = {each.name: each.stream for each in engine.published()}
        if isinstance(begin, Moment):
            begin = begin.among(streams.values())
        found = {name: _kept(stream, begin) for name, stream in streams.items()}
        self._kept = {name: batch for name, batch in found.items() if len(batch)}
        self._store = engine.ontology.static_store

    def run(
        self,
        wanted: str | EventRequest,
        strategy: str = "fast",
        budget: Budget = UNLIMITED,
        is_over: Callable[[], bool] = lambda: False,
    ) -> Trial:
        """Evaluate the text of a query, or a request, on the samples, until time ``is_over``."""
        ontology = Ontology.from_quads(_definitions(self._store))
        budget = replace(budget, pauses=_Stops(is_over))
        engine = Engine(ontology=ontology, processes=Processes(), budget=budget)
        begun = min((int(each.available[0]) for each in self._kept.values()), default=None)
        trial = Trial(begun, None, 0, 0, None, None, is_complete=False, failure=None)
        try:
            stream, failure = _start(engine, wanted, strategy)
        except DyknowError as error:
            return replace(trial, failure=str(error))
        found = _Results(engine.generator(stream))
        # A source whose process is not there is no stream.
        kept = {name: batch for name, batch in self._kept.items() if engine.has_stream(name)}
        for name in kept:
            source = engine.accepting(name)
            source.lateness = 0  # What is kept is in order.
            source.stream.retention = Retention(samples=1)  # Units keep what they need.
        for name, batch in _parts(kept):
            until = int(batch.available[-1])
            engine.publish(name, _incoming(engine, name, batch), until)
            trial = replace(
                trial,
                until=until,
                samples=trial.samples + len(batch),
                results=found.count,
                first=found.first,
                last=found.last,
                failure=failure() if engine.failures else None,
            )
            if is_over():
                return replace(trial, failure=None)
            if trial.failure is not None:
                return trial
        return replace(trial, is_complete=True)


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
        self.count = 0
        self.first: int | None = None
        self.last: int | None = None
        output.listen(self)

    def receive(self, source: StreamGenerator, batch: SampleBatch) -> None:
        self.count += len(batch)
        times = int(batch.valid[0]), int(batch.valid[-1])
        self.first, self.last = times[0] if self.first is None else self.first, times[1]

    def ended(self, source: StreamGenerator) -> None:
        pass


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
    """Start what is tried; return its stream, and how to know whether it has failed."""
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
