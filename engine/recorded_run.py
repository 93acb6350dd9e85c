"""`dyknow.run`: a continuous query, monitor or pattern over recorded samples, without a server
(SPEC §8).

An engine of its own reads the recordings as streams, so a run gives the results that the service
gives of the same samples. `dyknow run` prints them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Final, TypeAlias

from ..converters.errors import WireError
from ..converters.objects import object_iri
from ..converters.recordings.given_samples import recording_of
from ..converters.recordings.many_streams import in_order, open_stream
from ..converters.recordings.recording import Recording
from ..converters.recordings.table_options import GUESSED, TableOptions
from ..converters.recordings.time_order import TimeOrder, by_valid_time, in_time_order
from ..converters.wire import Incoming
from ..languages.mtl.checked import Kind
from ..languages.ssl import check_ssl, parse_ssl
from ..languages.ssl.annotation import StreamAnnotation
from ..ontology.errors import OntologyError
from ..ontology.texts.formats import FORMATS
from ..rdf.namespaces import DYKNOW
from ..reasoning.mtl.monitoring import DECIDED, LAST, WITNESS
from ..reasoning.patterns.plans.query import END, START
from ..streams.generator import StreamGenerator
from ..streams.history import Retention
from ..streams.sample import SampleBatch
from ..streams.time import FOREVER, SECOND, parse_time
from .engine import Engine
from .model.errors import NoPlan, NotAnnotated
from .model.views import StreamDeclaration
from .planning.registrations import max_delay_of, parse_registered
from .units.reasoning.monitor import MonitorUnit
from .units.reasoning.pattern import PatternUnit
from .units.sharing.shared_query import QueryInstance

Recorded: TypeAlias = Path | str | Iterable[Mapping[str, Any]]
"""The file of a recording, or samples as dicts: ``valid``, optionally ``available``, and values."""

_SLICE: Final = 10 * SECOND
"""Several streams come in slices of time of this length."""
_KEPT: Final = Retention(samples=1)
"""The units keep what they need, so the streams need no past."""


@dataclass(frozen=True, slots=True)
class Summary:
    """What a run has read and found by now.

    ``samples``: read from all streams. ``results``: samples of the query's stream. ``late``:
    samples that came too late for their stream, or for the evaluation. ``states`` of a formula, and
    its ``verdicts``, whether reported or not: how many are true, false and unknown; None for what
    is no monitor. ``empty``: the reason why there is no result; None if there is one.
    """

    samples: int
    results: int
    late: int
    states: int | None
    verdicts: Mapping[str, int] | None
    empty: str | None


class RunFailed(RuntimeError):
    """A unit of the query failed. The message is its failure."""


def run(
    text: str,
    streams: Mapping[str, Recorded],
    *,
    ssl: str,
    ontology: Iterable[Path | str] = (),
    sort: bool | None = None,
    tables: TableOptions = GUESSED,
) -> RecordedRun:
    """Evaluate a continuous query, monitor or pattern over recorded samples, and yield its results
    as they are decided.

    ``text``: the query. ``streams``: for each name the path of a recording (`open_stream`), or
    dicts with ``valid``, optionally ``available`` (integers in ns, or ISO-8601 texts), and values
    that are bool, int, float, str or None. ``ssl``: what the streams contain. ``ontology``: files
    of domain ontologies.

    Each result is a dict: ``valid`` and ``available`` (int, ns), then the fields of the query's
    stream. Of monitors and patterns objects are IRIs, and the times of states and events int, in
    ns. A monitor gives the verdicts that it reports.

    A monitor or pattern with ``max delay`` takes the samples in order of their available times.
    Anything else takes them in order of valid time, each available when it is valid, so that none
    is late. ``sort``: see `in_time_order`. ``tables``: how files of tables are read. A stream
    without further samples has ended.

    Raises `LanguageError` for the text or the SSL, `NoPlan` if a feature is in no stream,
    `BadArguments`, `UnknownStream`, `NotAnnotated` for a stream that the SSL does not describe,
    `Conflict` or `ConversionError` for fields that do not fit it, `WireError` for bad samples,
    `OntologyError`, and ``OSError`` for a file that cannot be read. Iteration raises `RunFailed`.

    Cost: as in the service. Memory: a chunk of each table, and what the units keep; dicts, and
    tables in Arrow, are held whole.
    """
    query = parse_registered(text)
    has_delay = max_delay_of(query) is not None
    engine = Engine()
    for path in ontology:
        _load_ontology(engine, Path(path))
    checked = check_ssl(parse_ssl(ssl), ssl, engine.ontology.vocabulary)
    described = [one.stream for one in checked if isinstance(one, StreamAnnotation)]
    _check_described(streams, described)
    others = tuple(dict.fromkeys(name for name in described if name not in streams))
    orders = {name: _open(name, given, has_delay, sort, tables) for name, given in streams.items()}
    for name, order in orders.items():
        fields = order.recording.schema.fields
        engine.declare(StreamDeclaration(name, fields, retention=_KEPT, ahead=FOREVER))
    for annotation in checked:
        if not isinstance(annotation, StreamAnnotation) or annotation.stream not in others:
            engine.annotate(annotation.source)
    try:
        view = engine.queries.register(text)
    except NoPlan as error:
        hint = "give a recording that has the feature, and annotate it in the SSL text"
        if others:
            hint += f"; it annotates {', '.join(others)}, of which there is no recording"
        raise NoPlan(error.detail, error.missing, hint) from None
    return RecordedRun(engine, view.name, orders, others)


class RecordedRun(Iterator[dict[str, Any]]):
    """A query over recordings: an iterator of its results, which reads as far as it needs.

    ``orders``: each recording in the order in which it is read. ``unrecorded``: streams that the
    SSL text describes and that have no recording. ``unread``: recordings that the query does not
    need.
    """

    def __init__(
        self,
        engine: Engine,
        name: str,
        orders: Mapping[str, TimeOrder],
        unrecorded: tuple[str, ...],
    ) -> None:
        self.name = name
        self.orders = orders
        self.unrecorded = unrecorded
        self._engine = engine
        self._sources = {stream: engine.generator(stream) for stream in orders}
        self.unread = tuple(n for n, source in self._sources.items() if not source.subscribers)
        self._unit = engine.queries.unit(name)
        self._reported = _Reported(self._unit.output)
        self._batches = self._play()
        self._results = chain.from_iterable(map(self._rows, self._batches))

    def __iter__(self) -> RecordedRun:
        return self

    def __next__(self) -> dict[str, Any]:
        return next(self._results)

    def batches(self) -> Iterator[SampleBatch]:
        """Yield the further samples of the query's stream, as the service has them."""
        return self._batches

    @property
    def summary(self) -> Summary:
        """What was read and found by now."""
        unit = self._unit
        run = unit.monitoring if isinstance(unit, MonitorUnit) else None
        evaluating = unit.template if isinstance(unit, QueryInstance) else unit
        return Summary(
            evaluating.samples,
            unit.output.stream.last_number,
            sum(source.counters.late for source in self._sources.values()) + unit.late,
            None if run is None else run.states,
            None if run is None else dict(run.verdicts),
            self._engine.queries.view(self.name).empty,
        )

    def explain(self) -> str:
        """Describe the plan, and how the query was evaluated by now."""
        return self._engine.explain_running(self.name)

    def _play(self) -> Iterator[SampleBatch]:
        """Publish the recordings, end each after its last sample, and yield what is reported."""
        read = {n: order.recording for n, order in self.orders.items() if n not in self.unread}
        left = {name: recording.rows for name, recording in read.items()}
        now = 0
        for name, incoming in _parts(read):
            now = max(now, int(incoming.batch.available[-1]))
            self._engine.publish(name, incoming, now)
            left[name] -= len(incoming.batch)
            if not left[name]:
                self._engine.end(name)
            yield from self._reported.take()
            self._check()
            if self._unit.output.is_ended:
                return  # a monitor of a single start has its verdict

    def _rows(self, batch: SampleBatch) -> Iterator[dict[str, Any]]:
        convert = self._conversions()
        for available, valid, values in batch.rows():
            told = {
                name: value if value is None or name not in convert else convert[name](str(value))
                for name, value in values.items()
            }
            yield {"valid": valid, "available": available, **told}

    def _conversions(self) -> Mapping[str, Callable[[str], Any]]:
        """What texts of the stream's fields mean, by field."""
        unit = self._unit
        if isinstance(unit, MonitorUnit):
            objects = [name for name, _ in unit.monitoring.monitor.parameters]
            times = [DECIDED, WITNESS, LAST]
        elif isinstance(unit, PatternUnit):
            objects = [each.name for each in unit.query.results if each.kind is Kind.OBJECT]
            times = [START, END]
        else:
            return {}
        iris = dict.fromkeys(objects, lambda name: object_iri(name, DYKNOW))
        return {**iris, **dict.fromkeys(times, parse_time)}

    def _check(self) -> None:
        view = self._engine.queries.view(self.name) if self._engine.failures else None
        if view is not None and view.failure is not None:
            raise RunFailed(view.failure)


class _Reported:
    """Collects the samples of the query's stream, which does not keep them."""

    def __init__(self, output: StreamGenerator) -> None:
        self._batches: list[SampleBatch] = []
        output.listen(self)

    def receive(self, source: StreamGenerator, batch: SampleBatch) -> None:
        self._batches.append(batch)

    def ended(self, source: StreamGenerator) -> None:
        pass

    def take(self) -> list[SampleBatch]:
        """Return the samples since the last call."""
        found, self._batches = self._batches, []
        return found


def _parts(recordings: Mapping[str, Recording]) -> Iterator[tuple[str, Incoming]]:
    """The samples of all recordings in order of available time. One comes in its own chunks."""
    if len(recordings) == 1:
        ((name, recording),) = recordings.items()
        return ((name, incoming) for incoming in recording)
    return in_order(recordings, _SLICE)


def _open(
    name: str, given: Recorded, has_delay: bool, sort: bool | None, tables: TableOptions
) -> TimeOrder:
    """Open a recording in the order in which it is read. Raises `WireError` with the stream."""
    try:
        if isinstance(given, str | Path):
            recording = open_stream(given, name, tables)
        else:
            recording = recording_of(given)
        return in_time_order(recording if has_delay else by_valid_time(recording), sort)
    except WireError as error:
        raise WireError(error.line, f"stream {name}: {error.message}", error.hint) from None


def _load_ontology(engine: Engine, path: Path) -> None:
    format = FORMATS.get(path.suffix.lower())
    if format is None:
        raise OntologyError(
            f"{path} is of an unknown kind", hint=f"name it with one of {', '.join(FORMATS)}"
        )
    text = path.read_text(encoding="utf-8-sig")
    engine.load_ontology(text, name=path.resolve().as_uri(), format=format)


def _check_described(streams: Iterable[str], described: Sequence[str]) -> None:
    for name in streams:
        if name not in described:
            raise NotAnnotated(
                f"the SSL text has no annotation of stream {name!r}",
                f"it annotates {', '.join(described) or 'no stream'}",
            )
