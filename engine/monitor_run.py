"""`dyknow.run`: a monitor over recorded streams, without a server (SPEC §8).

An engine of its own reads the recordings as streams, so a run gives the verdicts that the service
gives of the same samples. `dyknow run` prints them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

from ..converters.errors import WireError
from ..converters.recordings.given_samples import recording_of
from ..converters.recordings.many_streams import in_order
from ..converters.recordings.recording import Recording, open_recording
from ..converters.recordings.time_order import TimeOrder, by_valid_time, in_time_order
from ..converters.wire import Incoming
from ..languages.mtl import is_monitor, parse_monitor
from ..languages.ssl import check_ssl, parse_ssl
from ..languages.ssl.annotation import StreamAnnotation
from ..ontology.errors import OntologyError
from ..ontology.formats import FORMATS
from ..reasoning.mtl.monitoring import (
    DECIDED,
    LAST,
    RESULT_FIELDS,
    ROBUSTNESS,
    VERDICT,
    WITNESS,
    WORDS,
)
from ..streams.generator import StreamGenerator
from ..streams.history import Retention
from ..streams.sample import SampleBatch
from ..streams.time import FOREVER, SECOND, parse_time
from .engine import Engine
from .model.errors import BadArguments, NoPlan, NotAnnotated
from .model.views import StreamDeclaration
from .units.monitor import MonitorUnit

Recorded: TypeAlias = Path | str | Iterable[Mapping[str, Any]]
"""The file of a table, or samples as dicts with ``valid``, optionally ``available``, and values."""

_SLICE: Final = 10 * SECOND
"""Several streams come in slices of time of this length."""
_KEPT: Final = Retention(samples=1)
"""The units keep what they need, so the streams need no past."""
_TRUTHS: Final = {word: None if value < 0 else bool(value) for value, word in WORDS.items()}


class Verdict(NamedTuple):
    """A verdict of a monitor, or a run of equal verdicts (``report changes``).

    ``start``: the valid time (ns) of the state at which the formula was started; of a run that of
    its first, and ``last`` that of its last. ``objects``: the objects of the monitor's parameters,
    by their names. ``verdict``: None is unknown. ``decided``: the valid time (ns) of the state that
    decided it. ``witness``: that of the state that bears witness, such as that at which `always`
    fails; None if there is none. ``robustness``: how far the values are from another verdict, in
    the units of the features; None without that option, for an unknown verdict, and where no number
    changes it.
    """

    start: int
    objects: Mapping[str, str]
    verdict: bool | None
    decided: int
    last: int
    witness: int | None = None
    robustness: float | None = None


@dataclass(frozen=True, slots=True)
class Summary:
    """What a run has read by now, and the verdicts, whether reported or not.

    ``samples``: read from all streams. ``states`` of the formula. ``verdicts``: how many are true,
    false and unknown. ``late``: samples that came too late for their stream, or for the state of
    their time. ``empty``: the reason why nothing has been reported; None if something has.
    """

    samples: int
    states: int
    verdicts: Mapping[str, int]
    late: int
    empty: str | None


class MonitorFailed(RuntimeError):
    """A unit of the monitor failed. The message is its failure."""


def run(
    text: str,
    streams: Mapping[str, Recorded],
    *,
    ssl: str,
    ontology: Iterable[Path | str] = (),
    sort: bool | None = None,
) -> MonitorRun:
    """Check recorded streams with a monitor, and yield its verdicts as they are decided.

    ``text``: the monitor; ``with report …`` in it says which verdicts are reported (by default
    those that are false). ``streams``: for each name the path of a table (`open_recording`), or
    dicts with ``valid``, optionally ``available`` (integers in ns, or ISO-8601 texts), and values
    that are bool, int, float, str or None. ``ssl``: what the streams contain. ``ontology``: files
    of domain ontologies.

    A monitor with ``max delay`` takes the samples in order of their available times. Another takes
    them in order of valid time, each available when it is valid, so that none is late. ``sort``:
    see `in_time_order`. A stream without further samples has ended.

    Raises `LanguageError` for the text or the SSL, `BadArguments` for a text that is no monitor,
    `NoPlan` if a feature is in no stream, `NotAnnotated` for a stream that the SSL does not
    describe, `Conflict` or `ConversionError` for fields that do not fit it, `WireError` for bad
    samples, `OntologyError`, and ``OSError`` for a file that cannot be read. Iteration raises
    `MonitorFailed`.

    Cost: as in the service. Memory: a chunk of each table, and what the units keep; dicts, and
    tables in Arrow, are held whole.
    """
    if not is_monitor(text):
        raise BadArguments(
            "the text is no monitor",
            "it begins with `monitor NAME(?x in SORT) = …`; `dyknow.evaluate` takes queries",
        )
    has_delay = parse_monitor(text).policy.max_delay is not None
    engine = Engine()
    for path in ontology:
        _load_ontology(engine, Path(path))
    checked = check_ssl(parse_ssl(ssl), ssl, engine.ontology.vocabulary)
    described = [one.stream for one in checked if isinstance(one, StreamAnnotation)]
    _check_described(streams, described)
    others = tuple(dict.fromkeys(name for name in described if name not in streams))
    orders = {name: _open(name, given, has_delay, sort) for name, given in streams.items()}
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
    return MonitorRun(engine, view.name, orders, others)


class MonitorRun(Iterator[Verdict]):
    """A monitor over recordings: an iterator of its verdicts, which reads as far as it needs.

    ``orders``: each recording in the order in which it is read. ``unrecorded``: streams that the
    SSL text describes and that have no recording. ``unread``: recordings that the monitor does not
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
        self._unit = next(
            unit
            for unit in engine.units()
            if isinstance(unit, MonitorUnit) and unit.output.name == name
        )
        self._reported = _Reported(self._unit.output)
        self._batches = self._play()
        self._verdicts = chain.from_iterable(map(_verdicts, self._batches))

    def __iter__(self) -> MonitorRun:
        return self

    def __next__(self) -> Verdict:
        return next(self._verdicts)

    def batches(self) -> Iterator[SampleBatch]:
        """Yield the further samples of the monitor's stream, as the service has them."""
        return self._batches

    @property
    def summary(self) -> Summary:
        """What was read and decided by now."""
        run = self._unit.monitoring
        late = sum(source.counters.late for source in self._sources.values()) + run.late
        empty = self._engine.queries.view(self.name).empty
        return Summary(self._unit.samples, run.states, dict(run.verdicts), late, empty)

    def explain(self) -> str:
        """Describe the plan, and how the monitor was evaluated by now."""
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
                return  # `once`: the verdict is out

    def _check(self) -> None:
        view = self._engine.queries.view(self.name) if self._engine.failures else None
        if view is not None and view.failure is not None:
            raise MonitorFailed(view.failure)


class _Reported:
    """Collects the samples of the monitor's stream, which does not keep them."""

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


def _verdicts(batch: SampleBatch) -> Iterator[Verdict]:
    for _, start, values in batch.rows():
        objects = {name: str(value) for name, value in values.items() if name not in RESULT_FIELDS}
        last, witness, robustness = (values.get(n) for n in (LAST, WITNESS, ROBUSTNESS))
        yield Verdict(
            start,
            objects,
            _TRUTHS[str(values[VERDICT])],
            parse_time(str(values[DECIDED])),
            start if last is None else parse_time(str(last)),
            None if witness is None else parse_time(str(witness)),
            None if robustness is None else float(robustness),
        )


def _open(name: str, given: Recorded, has_delay: bool, sort: bool | None) -> TimeOrder:
    """Open a recording in the order in which it is read. Raises `WireError` with the stream."""
    try:
        recording = open_recording(given) if isinstance(given, str | Path) else recording_of(given)
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
