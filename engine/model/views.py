"""What the engine tells about itself: frozen values for the service, the CLI and tests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from ...rdf.namespaces import DYKNOW
from ...streams.generator import Counters
from ...streams.history import Retention
from ...streams.sample import Field
from ...streams.time import HOUR


class Since(StrEnum):
    """Where the answer to a request begins: with what comes, or with the kept history of the
    streams it reads (SPEC §1: a subscription may begin in the past)."""

    NOW = "now"
    START = "start"


@dataclass(frozen=True, slots=True)
class Totals:
    """How much there is of what people make: ``streams`` that no unit makes, ``templates``,
    ``requests`` (of events, subscriptions, registered queries, inserted units), ``declarations``
    in KPL, ``transformations`` and ``ontologies`` with those of the program."""

    streams: int
    templates: int
    requests: int
    declarations: int
    transformations: int
    ontologies: int


@dataclass(frozen=True, slots=True)
class StreamDeclaration:
    """What a stream is to be: its fields, how late samples may be (ns), how much is kept, the
    namespace of the objects that its id fields name, after how long (ns) without samples nobody
    waits for it (None: everybody always does), and how far ahead (ns) of the clock a sample may be
    stamped (`FOREVER`: any)."""

    name: str
    fields: tuple[Field, ...]
    lateness: int = 0
    retention: Retention = field(default_factory=Retention)
    namespace: str = DYKNOW
    idle: int | None = None
    ahead: int = HOUR


@dataclass(frozen=True, slots=True)
class StreamView:
    """A stream as it is now. Times in ns; ``rate`` in samples a second of available time (over at
    least a second). ``first_available`` is how far the kept history reaches. ``is_idle``: it has
    brought nothing for ``idle``, and nobody waits for it."""

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
    producer: str | None
    subscribers: int


@dataclass(frozen=True, slots=True)
class FailureView:
    """A unit that was cut off: ``stream`` is what it makes, ``asked`` are the requests, queries and
    subscriptions that it answers."""

    unit: str
    stream: str
    asked: tuple[str, ...]
    failure: str


@dataclass(frozen=True, slots=True)
class EvaluationView:
    """How far all is that reads a stream, directly or through others.

    ``last`` is the number of the stream's newest sample, ``evaluated`` that of the newest one with
    which all units that read it are through; those that ``failed`` are not waited for.
    """

    last: int
    evaluated: int
    failed: tuple[FailureView, ...]


@dataclass(frozen=True, slots=True)
class TemplateView:
    """A registered event template; ``name`` is the IRI of its event concept."""

    name: str
    local_name: str
    parameters: tuple[str, ...]
    source: str
    etag: str


@dataclass(frozen=True, slots=True)
class UnitView:
    """A computational unit that a plan uses, with the streams it reads and makes."""

    name: str
    transformation: str
    inputs: tuple[str, ...]
    output: str
    parameters: Mapping[str, str]
    users: int


@dataclass(frozen=True, slots=True)
class PlanView:
    """How a request is met: a tree for people, the existing streams used, the units in the order
    in which samples pass them, and the continuous query as C-SPARQL text (empty for a match)."""

    text: str
    streams: tuple[str, ...]
    units: tuple[UnitView, ...]
    query: str


@dataclass(frozen=True, slots=True)
class EventView:
    """A running request for an event; ``created`` counts requests, 1 being the first.

    ``since`` is `Since`'s text: what of the streams' past the answer began with;
    ``position`` the number of the last sample of ``stream`` before the request. ``waits_for``
    names streams that have no sample yet and are not idle: a query of several streams decides
    nothing before. The next window waits for ``held_back_by``, the streams that are least far;
    ``late`` counts samples that came too late for theirs. ``failure`` says why nothing more comes,
    if so; ``empty`` why there is no sample yet, None once there is one.
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
    failure: str | None = None
    empty: str | None = None


@dataclass(frozen=True, slots=True)
class QueryView:
    """A registered continuous query. ``kind`` is STREAM or QUERY, as the text registers it.

    ``state``: running, failed, ended (all that it reads has), or not restored (of an earlier run;
    then ``stream`` and ``plan`` are None); ``failure`` says why. ``users`` counts who registered
    it. ``origin`` in ns; ``reads`` are the streams that its unit reads, which units may make that
    the plan tells; ``position`` is the number of the stream's last sample,
    ``windows`` how many results are kept, ``last_window`` the end (ns) of the last that closed,
    ``late`` the samples that came too late for theirs. Windows that end before ``watermark`` (ns)
    have closed; the others wait for ``held_back_by``, the streams that are least far.
    ``errors`` counts windows that needed more than they may and have no result; ``empty`` says why
    the stream has no sample yet.
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
    """What semantic matching found for a feature, and why.

    ``cost`` and ``quality`` are those of the plan, None where there is none; ``proven`` says
    whether the strategy's optimum was found and proven. ``specification`` is the plan in XML, None
    where there is no plan or a specification cannot make it.
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
    specification: str | None = None


@dataclass(frozen=True, slots=True)
class DeclarationView:
    """A KPL declaration and what became of it.

    ``name`` is its name, label or key, ``kind`` its first word, ``stream`` the stream it makes or
    names, ``unit`` the process that makes it. ``uses`` are the names of what it needs directly.
    ``counters`` say what became of the samples under a policy (`PolicyCounters`,
    `StateCounters`), how often a source was not read in time, which objects a ``foreach`` or a
    mediation has; ``violations`` names the stream of samples not passed on, once there is one.
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
    """A `cu` that a specification inserted, and what became of it.

    ``name`` is the one it was given, ``text`` its element as XML, ``stream`` and ``unit`` what it
    is at work; None of one of an earlier run that does not hold any more: ``failure`` says why.
    """

    name: str | None
    transformation: str
    text: str
    stream: str | None
    unit: str | None
    failure: str | None


@dataclass(frozen=True, slots=True)
class SpecificationView:
    """What applying a specification changed. ``there`` are units that it speaks of and that ran
    already; ``named`` pairs of a name that it gave and the stream that has it."""

    started: tuple[UnitView, ...]
    stopped: tuple[UnitView, ...]
    there: tuple[UnitView, ...]
    named: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class SubscriptionView:
    """A subscription to ``source`` under a policy; its samples come on ``stream``.

    ``policy`` is KPL text, integers in ms; empty: the stream as it is. ``counters`` and
    ``violations`` as in `DeclarationView`. ``failure`` says why nothing more comes, if so.
    """

    id: str
    source: str
    policy: str
    since: str
    stream: str
    counters: Mapping[str, object]
    violations: str | None
    adaptive: AdaptiveView | None = None
    failure: str | None = None


@dataclass(frozen=True, slots=True)
class AdaptiveView:
    """What an adaptive subscription is to, and how it is.

    ``state`` is `State`'s text; ``reads`` are the streams and sources behind it, ``missing`` what
    would have to be there for one that waits. Times in ns.
    """

    want: str
    strategy: str
    state: str
    failure: str | None
    reads: tuple[str, ...]
    missing: tuple[str, ...]
    staleness: int | None
    quality: float
    hold_off: int
    rematches: int
