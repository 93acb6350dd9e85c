"""The engine: the one face of the running system for the service, the CLI and tests.

Every method is synchronous and runs to its end; callers see to it that only one runs at a time.
Time comes in as an argument (`publish`, `tick`); nothing here reads a clock.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from ..continuous.columns.budget import UNLIMITED, Budget
from ..converters.objects import object_iri
from ..converters.to_triples import SampleConverter, node_names
from ..converters.wire import Incoming
from ..languages.csparql import parse_argument, parse_event_request
from ..languages.csparql.ast import EventRequest, Template
from ..languages.kpl import parse_policy
from ..languages.specification import Specification, parse_specification
from ..languages.ssl.annotation import CheckedAnnotation, StreamAnnotation
from ..matching.uncollected import uncollected
from ..ontology.ontology import Ontology, PreparedOntology
from ..ontology.reading import TextFormat
from ..rdf.dictionary import TermDictionary
from ..rdf.namespaces import DYKNOW, PREFIXES, shorten
from ..streams.generator import StreamGenerator
from ..streams.instants import places_in_instants
from ..streams.rules import INSTANTS
from ..streams.sample import SampleBatch
from ..streams.time import SECOND, TIME_MIN
from ..templates.library import (
    NoSuchTemplate,
    TemplateExists,
    TemplateLibrary,
    TemplateRefused,
)
from ..templates.transformations import event_transformation
from .catalog.annotations import Annotations
from .catalog.declared_streams import DeclaredStreams
from .catalog.iri_annotations import DescribedStream, DescribedTransformation
from .catalog.name_resolution import (
    checked_strategy,
    checked_want,
    did_you_mean,
    iri_of,
)
from .catalog.registered_transformations import (
    RegisteredTransformations,
    check_quality,
)
from .catalog.semantics_manager import SemanticsManager
from .catalog.transformation_library import Transformations
from .configuration.configuration import C_SPARQL, Configuration
from .configuration.idle_streams import Idleness
from .configuration.ingest import Intake
from .kpl.application import Application
from .kpl.declarations import KplDeclarations
from .model.beginning import beginning_of
from .model.errors import (
    AlreadyExists,
    BadArguments,
    Conflict,
    Refused,
    UnknownEvent,
    UnknownTemplate,
)
from .model.status_changes import Change, ChangeKind, KnownTransformation
from .model.status_stream import RETENTION, SCHEMA, STATUS, StatusStream
from .model.stream_statistics import rate_of, stream_view
from .model.views import (
    DeclarationView,
    EvaluationView,
    EventView,
    FailureView,
    InsertionView,
    MatchView,
    Since,
    SpecificationView,
    StreamDeclaration,
    StreamView,
    SubscriptionView,
    TemplateView,
    Totals,
)
from .planning import explain as explanations
from .planning.plan_execution import Plans
from .processes.external_io import Outcome
from .processes.registry import PROCESSES, Processes
from .processes.supervision import DIRECT, Runner
from .requests.adaptive_subscription import Rematch, Wish
from .requests.continuous_queries import RegisteredQueries
from .requests.event_requests import EventRequests
from .requests.rematching import Rematching
from .requests.subscriptions import Subscriptions
from .specification.apply import Specifications
from .specification.plan_text import plan_text
from .units.backlog import Behind, Turns, Went
from .units.base import ComputationalUnit
from .units.windowed import WindowUnit
from .units.work_time import BusyTime, Stopwatch
from .users import Users

AnyUnit = TypeVar("AnyUnit", bound=ComputationalUnit)


class Engine:
    """Streams, templates and event requests over one ontology.

    ``data`` is the directory of what outlives the process (None: in memory). ``epoch`` marks
    this run in event ids. ``first_reserved`` is the first N of ``dyknow_reserved<N>``. ``now`` is
    the time in ns until `publish` and `tick` bring a later one. ``processes`` are the user-written
    ones that KPL may name, and ``runner`` calls them. ``ontology`` is taken instead of one in
    ``data``. With a ``stopwatch`` the work of units is measured. ``budget``
    is what a window of a continuous query may cost. With ``turns`` windows close in `go_on` only.
    By the ``rules`` (`Rules.version`) it restores what an earlier run was told.
    """

    def __init__(
        self,
        data: Path | None = None,
        *,
        epoch: str | None = None,
        first_reserved: int = 1,
        now: int = 0,
        processes: Processes = PROCESSES,
        runner: Runner = DIRECT,
        ontology: Ontology | None = None,
        stopwatch: Stopwatch | None = None,
        budget: Budget = UNLIMITED,
        turns: Turns | None = None,
        rules: int = INSTANTS,
    ) -> None:
        self.epoch = epoch or secrets.token_hex(4)
        if ontology is None:
            ontology = Ontology.open(None if data is None else data / "ontology")
        self.ontology = ontology
        self.dictionary = TermDictionary()
        self._now = now
        self.failures = 0
        """Number of failures on the status stream: while it stays, nothing more has failed."""
        self._counted = TIME_MIN
        self._measured: int | None = None
        status = StatusStream(lambda: self._now)
        self._changed = status.tell
        self._transformations = Transformations(self.ontology.vocabulary, processes)
        busy_time = None if stopwatch is None else BusyTime(stopwatch)
        self.behind = Behind(turns)
        """Units whose windows take long, if there are ``turns`` for them."""
        self._configuration = Configuration(self._changed, first_reserved, busy_time, self.behind)
        self.rules = self._configuration.rules
        """The rules of commands; recovery changes them."""
        self.rules.version = rules
        self._manager = SemanticsManager(self.ontology, self._subscribers)
        self._configuration.annotations = self._manager.annotations
        self.intake = Intake(self._configuration)
        self._idleness = Idleness()
        self._converters: dict[str, SampleConverter] = {}
        status.listen(self._manager.changed)
        status.listen(self._heard)
        self._declared = DeclaredStreams(
            self.ontology, self.dictionary, self._configuration, self._changed
        )
        self.transformations = RegisteredTransformations(
            self.ontology,
            self._transformations,
            self._configuration,
            self._changed,
            self._declared.check_name,
            self._manager.together,
        )
        self._annotations = Annotations(
            self.ontology,
            self._declared,
            self.transformations,
            self._transformations,
            self._changed,
        )
        self._templates = TemplateLibrary(self.ontology)
        self._plans = Plans(
            self.ontology,
            self.dictionary,
            self._transformations,
            self._configuration,
            self._manager.space,
            self._changed,
            runner,
            budget,
        )
        status.listen(self._plans.heard)
        self._requests = EventRequests(
            self.ontology,
            self.dictionary,
            self._templates,
            self._configuration,
            self._plans,
            self._manager.space,
            self._changed,
        )
        self.queries = RegisteredQueries(
            self.ontology,
            self.dictionary,
            self._templates,
            self._configuration,
            self._plans,
            self._manager.space,
            self._declared,
            self._changed,
            self._converter,
        )
        self._application = Application(
            self._configuration,
            processes,
            runner=runner,
            check_name=self._declared.check_name,
            forget=self._declared.forget_annotation,
        )
        self._kpl = KplDeclarations(self.ontology, self._application, self._changed)
        self._subscriptions = Subscriptions(self._configuration)
        self._rematching = Rematching(
            self.ontology,
            self.dictionary,
            self._configuration,
            self._plans,
            self._manager.space,
            lambda: self._now,
            self._subscriptions.adapted,
        )
        self._subscriptions.rematch_with(self._rematching)
        status.listen(self._rematching.heard)
        self._specifications = Specifications(
            self.ontology,
            self._transformations,
            self._configuration,
            self._plans,
            self._subscriptions,
            self._changed,
            check_name=self._declared.check_name,
            users=Users(self._requests, self.queries, self._subscriptions, self._kpl),
        )
        status.listen(self._specifications.heard)
        status.open(self._configuration.add_stream(STATUS, SCHEMA, retention=RETENTION))
        self.transformations.tell_all()
        for event, reason in self._templates.broken.items():
            self._changed(Change(ChangeKind.NOT_RESTORED, shorten(event), specification=reason))
        self.transformations.restore()
        self._tell_templates()
        self._declared.restore_streams()
        for generator in self._configuration.streams.values():
            self._idleness.came(generator, now)
        # Policies depend on the annotations of the streams that they read.
        with self._manager.together():
            self._kpl.restore(self._annotations.restore_of)
        # Queries read streams that are declared, annotated, specified, and each other's; what is
        # said of their own streams, and specifications that read these, wait for them.
        self._annotations.restore(later=self.queries.recall())
        with self._manager.together():
            self.queries.restore(self._annotations.restore_of)
            self._specifications.restore()
            self.queries.restore(self._annotations.restore_of)
        self.queries.tell_lost()

    @property
    def now(self) -> int:
        """The latest time (ns) that it was told."""
        return self._now

    # -- streams -----------------------------------------------------------------------------

    def declare(self, declaration: StreamDeclaration) -> StreamView:
        """Make a stream, or change one that nobody has used yet; see `DeclaredStreams`."""
        if self._configuration.streams.get(declaration.name) is not None:
            self._refuse_if_source(declaration.name, declaration)
        generator = self._declared.declare(declaration)
        self._idleness.came(generator, self._now)
        return self._view(generator)

    def annotate(self, ssl: str) -> tuple[CheckedAnnotation, ...]:
        """Annotate streams and transformations by an SSL text; see `Annotations`."""
        with self._manager.together():
            annotated = self._annotations.annotate(ssl)
            self._settle()
        return annotated

    def describe_all(
        self,
        described: Sequence[DescribedStream],
        transformations: Sequence[DescribedTransformation] = (),
    ) -> tuple[CheckedAnnotation, ...]:
        """Annotate streams and transformations in names, all of them or none; see `Annotations`."""
        with self._manager.together():
            annotations = self._annotations.describe_all(described, transformations)
            self._settle()
        return annotations

    def set_quality(self, stream: str, quality: float) -> None:
        """How good a stream is now (0..1); raises `UnknownStream` and `BadArguments`."""
        self._annotations.set_quality(stream, quality)
        self._settle()

    def annotations(self) -> tuple[CheckedAnnotation, ...]:
        """Every annotation in force: streams first, then transformations."""
        return self._annotations.all()

    def streams(self) -> tuple[StreamView, ...]:
        """All streams, the status stream among them."""
        return tuple(self._view(generator) for generator in self._configuration.streams.values())

    def stream(self, name: str) -> StreamView:
        """One stream; raises `UnknownStream`."""
        return self._view(self._configuration.stream(name))

    def has_stream(self, name: str) -> bool:
        """Whether there is a stream of this name already; none is made by asking."""
        return self._configuration.has(name)

    def before_demand(self, check: Callable[[], None]) -> None:
        """Call ``check`` before a stream comes into being because somebody asks for it (of late
        samples, of violations), in whatever way; what it raises is what who asks gets."""
        self._configuration.before_demand = check

    def published(self) -> tuple[StreamGenerator, ...]:
        """The streams that people publish to."""
        there = self._configuration.streams.items()
        return tuple(each for name, each in there if not self._configuration.is_made(name))

    def generators(self) -> tuple[StreamGenerator, ...]:
        """What is behind all streams: for who wants less of each than a view. Cost: O(streams)."""
        return tuple(self._configuration.streams.values())

    def units(self) -> tuple[ComputationalUnit, ...]:
        """All units that run, to read what they count. Cost: O(units)."""
        return tuple(self._configuration.units.values())

    def generator(self, name: str) -> StreamGenerator:
        """The generator behind a stream, to read and subscribe; raises `UnknownStream`."""
        return self._configuration.stream(name)

    def accepting(self, name: str) -> StreamGenerator:
        """The generator of a stream that takes samples; raises `UnknownStream`, and `Refused` for
        a stream that the system makes."""
        return self.intake.accepting(name)

    def on_opened(self, heard: Callable[[str], None]) -> None:
        """Tell ``heard`` of streams that come into being by being asked for: of late samples, of
        violations."""
        self._configuration.on_opened = heard

    def remove_stream(self, name: str) -> None:
        """Forget a declared stream and its annotation, or one of late samples, which are then only
        counted again; raises `UnknownStream`, `Refused` for another that the system makes, and
        `Conflict` while a unit or KPL needs it."""
        if name not in self._configuration.late:
            name = self.accepting(name).name
        self._refuse_if_source(name)
        self._rematching.withdraw(name)
        self._declared.remove(name)
        self._settle()

    def publish(
        self,
        name: str,
        incoming: Incoming,
        now: int,
        idempotency_key: str | None = None,
        digest: bytes = b"",
    ) -> int:
        """Take a batch into a stream, whole; returns how many samples were accepted.

        A key that was used for this stream before has no second effect and gives the same answer;
        with another ``digest`` of what was sent it is a `Conflict`. So is a batch to be stamped on
        arrival where samples brought their own available times, and the other way round: the one
        would make all of the other late.
        """
        before, self._now = self._now, max(self._now, now)
        try:
            accepted = self.intake.publish(name, incoming, now, idempotency_key, digest)
        except Exception:
            self._now = before
            raise
        generator = self._configuration.stream(name)
        self._idleness.came(generator, self._now)
        self._rematching.came(generator.name, self._now)
        self._settle()
        self._collect()
        return accepted

    def end(self, name: str) -> None:
        """A recording has come to its end: what waits for more samples is decided now."""
        generator = self.accepting(name)
        generator.end()
        self._changed(Change(ChangeKind.STREAM_ENDED, generator.name))
        self._settle()
        self._collect()

    def tick(self, now: int) -> None:
        """The time is ``now``: streams that are stamped on arrival have nothing before it, others
        may have fallen idle."""
        self._now = max(self._now, now)
        self._application.tick(now)
        self._plans.tick(now)
        units = self._configuration.units
        for generator in list(self._configuration.streams.values()):
            if generator.stamped and generator.name not in units and not generator.is_ended:
                generator.advance(now)
        self._idleness.tick(tuple(self._configuration.streams.values()), self._now)
        for unit in list(units.values()):
            waiting = unit.waits_for
            if not waiting:
                continue
            # Where everything that has come was stamped on arrival, so will be what is to come.
            begun = set(unit.inputs).difference(waiting)
            if begun and all(self._configuration.is_stamped(source) for source in begun):
                for source in waiting:
                    unit.advance(source, now)
        self._rematching.tick(self._now)
        self._settle()
        self._collect()
        self.ontology.advance()
        if now - SECOND >= self._counted:
            self._counted = now
            self._count_subscribers()

    def go_on(self, *, new: bool = False, begins: bool = True) -> tuple[Went, ...]:
        """Close windows of units that are behind, see `Behind.go_on`; what was done."""
        done = tuple(self.behind.go_on(new=new, begins=begins))
        if done:
            self._settle()
            self._collect()
        return done

    def behind_of(self, stream: str) -> tuple[WindowUnit, ...]:
        """The units that are behind and read ``stream``, themselves or through other units."""
        units = [unit for unit in self.behind.units if isinstance(unit, WindowUnit)]
        return self._readers(units, stream)

    def _readers(self, units: Iterable[AnyUnit], stream: str) -> tuple[AnyUnit, ...]:
        """Those of ``units`` that read ``stream``, themselves or through other units."""
        return tuple(
            unit
            for unit in units
            if any(
                source.name == stream
                for one in self._configuration.units_behind(unit)
                for source in one.inputs
            )
        )

    def failure_of(self, generator: StreamGenerator) -> str | None:
        """Why nothing more comes in a stream: what feeds it has failed. None while something may.
        See `Configuration.failure_of`."""
        unit = self._configuration.units.get(generator.name)
        if unit is None or unit.output is not generator:
            return None
        return self._configuration.failure_of(unit)

    def failed(self) -> tuple[FailureView, ...]:
        """The units that were cut off. Cost: O(units), and for each failure O(requests)."""
        return self._failed(self._configuration.units.values())

    def evaluation(self, name: str) -> EvaluationView:
        """How far all is that reads stream ``name``; raises `UnknownStream`. Cost: O(units²)."""
        generator = self._configuration.stream(name)
        stream, evaluated = generator.stream, generator.stream.last_number
        readers = self._readers(self._configuration.units.values(), generator.name)
        for unit in self.behind_of(generator.name):
            through = unit.output.watermark
            number = 0 if through is None else stream.number_before(through)
            evaluated = min(evaluated, number, stream.last_number - 1)
        return EvaluationView(stream.last_number, evaluated, self._failed(readers))

    def _failed(self, units: Iterable[ComputationalUnit]) -> tuple[FailureView, ...]:
        found = []
        for unit in units:
            if unit.failure is not None:
                stream = unit.output.name
                asked = (
                    *self._requests.of_stream(stream),
                    *self.queries.of_stream(stream),
                    *self._subscriptions.of_stream(stream),
                )
                found.append(FailureView(unit.name, stream, asked, unit.failure))
        return tuple(found)

    def go_on_again(self, done: Sequence[Went]) -> None:
        """Do what `go_on` did; raises ``ValueError`` where there is no such thing to do."""
        self.behind.again(done)
        self._settle()
        self._collect()

    def _collect(self) -> None:
        # What is half done holds terms that nobody knows of.
        if not self.behind.is_within:
            self.dictionary.collect()

    def measure(self) -> None:
        """Let SPARQL see the rates and subscribers there are: whoever asks calls this before.

        Rates change all the time, so they are mirrored when somebody wants to know, at most once a
        second. Cost: a look at each stream, and what changed.
        """
        if self._measured is not None and self._now - self._measured < SECOND:
            return
        self._measured = self._now
        streams = tuple(self._configuration.streams.items())
        with uncollected(), self._manager.together():
            self._count_subscribers()
            self._manager.measure_rates((name, rate_of(each)) for name, each in streams)
            self._manager.show_samples(streams)

    def rdf_of(self, name: str, batch: SampleBatch) -> list[str]:
        """Each sample of stream ``name`` as N-Triples; empty text where it says nothing."""
        converter = self._converter(name)
        if converter is None or not len(batch):
            return [""] * len(batch)
        lines: list[list[str]] = [[] for _ in range(len(batch))]
        names = node_names(batch.available, places_in_instants(batch.available))
        # Rows stand for times, since samples of one instant share theirs.
        numbered = batch.with_available(np.arange(len(batch)))
        for row, subject, predicate, object in converter.convert(numbered, names):
            lines[row].append(f"{subject} {predicate} {object} .")
        return ["\n".join(triples) for triples in lines]

    # -- templates ---------------------------------------------------------------------------

    def register_template(self, text: str, *, replace: bool = False) -> TemplateView:
        """Register an event template; its event concept is known from now on.

        Raises `LanguageError`, and `AlreadyExists` unless ``replace``.
        """
        try:
            template = self._templates.register(text, replace=replace)
        except TemplateExists as error:
            raise AlreadyExists(
                f"there is a template {shorten(error.name)}", "replace it with PUT, or remove it"
            ) from error
        except TemplateRefused as error:
            raise Refused(error.message, error.hint) from error
        self._tell_templates()
        self._settle()
        return self._template_view(template)

    def templates(self) -> tuple[TemplateView, ...]:
        """All templates, by name."""
        return tuple(self.template(name) for name in self._templates.names())

    def template(self, name: str) -> TemplateView:
        """One template by local name, prefixed name or IRI; raises `UnknownTemplate`."""
        return self._template_view(self._template(name))

    def remove_template(self, name: str) -> None:
        """Forget a template; raises `UnknownTemplate`, and `Conflict` while a request uses it."""
        template = self._template(name)
        users = self._requests.of_event(template.name)
        if users:
            raise Conflict(
                f"template {shorten(template.name)} is used by request {', '.join(users)}",
                "cancel the requests first",
            )
        self._templates.remove(name)
        self._requests.forget(template)
        self._changed(
            Change(ChangeKind.TRANSFORMATION_REMOVED, transformation=shorten(template.name))
        )

    # -- events ------------------------------------------------------------------------------

    def parse_request(self, text: str) -> EventRequest:
        """``dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)``; raises `LanguageError`."""
        return parse_event_request(text, PREFIXES)

    def make_request(self, event: str, arguments: Sequence[str]) -> EventRequest:
        """The same from parts, each argument as text; raises `LanguageError`."""
        parsed = tuple(parse_argument(argument, PREFIXES) for argument in arguments)
        return EventRequest(iri_of(event), parsed, f"{event}({', '.join(arguments)})")

    def request_event(
        self, request: EventRequest, strategy: str = "fast", since: str = Since.NOW
    ) -> EventView:
        """Find or build the streams that answer the request, and start what is needed.

        The same request again shares stream and units. With ``since`` ``start`` the answer begins
        with the kept history of the streams that are read; with a time (as `read_time` has it) or a
        duration before the newest sample of them all, with what was available then or later. Raises
        `UnknownEvent`, `BadArguments`, `NoPlan`, and `Forgotten` where some of that is not kept;
        then nothing runs that did not run before.
        """
        begin = beginning_of(since)
        return self._requests.start(self._event_template(request), request, strategy, begin)

    def events(self) -> tuple[EventView, ...]:
        """The running requests, oldest first."""
        return self._requests.views()

    def event_ids(self) -> tuple[str, ...]:
        """Those of the running requests, oldest first."""
        return self._requests.ids()

    def event(self, id: str) -> EventView:
        """One running request; raises `UnknownRequest`."""
        return self._requests.view(id)

    def cancel_event(self, id: str) -> None:
        """End a request; units without users stop."""
        self._requests.cancel(id)

    # -- subscriptions -----------------------------------------------------------------------

    def subscribe(
        self,
        stream: str,
        policy: str = "",
        unit: str = "ms",
        since: str = Since.NOW,
        *,
        keyed: bool = True,
    ) -> SubscriptionView:
        """Subscribe to a stream under a policy; see `Subscriptions.start`. For ``since`` see
        `request_event`."""
        return self._subscriptions.start(stream, policy, unit, beginning_of(since), keyed=keyed)

    def subscribe_to_feature(
        self,
        feature: str,
        *,
        sort: str | None = None,
        objects: Sequence[str] = (),
        strategy: str = "fast",
        policy: str = "",
        unit: str = "ms",
        since: str = Since.NOW,
        staleness: int | None = None,
        quality: float = 0.0,
        hold_off: int = 2 * SECOND,
        keyed: bool = True,
    ) -> SubscriptionView:
        """Subscribe to a feature of objects or a sort, whatever streams hold it ([Introspection15
        §4.4]); see `Wish`. What cannot be met now waits until it can. Raises `UnknownFeature`,
        `BadArguments` and `LanguageError`."""
        want = checked_want(self.ontology.vocabulary, feature, sort, objects)
        checked_strategy(strategy)
        check_quality(quality)
        if min(hold_off, hold_off if staleness is None else staleness - 1) < 0:
            raise BadArguments("staleness is longer than nothing, hold_off not less than nothing")
        parsed = parse_policy(policy, unit)
        begin = beginning_of(since)
        wish = Wish(want, strategy, parsed, begin, staleness, quality, hold_off, keyed)
        with self._manager.together():
            return self._subscriptions.start_adaptive(wish)

    def rematches(self, id: str) -> Sequence[Rematch]:
        """The switches of a subscription, oldest first; raises `UnknownRequest`. What is given
        holds later ones, too, as they come."""
        return self._subscriptions.rematches(id)

    def subscriptions(self) -> tuple[SubscriptionView, ...]:
        """The subscriptions that run, oldest first."""
        return self._subscriptions.views()

    def subscription_ids(self) -> tuple[str, ...]:
        """Those of the subscriptions that run, oldest first."""
        return self._subscriptions.ids()

    def subscription(self, id: str) -> SubscriptionView:
        """One subscription; raises `UnknownRequest`."""
        return self._subscriptions.view(id)

    def unsubscribe(self, id: str) -> None:
        """Give a subscription up; its stream goes with the last of those that share it."""
        self._subscriptions.cancel(id)

    # -- KPL ---------------------------------------------------------------------------------

    def add_kpl(self, text: str, unit: str = "ms") -> tuple[DeclarationView, ...]:
        """Declare sources, units, generators and streams in KPL, and start them; all of the text
        or nothing. Gives what is new. ``unit`` is what integers are where the text does not say.

        Raises `LanguageError`, and what `Application.add` raises.
        """
        with self._manager.together():
            added = self._kpl.add(text, unit)
        return tuple(self._kpl.view(key) for key in added)

    def kpl(self) -> tuple[DeclarationView, ...]:
        """Everything declared in KPL, in order."""
        return self._kpl.views()

    def kpl_text(self) -> str:
        """The same as a KPL text, integers in ms."""
        return self._kpl.text()

    def kpl_declaration(self, name: str) -> tuple[DeclarationView, tuple[str, ...]]:
        """One declaration, and the names of all that cannot be without it; raises
        `UnknownDeclaration`."""
        return self._kpl.view(name), self._kpl.used_by(name)

    def restore_kpl(self, text: str, unit: str = "ms") -> None:
        """Declare of a KPL text, that an earlier run has taken, what holds; the others are told and
        kept, as after a restart. Raises nothing."""
        with self._manager.together():
            self._kpl.add_what_holds(text, unit)

    def forget_kpl(self, name: str) -> bool:
        """Forget what was declared in KPL by an earlier run and does not hold any more; whether
        there was such a declaration."""
        return self._kpl.forget(name)

    def remove_kpl(self, name: str, *, cascade: bool = False) -> tuple[str, ...]:
        """Stop and forget a declaration; see `Application.remove`."""
        with self._manager.together():
            return self._kpl.remove(name, cascade=cascade)

    # -- specifications ----------------------------------------------------------------------

    def apply_specification(self, text: str | bytes) -> SpecificationView:
        """Insert and remove units as an XML text says ([Introspection15 §3.2]); all of it or
        nothing. Raises `LanguageError`."""
        return self.take_specification(parse_specification(text))

    def take_specification(self, specification: Specification) -> SpecificationView:
        """The same with what `parse_specification` made of a text, maybe in another process."""
        with self._manager.together():
            view = self._specifications.apply(specification)
            self._settle()
        return view

    def current_specification(self) -> str:
        """The running configuration as an XML text that `apply_specification` takes."""
        return self._specifications.current()

    def insertions(self) -> tuple[InsertionView, ...]:
        """What specifications inserted, in order."""
        return self._specifications.views()

    # -- meaning -----------------------------------------------------------------------------

    def load_ontology(self, text: str, *, name: str, format: TextFormat = "turtle") -> None:
        """Add a domain ontology, or replace the one called ``name`` (an IRI): its sorts, features
        and objects are known from now on, also to queries that run. Raises `OntologyError`."""
        self.take_ontology(self.ontology.prepare(text, name=name, format=format))

    def take_ontology(self, prepared: PreparedOntology) -> None:
        """The same with what `Ontology.prepare` made of a text, maybe in another thread."""
        self.ontology.take(prepared)
        self._converters.clear()
        self._tell_templates()
        self._rematching.ontology_changed()
        self._settle()

    # -- knowing -----------------------------------------------------------------------------

    def match(
        self,
        feature: str,
        *,
        sort: str | None = None,
        objects: Sequence[str] = (),
        strategy: str = "fast",
    ) -> MatchView:
        """Semantic matching without executing: what would give ``feature``, and why."""
        want = checked_want(self.ontology.vocabulary, feature, sort, objects)
        checked_strategy(strategy)
        without = self._plans.unusable(Since.NOW)
        (found,) = self._plans.match([want], strategy, without, explained=True)
        view = explanations.match_view(
            want, found, strategy, self._manager.space, self._plans.is_running
        )
        supplies = self._plans.made_from([found])
        texts = [plan_text(supply, self._transformations) for supply in supplies]
        return replace(view, specification=next(iter(texts), None))

    def explain_running(self, id: str) -> str:
        """Each stage of a query or request that runs; raises `UnknownRequest`."""
        if self.queries.has(id):
            return self.queries.explain_running(id)
        return self._requests.explain_running(id)

    def explain(
        self, *, event: str | None = None, template: str | None = None, query: str | None = None
    ) -> str:
        """Every stage of a request, a template or a query, as text for people."""
        if event is not None:
            request = self.parse_request(event)
            return self._requests.explain(self._event_template(request), request)
        if template is not None:
            return explanations.template(self._template(template))
        if query is not None:
            return self.queries.explain(query)
        raise BadArguments("explain needs an event, a template or a query")

    @property
    def next_ids(self) -> tuple[str, str]:
        """What the next request and the next subscription would be called."""
        return f"event{self._requests.number + 1}", f"subscription{self._subscriptions.number + 1}"

    def keep_id(self, id: str) -> None:
        """The next request or subscription is called ``id``, as it was in an earlier run, if that
        is later than all there were."""
        for name, made in (("event", self._requests), ("subscription", self._subscriptions)):
            number = id.removeprefix(name)
            if number != id and number.isdigit():
                made.number_after(int(number) - 1)

    def skip_id(self, id: str) -> None:
        """No later request, subscription or query without a name is called ``id``."""
        for name, made in (("event", self._requests), ("subscription", self._subscriptions)):
            number = id.removeprefix(name)
            if number != id and number.isdigit():
                made.number_after(int(number))
        self._configuration.pass_over(id)

    def tell_not_restored(self, reason: str) -> None:
        """Tell on the status stream what of an earlier run does not go on, and why."""
        self._changed(Change(ChangeKind.NOT_RESTORED, specification=reason))

    def hear_of_sinks(self, outcomes: Sequence[Outcome]) -> None:
        """What came of calls of sinks counts from now on, and is told on the status stream."""
        for outcome in outcomes:
            self._application.hear(outcome)
        self._settle()

    def tell_unkept(self, process: str, reason: str) -> None:
        """Tell on the status stream that what a user-written process remembers is not kept."""
        self._changed(Change(ChangeKind.UNKEPT, transformation=process, specification=reason))

    def totals(self) -> Totals:
        """How much there is of what people make. Cost: O(ontologies)."""
        configuration = self._configuration
        return Totals(
            len(configuration.streams) - len(configuration.units),
            len(self._templates),
            len(self._requests)
            + len(self._subscriptions)
            + len(self.queries)
            + len(self._specifications),
            len(self._kpl),
            len(self._transformations),
            self.ontology.number,
        )

    def object_name(self, text: str) -> str:
        """What a name that people give an object stands for: an id without a prefix is one in the
        object namespace of the annotated streams, where these have one in common, else `dyknow:`.
        """
        if text == "self" or ":" in text or text.startswith("<"):
            return text
        streams = [each.stream for each in self._declared.annotations()]
        namespaces = {self._configuration.namespaces[name] for name in streams}
        namespace = namespaces.pop() if len(namespaces) == 1 else DYKNOW
        return f"<{object_iri(text, namespace)}>"

    # -- within ------------------------------------------------------------------------------

    def _refuse_if_source(self, name: str, declaration: StreamDeclaration | None = None) -> None:
        if self._application.uses_stream(name) and (
            declaration is None or not self._declared.is_as_declared(declaration)
        ):
            raise Conflict(
                f"stream {name!r} is a source of KPL declarations",
                f"remove these first: DELETE /kpl/{name}",
            )

    def _settle(self) -> None:
        with self._manager.together():
            self._application.settle()
            reports = self._configuration.reports
            while reports:
                self._annotations.reported(*reports.pop(0))
            self._rematching.settle()

    def _heard(self, change: Change) -> None:
        """What is remembered of a stream holds no more."""
        self.failures += change.kind in (ChangeKind.UNIT_FAILED, ChangeKind.UNIT_STOPPED_BY_RULE)
        if change.kind is ChangeKind.STREAM_REMOVED:
            self.intake.forget(change.stream)
        self._converters.pop(change.stream, None)

    def _count_subscribers(self) -> None:
        streams = self._configuration.streams.items()
        self._manager.count_subscribers(
            (name, each.subscribers + each.listeners) for name, each in streams
        )

    def _subscribers(self, name: str) -> int:
        """Those within the engine: what is matched does not depend on who looks on."""
        generator = self._configuration.streams.get(name)
        return 0 if generator is None else generator.subscribers

    def _view(self, generator: StreamGenerator) -> StreamView:
        name = generator.name
        return stream_view(
            generator,
            self._configuration.namespaces[name],
            self._application.producer_of(name),
            self._manager.annotations.get(name),
        )

    def _converter(self, name: str) -> SampleConverter | None:
        """Converts the samples of a stream to RDF, by its annotation; None without one."""
        source = self._configuration.late.source_of(name)
        if source is not None:  # a late sample says what it would have said in time
            return self._converter(source)
        found = self._converters.get(name)
        if found is None:
            found = self.queries.converter(name)
        if found is None:
            generator = self._configuration.stream(name)
            annotation = self._rdf_of(name) or self._manager.annotations.get(name)
            if annotation is None:
                return None
            namespace = self._configuration.namespaces[name]
            found = self._declared.compile(annotation, generator.schema, namespace)
            self._converters[name] = found
        return found

    def _rdf_of(self, name: str) -> StreamAnnotation | None:
        """How samples of what the system answers are written as triples."""
        found = self._rematching.of_stream(name)
        return self._requests.rdf_of(name) if found is None else found.rdf(self.ontology.vocabulary)

    def _tell_templates(self) -> None:
        """What the event templates take and give, as matching sees it; one may have made known
        what another needs."""
        for name in self._templates.names():
            template = self._templates.get(name)
            known = event_transformation(
                template, lambda: self.ontology.vocabulary, self._templates.needs
            )
            if known != self._manager.space.transformations.get(known.name):
                self._changed(
                    Change(
                        ChangeKind.TRANSFORMATION_ANNOTATED,
                        transformation=known.name,
                        specification=template.source,
                        described=KnownTransformation(known, C_SPARQL),
                    )
                )

    def _template(self, name: str) -> Template:
        try:
            return self._templates.get(name)
        except NoSuchTemplate as error:
            raise UnknownTemplate(
                f"there is no template {name!r}", did_you_mean(error.suggestions)
            ) from error

    def _template_view(self, template: Template) -> TemplateView:
        return TemplateView(
            name=template.name,
            local_name=shorten(template.name).removeprefix("dyknow:"),
            parameters=tuple(f"?{parameter.value}" for parameter in template.parameters),
            source=template.source,
            etag=self._templates.etag(template.name),
        )

    def _event_template(self, request: EventRequest) -> Template:
        try:
            return self._templates.get(request.event)
        except NoSuchTemplate as error:
            known = ", ".join(shorten(name) for name in self._templates.names())
            raise UnknownEvent(
                f"the ontology knows no event {shorten(request.event)} with a template",
                did_you_mean(error.suggestions)
                or (f"there are {known}" if known else "register one with POST /templates"),
            ) from error
