"""The engine: the one face of the running system for the service, the CLI and tests.

Every method is synchronous and runs to its end; callers see to it that only one runs at a time.
Time comes in as an argument (`publish`, `tick`); nothing here reads a clock. What is done stands in
the parts (`parts`); the file is long because there is a method for each thing that can be asked.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from ..continuous.columns.budget import UNLIMITED, Budget
from ..converters.objects import object_iri
from ..converters.wire import Incoming
from ..languages.csparql import parse_argument, parse_event_request
from ..languages.csparql.ast import EventRequest
from ..languages.kpl import parse_policy
from ..languages.specification import Specification, parse_specification
from ..languages.ssl.annotation import CheckedAnnotation
from ..matching.gc_pause import gc_paused
from ..ontology.ontology import Ontology, PreparedOntology
from ..ontology.reading import TextFormat
from ..rdf.namespaces import DYKNOW, PREFIXES
from ..streams.generator import StreamGenerator
from ..streams.sample import SampleBatch
from ..streams.stream_rules import INSTANTS
from ..streams.time import SECOND, TIME_MIN
from .catalog.iri_annotations import DescribedStream, DescribedTransformation
from .catalog.name_resolution import (
    checked_strategy,
    checked_want,
    iri_of,
)
from .catalog.registered_transformations import (
    check_quality,
)
from .model.beginning import beginning_of
from .model.errors import (
    BadArguments,
    Conflict,
)
from .model.status_changes import Change, ChangeKind
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
from .parts import Parts, Setting
from .planning import explain as explanations
from .processes.external_io import Outcome
from .processes.registry import PROCESSES, Processes
from .processes.supervision import DIRECT, Runner
from .requests.adaptive_subscription import Rematch, Wish
from .requests.event_requests import EventRequests
from .requests.subscriptions import Subscriptions
from .specification.plan_text import plan_text
from .units.backlog import TurnRecord, Turns
from .units.base import ComputationalUnit
from .units.windowed import WindowUnit
from .units.work_time import Stopwatch


class Engine:
    """Streams, templates and event requests over one ontology.

    ``data`` is the directory of what outlives the process (None: in memory). ``epoch`` marks
    this run in event ids. ``first_reserved`` is the first N of ``dyknow_reserved<N>``. ``now`` is
    the time in ns until `publish` and `tick` bring a later one. ``processes`` are the user-written
    ones that KPL may name, and ``runner`` calls them. ``ontology`` is taken instead of one in
    ``data``. With a ``stopwatch`` the work of units is measured. ``budget``
    is what a window of a continuous query may cost. With ``turns`` windows close in
    `work_backlog` only.
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
        self._now = now
        self._counted = TIME_MIN
        self._measured: int | None = None
        given = Setting(first_reserved, processes, runner, stopwatch, budget, turns, rules)
        self._parts = parts = Parts(ontology, lambda: self._now, given)
        self.ontology = ontology
        self.dictionary = parts.dictionary
        self.backlog = parts.backlog
        """Units whose windows take long, if there are ``turns`` for them."""
        self.rules = parts.configuration.rules
        """The rules of commands; recovery changes them."""
        self.intake = parts.intake
        self.transformations = parts.transformations
        self.queries = parts.queries
        parts.restore(now)

    @property
    def failures(self) -> int:
        """Number of failures on the status stream: while it stays, nothing more has failed."""
        return self._parts.failures

    @property
    def now(self) -> int:
        """The latest time (ns) that it was told."""
        return self._now

    # -- streams -----------------------------------------------------------------------------

    def declare(self, declaration: StreamDeclaration) -> StreamView:
        """Make a stream, or change one that nobody has used yet; see `DeclaredStreams`."""
        if self._parts.configuration.streams.get(declaration.name) is not None:
            self._refuse_if_source(declaration.name, declaration)
        generator = self._parts.declared.declare(declaration)
        self._parts.idleness.came(generator, self._now)
        return self._view(generator)

    def annotate(self, ssl: str) -> tuple[CheckedAnnotation, ...]:
        """Annotate streams and transformations by an SSL text; see `Annotations`."""
        with self._parts.manager.together():
            annotated = self._parts.annotations.annotate(ssl)
            self._parts.settle()
        return annotated

    def describe_all(
        self,
        described: Sequence[DescribedStream],
        transformations: Sequence[DescribedTransformation] = (),
    ) -> tuple[CheckedAnnotation, ...]:
        """Annotate streams and transformations in names, all of them or none; see `Annotations`."""
        with self._parts.manager.together():
            annotations = self._parts.annotations.describe_all(described, transformations)
            self._parts.settle()
        return annotations

    def set_quality(self, stream: str, quality: float) -> None:
        """How good a stream is now (0..1); raises `UnknownStream` and `BadArguments`."""
        self._parts.annotations.set_quality(stream, quality)
        self._parts.settle()

    def annotations(self) -> tuple[CheckedAnnotation, ...]:
        """Every annotation in force: streams first, then transformations."""
        return self._parts.annotations.all()

    def streams(self) -> tuple[StreamView, ...]:
        """All streams, the status stream among them."""
        return tuple(
            self._view(generator) for generator in self._parts.configuration.streams.values()
        )

    def stream(self, name: str) -> StreamView:
        """One stream; raises `UnknownStream`."""
        return self._view(self._parts.configuration.stream(name))

    def has_stream(self, name: str) -> bool:
        """Whether there is a stream of this name already; none is made by asking."""
        return self._parts.configuration.has(name)

    def before_demand(self, check: Callable[[], None]) -> None:
        """Call ``check`` before a stream comes into being because somebody asks for it (of late
        samples, of violations), in whatever way; what it raises is what who asks gets."""
        self._parts.configuration.before_demand = check

    def published(self) -> tuple[StreamGenerator, ...]:
        """The streams that people publish to."""
        there = self._parts.configuration.streams.items()
        return tuple(each for name, each in there if not self._parts.configuration.is_made(name))

    def generators(self) -> tuple[StreamGenerator, ...]:
        """What is behind all streams: for who wants less of each than a view. Cost: O(streams)."""
        return tuple(self._parts.configuration.streams.values())

    def units(self) -> tuple[ComputationalUnit, ...]:
        """All units that run, to read what they count. Cost: O(units)."""
        return tuple(self._parts.configuration.units.values())

    def generator(self, name: str) -> StreamGenerator:
        """The generator behind a stream, to read and subscribe; raises `UnknownStream`."""
        return self._parts.configuration.stream(name)

    def accepting(self, name: str) -> StreamGenerator:
        """The generator of a stream that takes samples; raises `UnknownStream`, and `Refused` for
        a stream that the system makes."""
        return self.intake.accepting(name)

    def on_opened(self, heard: Callable[[str], None]) -> None:
        """Tell ``heard`` of streams that come into being by being asked for: of late samples, of
        violations."""
        self._parts.configuration.on_opened = heard

    def remove_stream(self, name: str) -> None:
        """Forget a declared stream and its annotation, or one of late samples, which are then only
        counted again; raises `UnknownStream`, `Refused` for another that the system makes, and
        `Conflict` while a unit or KPL needs it."""
        if name not in self._parts.configuration.late:
            name = self.accepting(name).name
        self._refuse_if_source(name)
        self._parts.rematching.withdraw(name)
        self._parts.declared.remove(name)
        self._parts.settle()

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
        generator = self._parts.configuration.stream(name)
        self._parts.idleness.came(generator, self._now)
        self._parts.rematching.came(generator.name, self._now)
        self._parts.settle()
        self._parts.collect()
        return accepted

    def end(self, name: str) -> None:
        """A recording has come to its end: what waits for more samples is decided now."""
        generator = self.accepting(name)
        generator.end()
        self._parts.changed(Change(ChangeKind.STREAM_ENDED, generator.name))
        self._parts.settle()
        self._parts.collect()

    def tick(self, now: int) -> None:
        """The time is ``now``: streams that are stamped on arrival have nothing before it, others
        may have fallen idle."""
        self._now = max(self._now, now)
        self._parts.application.tick(now)
        self._parts.plans.tick(now)
        units = self._parts.configuration.units
        for generator in list(self._parts.configuration.streams.values()):
            if generator.stamped and generator.name not in units and not generator.is_ended:
                generator.advance(now)
        self._parts.idleness.tick(tuple(self._parts.configuration.streams.values()), self._now)
        for unit in list(units.values()):
            waiting = unit.waits_for
            if not waiting:
                continue
            # Where everything that has come was stamped on arrival, so will be what is to come.
            begun = set(unit.inputs).difference(waiting)
            if begun and all(self._parts.configuration.is_stamped(source) for source in begun):
                for source in waiting:
                    unit.advance(source, now)
        self._parts.rematching.tick(self._now)
        self._parts.settle()
        self._parts.collect()
        self.ontology.advance()
        if now - SECOND >= self._counted:
            self._counted = now
            self._parts.count_subscribers()

    def work_backlog(self, *, new: bool = False, begins: bool = True) -> tuple[TurnRecord, ...]:
        """Close windows that are due (`Backlog.work`); return what was done."""
        done = tuple(self.backlog.work(new=new, begins=begins))
        if done:
            self._parts.settle()
            self._parts.collect()
        return done

    def backlog_of(self, stream: str) -> tuple[WindowUnit, ...]:
        """The units of the backlog that read ``stream``, themselves or through other units."""
        return self._parts.evaluation.backlog_of(stream)

    def failure_of(self, generator: StreamGenerator) -> str | None:
        """Why nothing more comes in a stream: what feeds it has failed. None while something may.
        See `Configuration.failure_of`."""
        return self._parts.evaluation.failure(generator)

    def failed(self) -> tuple[FailureView, ...]:
        """The units that were cut off. Cost: O(units), and for each failure O(requests)."""
        return self._parts.evaluation.failed()

    def evaluation(self, name: str) -> EvaluationView:
        """How far all is that reads stream ``name``; raises `UnknownStream`. Cost: O(units²)."""
        return self._parts.evaluation.of(name)

    def replay_turns(self, done: Sequence[TurnRecord]) -> None:
        """Do what `work_backlog` did. Raises ``ValueError`` where there is no such work to do."""
        self.backlog.replay(done)
        self._parts.settle()
        self._parts.collect()

    def measure(self) -> None:
        """Let SPARQL see the rates and subscribers there are: whoever asks calls this before.

        Rates change all the time, so they are mirrored when somebody wants to know, at most once a
        second. Cost: a look at each stream, and what changed.
        """
        if self._measured is not None and self._now - self._measured < SECOND:
            return
        self._measured = self._now
        streams = tuple(self._parts.configuration.streams.items())
        with gc_paused(), self._parts.manager.together():
            self._parts.count_subscribers()
            self._parts.manager.measure_rates((name, rate_of(each)) for name, each in streams)
            self._parts.manager.show_samples(streams)

    def rdf_of(self, name: str, batch: SampleBatch) -> list[str]:
        """Each sample of stream ``name`` as N-Triples; empty text where it says nothing."""
        return self._parts.rdf.of(name, batch)

    # -- templates ---------------------------------------------------------------------------

    def register_template(self, text: str, *, replace: bool = False) -> TemplateView:
        """Register an event template; its event concept is known from now on.

        Raises `LanguageError`, and `AlreadyExists` unless ``replace``.
        """
        view = self._parts.templates.register(text, replace=replace)
        self._parts.settle()
        return view

    def templates(self) -> tuple[TemplateView, ...]:
        """All templates, by name."""
        return self._parts.templates.views()

    def template(self, name: str) -> TemplateView:
        """One template by local name, prefixed name or IRI; raises `UnknownTemplate`."""
        return self._parts.templates.view(name)

    def remove_template(self, name: str) -> None:
        """Forget a template; raises `UnknownTemplate`, and `Conflict` while a request uses it."""
        self._parts.templates.remove(name)

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
        return self._parts.requests.start(
            self._parts.templates.of(request), request, strategy, begin
        )

    def events(self) -> tuple[EventView, ...]:
        """The running requests, oldest first."""
        return self._parts.requests.views()

    def event_ids(self) -> tuple[str, ...]:
        """Those of the running requests, oldest first."""
        return self._parts.requests.ids()

    def event(self, id: str) -> EventView:
        """One running request; raises `UnknownRequest`."""
        return self._parts.requests.view(id)

    def cancel_event(self, id: str) -> None:
        """End a request; units without users stop."""
        self._parts.requests.cancel(id)

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
        return self._parts.subscriptions.start(
            stream, policy, unit, beginning_of(since), keyed=keyed
        )

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
        with self._parts.manager.together():
            return self._parts.subscriptions.start_adaptive(wish)

    def rematches(self, id: str) -> Sequence[Rematch]:
        """The switches of a subscription, oldest first; raises `UnknownRequest`. What is given
        holds later ones, too, as they come."""
        return self._parts.subscriptions.rematches(id)

    def subscriptions(self) -> tuple[SubscriptionView, ...]:
        """The subscriptions that run, oldest first."""
        return self._parts.subscriptions.views()

    def subscription_ids(self) -> tuple[str, ...]:
        """Those of the subscriptions that run, oldest first."""
        return self._parts.subscriptions.ids()

    def subscription(self, id: str) -> SubscriptionView:
        """One subscription; raises `UnknownRequest`."""
        return self._parts.subscriptions.view(id)

    def unsubscribe(self, id: str) -> None:
        """Give a subscription up; its stream goes with the last of those that share it."""
        self._parts.subscriptions.cancel(id)

    # -- KPL ---------------------------------------------------------------------------------

    def add_kpl(self, text: str, unit: str = "ms") -> tuple[DeclarationView, ...]:
        """Declare sources, units, generators and streams in KPL, and start them; all of the text
        or nothing. Gives what is new. ``unit`` is what integers are where the text does not say.

        Raises `LanguageError`, and what `Application.add` raises.
        """
        with self._parts.manager.together():
            added = self._parts.kpl.add(text, unit)
        return tuple(self._parts.kpl.view(key) for key in added)

    def kpl(self) -> tuple[DeclarationView, ...]:
        """Everything declared in KPL, in order."""
        return self._parts.kpl.views()

    def kpl_text(self) -> str:
        """The same as a KPL text, integers in ms."""
        return self._parts.kpl.text()

    def kpl_declaration(self, name: str) -> tuple[DeclarationView, tuple[str, ...]]:
        """One declaration, and the names of all that cannot be without it; raises
        `UnknownDeclaration`."""
        return self._parts.kpl.view(name), self._parts.kpl.used_by(name)

    def restore_kpl(self, text: str, unit: str = "ms") -> None:
        """Declare of a KPL text, that an earlier run has taken, what holds; the others are told and
        kept, as after a restart. Raises nothing."""
        with self._parts.manager.together():
            self._parts.kpl.add_what_holds(text, unit)

    def forget_kpl(self, name: str) -> bool:
        """Forget what was declared in KPL by an earlier run and does not hold any more; whether
        there was such a declaration."""
        return self._parts.kpl.forget(name)

    def remove_kpl(self, name: str, *, cascade: bool = False) -> tuple[str, ...]:
        """Stop and forget a declaration; see `Application.remove`."""
        with self._parts.manager.together():
            return self._parts.kpl.remove(name, cascade=cascade)

    # -- specifications ----------------------------------------------------------------------

    def apply_specification(self, text: str | bytes) -> SpecificationView:
        """Insert and remove units as an XML text says ([Introspection15 §3.2]); all of it or
        nothing. Raises `LanguageError`."""
        return self.take_specification(parse_specification(text))

    def take_specification(self, specification: Specification) -> SpecificationView:
        """The same with what `parse_specification` made of a text, maybe in another process."""
        with self._parts.manager.together():
            view = self._parts.specifications.apply(specification)
            self._parts.settle()
        return view

    def current_specification(self) -> str:
        """The running configuration as an XML text that `apply_specification` takes."""
        return self._parts.specifications.current()

    def insertions(self) -> tuple[InsertionView, ...]:
        """What specifications inserted, in order."""
        return self._parts.specifications.views()

    # -- meaning -----------------------------------------------------------------------------

    def load_ontology(self, text: str, *, name: str, format: TextFormat = "turtle") -> None:
        """Add a domain ontology, or replace the one called ``name`` (an IRI): its sorts, features
        and objects are known from now on, also to queries that run. Raises `OntologyError`."""
        self.take_ontology(self.ontology.prepare(text, name=name, format=format))

    def take_ontology(self, prepared: PreparedOntology) -> None:
        """The same with what `Ontology.prepare` made of a text, maybe in another thread."""
        self.ontology.take(prepared)
        self._parts.rdf.forget_all()
        self._parts.templates.tell()
        self._parts.rematching.ontology_changed()
        self._parts.settle()

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
        without = self._parts.plans.unusable(Since.NOW)
        (found,) = self._parts.plans.match([want], strategy, without, explained=True)
        view = explanations.match_view(
            want, found, strategy, self._parts.manager.space, self._parts.plans.is_running
        )
        supplies = self._parts.plans.made_from([found])
        texts = [plan_text(supply, self._parts.known_transformations) for supply in supplies]
        return replace(view, specification=next(iter(texts), None))

    def explain_running(self, id: str) -> str:
        """Each stage of a query or request that runs; raises `UnknownRequest`."""
        if self.queries.has(id):
            return self.queries.explain_running(id)
        return self._parts.requests.explain_running(id)

    def explain(
        self, *, event: str | None = None, template: str | None = None, query: str | None = None
    ) -> str:
        """Every stage of a request, a template or a query, as text for people."""
        if event is not None:
            request = self.parse_request(event)
            return self._parts.requests.explain(self._parts.templates.of(request), request)
        if template is not None:
            return explanations.template(self._parts.templates.find(template))
        if query is not None:
            return self.queries.explain(query)
        raise BadArguments("explain needs an event, a template or a query")

    @property
    def next_ids(self) -> tuple[str, str]:
        """What the next request and the next subscription would be called."""
        return (
            f"event{self._parts.requests.number + 1}",
            f"subscription{self._parts.subscriptions.number + 1}",
        )

    def keep_id(self, id: str) -> None:
        """The next request or subscription is called ``id``, as it was in an earlier run, if that
        is later than all there were."""
        for made, number in self._numbered(id):
            made.number_after(number - 1)

    def skip_id(self, id: str) -> None:
        """No later request, subscription or query without a name is called ``id``."""
        for made, number in self._numbered(id):
            made.number_after(number)
        self._parts.configuration.pass_over(id)

    def _numbered(self, id: str) -> Iterator[tuple[EventRequests | Subscriptions, int]]:
        """Whose id it is, and its number."""
        requests, subscriptions = self._parts.requests, self._parts.subscriptions
        for name, made in (("event", requests), ("subscription", subscriptions)):
            number = id.removeprefix(name)
            if number != id and number.isdigit():
                yield made, int(number)

    def tell_not_restored(self, reason: str) -> None:
        """Tell on the status stream what of an earlier run does not go on, and why."""
        self._parts.changed(Change(ChangeKind.NOT_RESTORED, specification=reason))

    def hear_of_sinks(self, outcomes: Sequence[Outcome]) -> None:
        """What came of calls of sinks counts from now on, and is told on the status stream."""
        for outcome in outcomes:
            self._parts.application.hear(outcome)
        self._parts.settle()

    def tell_unkept(self, process: str, reason: str) -> None:
        """Tell on the status stream that what a user-written process remembers is not kept."""
        self._parts.changed(Change(ChangeKind.UNKEPT, transformation=process, specification=reason))

    def totals(self) -> Totals:
        """How much there is of what people make. Cost: O(ontologies)."""
        configuration = self._parts.configuration
        return Totals(
            len(configuration.streams) - len(configuration.units),
            len(self._parts.templates),
            len(self._parts.requests)
            + len(self._parts.subscriptions)
            + len(self.queries)
            + len(self._parts.specifications),
            len(self._parts.kpl),
            len(self._parts.known_transformations),
            self.ontology.number,
        )

    def object_name(self, text: str) -> str:
        """What a name that people give an object stands for: an id without a prefix is one in the
        object namespace of the annotated streams, where these have one in common, else `dyknow:`.
        """
        if text == "self" or ":" in text or text.startswith("<"):
            return text
        streams = [each.stream for each in self._parts.declared.annotations()]
        namespaces = {self._parts.configuration.namespaces[name] for name in streams}
        namespace = namespaces.pop() if len(namespaces) == 1 else DYKNOW
        return f"<{object_iri(text, namespace)}>"

    # -- within ------------------------------------------------------------------------------

    def _refuse_if_source(self, name: str, declaration: StreamDeclaration | None = None) -> None:
        if self._parts.application.uses_stream(name) and (
            declaration is None or not self._parts.declared.is_as_declared(declaration)
        ):
            raise Conflict(
                f"stream {name!r} is a source of KPL declarations",
                f"remove these first: DELETE /kpl/{name}",
            )

    def _view(self, generator: StreamGenerator) -> StreamView:
        name = generator.name
        return stream_view(
            generator,
            self._parts.configuration.namespaces[name],
            self._parts.application.producer_of(name),
            self._parts.manager.annotations.get(name),
        )
