"""The views of the engine: frozen values for the service, the command line and tests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from ...languages.ssl.annotation import Content
from ...matching.render import Step
from ...rdf.namespaces import DYKNOW
from ...streams.generator import Counters
from ...streams.history import Retention
from ...streams.sample import Field
from ...streams.time import HOUR
from ...templates.parameters import ParameterUse


class Since(StrEnum):
    """The beginning of a request's answer: with new samples, or with all retained samples of the
    streams that it reads (SPEC §1: a subscription may begin in the past)."""

    NOW = "now"
    START = "start"


@dataclass(frozen=True, slots=True)
class Totals:
    """Numbers of the things that users make: ``streams`` that no unit makes, ``templates``,
    ``requests`` (events, subscriptions, registered queries, inserted units), KPL ``declarations``,
    ``transformations`` and ``ontologies``, the built-in ones included. Quotas limit them."""

    streams: int
    templates: int
    requests: int
    declarations: int
    transformations: int
    ontologies: int


@dataclass(frozen=True, slots=True)
class StreamDeclaration:
    """The declaration of a stream. ``lateness``: how late (ns) a sample may arrive. ``namespace``:
    that of the objects that id fields name. ``idle``: the time (ns) without samples after which
    readers no longer wait for the stream (None: they always wait). ``ahead``: how far (ns) ahead of
    the clock samples may be stamped (`FOREVER`: any time). ``time_property``: it is a stream of
    RDF, and this property (IRI; empty for none) gives the times of its statements."""

    name: str
    fields: tuple[Field, ...]
    lateness: int = 0
    retention: Retention = field(default_factory=Retention)
    namespace: str = DYKNOW
    idle: int | None = None
    ahead: int = HOUR
    time_property: str | None = None


@dataclass(frozen=True, slots=True)
class StreamView:
    """The present state of a stream. Times in ns; ``rate`` in samples per second of available time
    (over at least a second), 0 of one that has ended. ``first_available`` is the oldest retained
    available time. ``is_idle``: it had no samples for ``idle``, so readers do not wait for it.
    ``contents`` are the features that the annotation gives to fields, and the feature of a
    subscription; ``annotation`` is its text. ``time_property``: as in `StreamDeclaration`."""

    name: str
    fields: tuple[Field, ...]
    namespace: str
    lateness: int
    idle: int | None
    ahead: int
    is_idle: bool
    retention: Retention
    stamped: bool | None
    ended: bool
    counters: Counters
    samples_kept: int
    first_number: int
    last_number: int
    watermark: int | None
    first_available: int | None
    last_available: int | None
    last_valid: int | None
    rate: float
    lag: int | None
    annotation: str | None
    contents: tuple[Content, ...]
    producer: str | None
    subscribers: int
    time_property: str | None


@dataclass(frozen=True, slots=True)
class FailureView:
    """A unit that failed: ``stream`` is its output, ``asked`` are the requests, queries and
    subscriptions that it answers."""

    unit: str
    stream: str
    asked: tuple[str, ...]
    failure: str


@dataclass(frozen=True, slots=True)
class EvaluationView:
    """The progress of all units that read a stream, directly or through others.

    ``last`` is the number of the stream's newest sample. ``evaluated`` is the number up to which
    all units have evaluated it, apart from those that ``failed``.
    """

    last: int
    evaluated: int
    failed: tuple[FailureView, ...]


@dataclass(frozen=True, slots=True)
class TemplateView:
    """A registered event template; ``name`` is the IRI of its event concept. ``doc`` is the comment
    at its beginning, ``window`` that of its query in words (None: a formula)."""

    name: str
    local_name: str
    parameters: tuple[str, ...]
    uses: tuple[ParameterUse, ...]
    doc: str
    window: str | None
    source: str
    etag: str


@dataclass(frozen=True, slots=True)
class UnitView:
    """A computational unit, with its input streams and its output stream."""

    name: str
    transformation: str
    inputs: tuple[str, ...]
    output: str
    parameters: Mapping[str, str]
    users: int


@dataclass(frozen=True, slots=True)
class PlanView:
    """The plan of a request: a printed tree, the existing streams it uses, the units in the order
    in which samples pass them, and the continuous query as C-SPARQL (empty for a match)."""

    text: str
    streams: tuple[str, ...]
    units: tuple[UnitView, ...]
    query: str


@dataclass(frozen=True, slots=True)
class EventView:
    """A running request for an event; ``created`` counts requests, 1 being the first. ``kind`` is
    QUERY, MONITOR or PATTERN, as its template.

    ``since`` is the text of its `Beginning`. ``position`` is the number of the last sample of
    ``stream`` before the request. ``waits_for`` are the input streams without samples that are not
    idle: no window closes before each has one. The next window waits for ``held_back_by``, the
    streams with the least watermark. ``late`` counts samples that arrived after their window
    closed. ``state`` is running, failed, or ended as ``stream`` is. ``failure`` is the reason why
    there are no more results, ``empty`` the reason why there is no sample yet; else None.
    """

    id: str
    event: str
    arguments: tuple[str, ...]
    strategy: str
    since: str
    position: int
    stream: str
    waits_for: tuple[str, ...]
    held_back_by: tuple[str, ...]
    late: int
    plan: PlanView
    created: int
    kind: str
    state: str
    failure: str | None = None
    empty: str | None = None


@dataclass(frozen=True, slots=True)
class QueryView:
    """A registered continuous query. ``kind`` is STREAM or QUERY, as the text registers it.

    ``state``: running, failed, ended (as all its inputs), or not restored (after a restart; then
    ``stream`` and ``plan`` are None); ``failure`` is the reason. ``users`` counts registrations.
    ``origin`` in ns. ``reads`` are the input streams of its unit; the plan shows the units that
    make them. ``position`` is the number of the stream's last sample, ``windows`` the number of
    kept results, ``last_window`` the end (ns) of the last closed window. ``late`` counts samples
    that arrived after their window closed. Windows that end before ``watermark`` (ns) have closed.
    The others wait for ``held_back_by``, the streams with the least watermark. ``errors`` counts
    windows that exceeded their budget and have no result. ``empty`` is the reason why the stream
    has no sample yet.
    """

    name: str
    kind: str
    form: str
    dialect: str
    source: str
    semantics: str
    bounds: str
    origin: int
    report: str
    strategy: str
    since: str
    state: str
    failure: str | None
    users: int
    created: int
    stream: str | None = None
    fields: tuple[Field, ...] = ()
    reads: tuple[str, ...] = ()
    position: int = 0
    waits_for: tuple[str, ...] = ()
    watermark: int | None = None
    held_back_by: tuple[str, ...] = ()
    windows: int = 0
    last_window: int | None = None
    late: int = 0
    errors: int = 0
    last_error: str | None = None
    plan: PlanView | None = None
    empty: str | None = None


@dataclass(frozen=True, slots=True)
class MatchView:
    """The result of semantic matching for a feature, with the reasons.

    ``cost`` and ``quality`` are those of the plan, None without a plan. ``proven``: the plan is
    proven to be the strategy's optimum. ``tree`` has all that was considered. ``specification`` is
    the plan in XML, None without a plan or if XML cannot express it.
    """

    feature: str
    target: str
    strategy: str
    found: bool
    plan: PlanView | None
    alternatives: tuple[str, ...]
    reasons: tuple[str, ...]
    cost: float | None
    quality: float | None
    proven: bool
    tree: Step
    specification: str | None = None


@dataclass(frozen=True, slots=True)
class DeclarationView:
    """A KPL declaration and the state of its process.

    ``name`` is its name, label or key, ``kind`` its first word, ``stream`` the stream it makes or
    names, ``unit`` the process that makes it. ``uses`` are the declarations that it needs directly.
    ``counters`` are those of a policy or synchronization (`PolicyCounters`, `StateCounters`), the
    missed readings of a source, or the objects of a ``foreach`` or mediation. ``violations`` names
    the stream of samples that the policy refused, once it exists.
    """

    name: str
    kind: str
    text: str
    stream: str | None
    unit: str | None
    uses: tuple[str, ...]
    failure: str | None
    errors: int
    restarts: int
    last_error: str | None
    counters: Mapping[str, object]
    violations: str | None


@dataclass(frozen=True, slots=True)
class InsertionView:
    """A `cu` that a specification inserted, and its unit.

    ``name`` is that in the specification, ``text`` its element as XML. ``stream`` and ``unit`` are
    None if it could not be restored after a restart; ``failure`` is the reason.
    """

    name: str | None
    transformation: str
    text: str
    stream: str | None
    unit: str | None
    failure: str | None


@dataclass(frozen=True, slots=True)
class SpecificationView:
    """The changes by a specification. ``there`` are its units that ran already; ``named`` are pairs
    of a name in the specification and the stream that has it."""

    started: tuple[UnitView, ...]
    stopped: tuple[UnitView, ...]
    there: tuple[UnitView, ...]
    named: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class SubscriptionView:
    """A subscription to ``source`` under a policy; ``stream`` has its samples.

    ``policy`` is KPL with integers in ms; empty: the unchanged stream. ``counters`` and
    ``violations`` as in `DeclarationView`. ``state`` is running, failed, or ended as ``stream`` is;
    ``failure`` is the reason why there are no more samples.
    """

    id: str
    source: str
    policy: str
    since: str
    stream: str
    counters: Mapping[str, object]
    violations: str | None
    adaptive: AdaptiveView | None = None
    state: str = "running"
    failure: str | None = None


@dataclass(frozen=True, slots=True)
class AdaptiveView:
    """The want of an adaptive subscription, and its state.

    The want as a text and in parts: the ``feature`` of every object of a ``sort``, or of
    ``objects``; names in short.
    ``state`` is the text of a `State`. ``reads`` are the streams and sources that it reads at
    present, ``missing`` the missing features while it waits for a plan. Times in ns.
    """

    want: str
    feature: str
    sort: str | None
    objects: tuple[str, ...]
    strategy: str
    state: str
    failure: str | None
    reads: tuple[str, ...]
    missing: tuple[str, ...]
    staleness: int | None
    quality: float
    hold_off: int
    rematches: int
