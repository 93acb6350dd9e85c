"""The engine: the interface of the running system for the service, the CLI and tests.

Every method is synchronous; callers run one at a time. Time is an argument (`publish`, `tick`), and
nothing here reads a clock. The parts (`parts`) do the work. The file is long because it has a
method for each command and question.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from ..continuous.columns.budget import UNLIMITED, Budget
from ..converters.objects import object_in_text
from ..converters.wire import Incoming
from ..languages.csparql import parse_event_request, request_of
from ..languages.csparql.ast import EventRequest
from ..languages.kpl import parse_policy
from ..languages.specification import Specification, parse_specification
from ..languages.ssl.annotation import CheckedAnnotation
from ..matching.gc_pause import gc_paused
from ..matching.plan import Node
from ..matching.plan_value import cost_of_node
from ..ontology.ontology import Ontology, PreparedOntology
from ..ontology.shipped_files import is_shipped
from ..ontology.texts.reading import TextFormat
from ..rdf.namespaces import DYKNOW
from ..reasoning.mtl.explanation import Explanation as VerdictExplanation
from ..reasoning.patterns.recognition.explanation import ExplainedMatch, PartialMatches
from ..streams.generator import StreamGenerator
from ..streams.instants import PlacesOf, places_in_instants
from ..streams.sample import Mask, SampleBatch
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
from .model.beginning import parse_beginning
from .model.errors import (
    BadArguments,
    Conflict,
    OntologyInUse,
    Refused,
    UnknownOntology,
)
from .model.graph import Graph
from .model.status_changes import Change, ChangeKind
from .model.stream_statistics import present_rate, stream_view
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
from .parts import EngineArguments, Parts
from .planning import explanations
from .planning.explanations import Explanation
from .processes.external_io import Outcome
from .processes.registry import PROCESSES, Processes
from .processes.supervision import DIRECT, Runner
from .requests.adaptive_subscription import Rematch, Wish
from .requests.event_requests import EventRequests
from .requests.graph import graph_of
from .requests.subscriptions import Subscriptions
from .specification.plan_text import plan_text
from .units.backlog import TurnRecord, Turns
from .units.base import ComputationalUnit
from .units.windowed import WindowUnit
from .units.work_time import Stopwatch


class Engine:
    """Streams, templates, requests and their units over one ontology.

    - ``data``: the directory of the ontology's store; None: in memory. ``ontology`` replaces it.
    - ``epoch``: the first half of event ids.
    - ``first_reserved``: the first N of ``dyknow_reserved<N>``.
    - ``now``: the time (ns) until `publish` and `tick` bring a later one.
    - ``processes``: the user-written processes that KPL may name; ``runner`` calls them.
    - ``stopwatch``: measures the work of units.
    - ``budget``: bounds the cost of a window of a continuous query.
    - ``turns``: with them windows close in `work_backlog` only.
    - ``rules``: the rules (`Rules.version`) for restoring the definitions of an earlier run.
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
        arguments = EngineArguments(
            first_reserved, processes, runner, stopwatch, budget, turns, rules
        )
        self._parts = parts = Parts(ontology, lambda: self._now, arguments)
        self.ontology = ontology
        self.dictionary = parts.dictionary
        self.backlog = parts.backlog
        """The units with windows to close; always empty without ``turns``."""
        self.rules = parts.configuration.rules
        """The rules of commands; recovery changes them."""
        self.intake = parts.intake
        self.transformations = parts.transformations
        self.queries = parts.queries
        self.objects = parts.objects
        parts.restore(now)

    @property
    def failures(self) -> int:
        """The number of failures on the status stream. A caller polls it to notice new failures."""
        return self._parts.failures

    @property
    def now(self) -> int:
        """The latest time (ns) of a command."""
        return self._now

    # -- streams -----------------------------------------------------------------------------

    def declare(self, declaration: StreamDeclaration) -> StreamView:
        """Declare a stream, or change one (`DeclaredStreams`). A source of KPL is always in use."""
        declared, application = self._parts.declared, self._parts.application
        name, is_new = declaration.name, not declared.has(declaration)
        if is_new and (name in application.sampled or not declared.can_extend(declaration)):
            self._refuse_if_source(name)
        generator = declared.declare(declaration)
        if is_new:
            application.release(name)
        self._parts.idleness.note_samples(generator, self._now)
        return self._view(generator)

    def annotate(self, ssl: str) -> tuple[CheckedAnnotation, ...]:
        """Annotate streams and transformations by an SSL text (`Annotations`)."""
        with self._parts.manager.together():
            annotated = self._parts.annotations.annotate(ssl)
            self._parts.settle()
        return annotated

    def describe_all(
        self,
        described: Sequence[DescribedStream],
        transformations: Sequence[DescribedTransformation] = (),
    ) -> tuple[CheckedAnnotation, ...]:
        """Annotate streams and transformations by structures instead of a text, all of them or none
        (`Annotations`)."""
        with self._parts.manager.together():
            annotations = self._parts.annotations.describe_all(described, transformations)
            self._parts.settle()
        return annotations

    def set_quality(self, stream: str, quality: float) -> None:
        """Set the quality (0..1) of a stream. Raises `UnknownStream` and `BadArguments`."""
        self._parts.annotations.set_quality(stream, quality)
        self._parts.settle()

    def annotations(self) -> tuple[CheckedAnnotation, ...]:
        """Every annotation in force: streams first, then transformations."""
        return self._parts.annotations.all()

    def streams(self) -> tuple[StreamView, ...]:
        """The views of all streams, with the status stream."""
        return tuple(
            self._view(generator) for generator in self._parts.configuration.streams.values()
        )

    def stream(self, name: str) -> StreamView:
        """The view of a stream. Raises `UnknownStream`."""
        return self._view(self._parts.configuration.stream(name))

    def has_stream(self, name: str) -> bool:
        """Whether a stream of this name exists. Unlike `generator` this creates none on demand."""
        return self._parts.configuration.has(name)

    def before_demand(self, check: Callable[[], None]) -> None:
        """Call ``check`` before a stream is created on demand (late samples, violations). The
        request that demands it raises the error of ``check``."""
        self._parts.configuration.before_demand = check

    def published(self) -> tuple[StreamGenerator, ...]:
        """The streams that clients publish to."""
        there = self._parts.configuration.streams.items()
        return tuple(
            each for name, each in there if not self._parts.configuration.is_made_by_system(name)
        )

    def generators(self) -> tuple[StreamGenerator, ...]:
        """The generators of all streams, cheaper than their views. Cost: O(streams)."""
        return tuple(self._parts.configuration.streams.values())

    def units(self) -> tuple[ComputationalUnit, ...]:
        """The running units, for their counters. Cost: O(units)."""
        return tuple(self._parts.configuration.units.values())

    def graph(self) -> Graph:
        """The graph of the streams, units and requests that run. Cost: O(streams + units), and
        O(upstream units) a request."""
        parts = self._parts
        requesters = (parts.requests, self.queries, parts.subscriptions)
        return graph_of(parts.configuration, parts.contents_of, requesters)

    def generator(self, name: str) -> StreamGenerator:
        """The generator of a stream, to read and subscribe. Raises `UnknownStream`."""
        return self._parts.configuration.stream(name)

    def accepting(self, name: str) -> StreamGenerator:
        """The generator of a stream that clients publish to. Raises `UnknownStream`, and `Refused`
        for a stream that the system makes."""
        return self.intake.accepting(name)

    def time_property(self, stream: StreamGenerator) -> str | None:
        """The property (IRI) that gives the times of the statements of ``stream``, a stream of RDF;
        empty for none, and None for a stream of samples."""
        return self._parts.configuration.statements.get(stream.name)

    def on_opened(self, listener: Callable[[str], None]) -> None:
        """Call ``listener`` with the name of each stream that is created on demand (late samples,
        violations)."""
        self._parts.configuration.on_opened = listener

    def remove_stream(self, name: str) -> None:
        """Remove a declared stream and its annotation, or a stream of late samples, which are only
        counted then. Raises `UnknownStream`, `Refused` for other streams of the system, and
        `Conflict` while a unit or KPL reads it."""
        if name not in self._parts.configuration.late:
            name = self.accepting(name).name
        self._refuse_if_source(name)
        # This refuses a stream that others read, so it comes before any change.
        self._parts.rematching.leave_stream(name, self._parts.specifications.users_of)
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
        """Publish a whole batch to a stream; return the number of accepted samples.

        A key that was used for this stream before has no second effect and returns the same answer;
        with another ``digest`` of the body it raises `Conflict`. So does a batch to be stamped on
        arrival in a stream whose samples brought their own available times, and the reverse: either
        would make the other's samples late.
        """
        before, self._now = self._now, max(self._now, now)
        try:
            generator = self.accepting(name)
            accepted = self.intake.publish(generator, incoming, now, idempotency_key, digest)
        except Exception:
            # The log has no record of a refused batch, so the batch must not change the time.
            self._now = before
            raise
        self._parts.idleness.note_samples(generator, self._now)
        self._parts.rematching.on_arrival(generator.name, self._now)
        self._parts.settle()
        self._parts.collect()
        return accepted

    def end(self, name: str) -> None:
        """End a stream, such as a recording: its readers wait for no more samples."""
        generator = self.accepting(name)
        generator.end()
        self._parts.changed(Change(ChangeKind.STREAM_ENDED, generator.name))
        self._parts.settle()
        self._parts.collect()

    def tick(self, now: int) -> None:
        """Advance the time to ``now``: the watermarks of streams that are stamped on arrival, idle
        streams, sources that are due, and hold-offs of adaptive subscriptions."""
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
            # If all inputs with samples are stamped on arrival, assume the same of those without:
            # their first samples will have a later time than ``now``.
            begun = set(unit.inputs).difference(waiting)
            if begun and all(self._parts.configuration.is_stamped(source) for source in begun):
                for source in waiting:
                    unit.advance(source, now)
        self._parts.rematching.tick(self._now)
        self._parts.settle()
        self._parts.collect()
        # Writes a part of a large change of the mirror, so that no query has to write all of it.
        self.ontology.apply_pending_piece()
        if now - SECOND >= self._counted:
            self._counted = now
            self._parts.count_subscribers()

    def work_backlog(self, *, new: bool = False, begins: bool = True) -> tuple[TurnRecord, ...]:
        """Close due windows (`Backlog.work`); return the records of the turns."""
        done = tuple(self.backlog.work(new=new, begins=begins))
        if done:
            self._parts.settle()
            self._parts.collect()
        return done

    def backlog_of(self, stream: str) -> tuple[WindowUnit, ...]:
        """The units of the backlog that read ``stream``, directly or through other units."""
        return self._parts.evaluation.backlog_of(stream)

    def failure_of(self, generator: StreamGenerator) -> str | None:
        """The failure that keeps samples from a stream; None if there is none
        (`Configuration.failure_of`)."""
        return self._parts.evaluation.failure(generator)

    def failed(self) -> tuple[FailureView, ...]:
        """The failed units. Cost: O(units), and O(requests) for each failure."""
        return self._parts.evaluation.failed()

    def evaluation(self, name: str) -> EvaluationView:
        """How far all readers have evaluated stream ``name``. Raises `UnknownStream`. Cost:
        O(units²)."""
        return self._parts.evaluation.of(name)

    def replay_turns(self, done: Sequence[TurnRecord]) -> None:
        """Replay turns of `work_backlog`. Raises ``ValueError`` if there is no such work to do."""
        self.backlog.replay(done)
        self._parts.settle()
        self._parts.collect()

    def measure(self) -> None:
        """Mirror the present rates and subscribers in the ontology; call it before a SPARQL query.

        Rates change all the time, so they are mirrored on demand, at most once a second. Cost:
        O(streams + changes).
        """
        if self._measured is not None and self._now - self._measured < SECOND:
            return
        self._measured = self._now
        streams = tuple(self._parts.configuration.streams.items())
        with gc_paused(), self._parts.manager.together():
            self._parts.count_subscribers()
            self._parts.manager.measure_rates((name, present_rate(each)) for name, each in streams)
            self._parts.manager.mirror_samples(streams)

    def rdf_of(
        self, name: str, batch: SampleBatch, places: PlacesOf = places_in_instants
    ) -> list[str]:
        """Return each sample of stream ``name`` as N-Triples; an empty text if it has no
        triples. ``places`` as in `SampleRdf.of`."""
        return self._parts.rdf.of(name, batch, places)

    def object_fields(self, name: str) -> tuple[str, ...]:
        """The fields that name the objects of a stream's samples, by its annotation or that of the
        answer that it is; the subject of a statement. None: it has no objects that are known.
        Raises `UnknownStream`."""
        return self._parts.object_fields(self._parts.configuration.stream(name))

    def rows_about(self, name: str, object: str) -> Callable[[SampleBatch], Mask]:
        """Return a function from samples of a stream to the rows that are about an object, named as
        in `object_iri`. Raises `UnknownStream`, and `Conflict` if its objects are not known."""
        stream = self._parts.configuration.stream(name)
        return self._parts.rows_about(stream, self.object_iri(object))

    # -- templates ---------------------------------------------------------------------------

    def register_template(self, text: str, *, replace: bool = False) -> TemplateView:
        """Register an event template and its event concept. Raises `LanguageError`, and
        `AlreadyExists` unless ``replace``.
        """
        view = self._parts.templates.register(text, replace=replace)
        self._parts.settle()
        return view

    def templates(self) -> tuple[TemplateView, ...]:
        """All templates, by name."""
        return self._parts.templates.views()

    def template(self, name: str) -> TemplateView:
        """The view of a template by local name, prefixed name or IRI. Raises `UnknownTemplate`."""
        return self._parts.templates.view(name)

    def remove_template(self, name: str) -> None:
        """Remove a template. Raises `UnknownTemplate`, and `Conflict` while a request uses it."""
        self._parts.templates.remove(name)

    # -- events ------------------------------------------------------------------------------

    def parse_request(self, text: str) -> EventRequest:
        """Parse ``dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)``. Raises `LanguageError`."""
        return parse_event_request(text)

    def make_request(self, event: str, arguments: Sequence[str]) -> EventRequest:
        """Make a request of an event and the texts of its arguments. Raises `LanguageError`."""
        request = request_of(iri_of(event), arguments)
        return replace(request, source=f"{event}({', '.join(arguments)})")

    def request_event(
        self, request: EventRequest, strategy: str = "fast", since: str = Since.NOW
    ) -> EventView:
        """Start the units that answer a request; equal requests share stream and units.

        With ``since`` = ``start`` the answer begins with the kept history of its inputs. With a
        time (format of `read_time`), or a duration before their newest sample, it begins with the
        samples available from then on. Raises `UnknownEvent`, `BadArguments`, `NoPlan`, and
        `Forgotten` if samples since then were evicted; starts nothing then.
        """
        begin = parse_beginning(since)
        return self._parts.requests.start(
            self._parts.templates.of(request), request, strategy, begin
        )

    def events(self) -> tuple[EventView, ...]:
        """The running requests, oldest first."""
        return self._parts.requests.views()

    def event_ids(self) -> tuple[str, ...]:
        """The ids of the running requests, oldest first."""
        return self._parts.requests.ids()

    def event(self, id: str) -> EventView:
        """The view of a running request. Raises `UnknownRequest`."""
        return self._parts.requests.view(id)

    def event_why(
        self, id: str, objects: Sequence[str], start: int
    ) -> Callable[[], VerdictExplanation | tuple[ExplainedMatch, ...]]:
        """Return the work that explains a verdict or match of a requested event, for another
        thread (`reasoning_answers.why`). Raises `UnknownRequest`."""
        return self._parts.requests.why(id, objects, start)

    def event_partial(self, id: str, objects: Sequence[str], limit: int) -> PartialMatches:
        """The partial matches of a requested pattern (`reasoning_answers.partial`). Raises
        `UnknownRequest`."""
        return self._parts.requests.partial(id, objects, limit)

    def cancel_event(self, id: str) -> None:
        """Cancel a request; units without users stop. Raises `UnknownRequest`."""
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
        """Subscribe to a stream under a policy (`Subscriptions.start`). For ``since`` see
        `request_event`."""
        return self._parts.subscriptions.start(
            stream, policy, unit, parse_beginning(since), keyed=keyed
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
        """Subscribe to a feature of objects or a sort, instead of a stream ([Introspection15
        §4.4]); `Wish` explains the arguments. Without a plan the subscription waits for one. Raises
        `UnknownFeature`, `BadArguments` and `LanguageError`."""
        want = checked_want(self.ontology.vocabulary, feature, sort, objects)
        checked_strategy(strategy)
        check_quality(quality)
        if min(hold_off, hold_off if staleness is None else staleness - 1) < 0:
            raise BadArguments("staleness must be greater than 0, and hold_off at least 0")
        parsed = parse_policy(policy, unit)
        begin = parse_beginning(since)
        wish = Wish(want, strategy, parsed, begin, staleness, quality, hold_off, keyed)
        with self._parts.manager.together():
            return self._parts.subscriptions.start_adaptive(wish)

    def rematches(self, id: str) -> Sequence[Rematch]:
        """The switches of a subscription, oldest first. Raises `UnknownRequest`. The returned
        sequence grows with later switches."""
        return self._parts.subscriptions.rematches(id)

    def subscriptions(self) -> tuple[SubscriptionView, ...]:
        """The running subscriptions, oldest first."""
        return self._parts.subscriptions.views()

    def subscription_ids(self) -> tuple[str, ...]:
        """The ids of the running subscriptions, oldest first."""
        return self._parts.subscriptions.ids()

    def subscription(self, id: str) -> SubscriptionView:
        """The view of a subscription. Raises `UnknownRequest`."""
        return self._parts.subscriptions.view(id)

    def unsubscribe(self, id: str) -> None:
        """Cancel a subscription; its stream is removed with the last one that shares it. Raises
        `UnknownRequest`."""
        self._parts.subscriptions.cancel(id)

    # -- KPL ---------------------------------------------------------------------------------

    def add_kpl(self, text: str, unit: str = "ms") -> tuple[DeclarationView, ...]:
        """Add and start all declarations of a KPL text, or none; return the new ones. ``unit`` is
        the default unit of integers in the text. Raises `LanguageError`, and the errors of
        `Application.add`.
        """
        with self._parts.manager.together():
            added = self._parts.kpl.add(text, unit)
        return tuple(self._parts.kpl.view(key) for key in added)

    def kpl(self) -> tuple[DeclarationView, ...]:
        """The KPL declarations in order."""
        return self._parts.kpl.views()

    def kpl_text(self) -> str:
        """The KPL declarations as a text, integers in ms."""
        return self._parts.kpl.text()

    def kpl_declaration(self, name: str) -> tuple[DeclarationView, tuple[str, ...]]:
        """A declaration and the names of its dependents. Raises `UnknownDeclaration`."""
        return self._parts.kpl.view(name), self._parts.kpl.used_by(name)

    def restore_kpl(self, text: str, unit: str = "ms") -> None:
        """Add the declarations of a KPL text that are still valid, where an earlier run accepted
        all. The others are reported and stored, as after a restart. Raises nothing."""
        with self._parts.manager.together():
            self._parts.kpl.add_valid(text, unit)

    def forget_kpl(self, name: str) -> bool:
        """Remove a KPL declaration of an earlier run that was not restored; return whether there
        was one."""
        return self._parts.kpl.forget(name)

    def remove_kpl(self, name: str, *, cascade: bool = False) -> tuple[str, ...]:
        """Stop and remove a declaration (`Application.remove`)."""
        with self._parts.manager.together():
            return self._parts.kpl.remove(name, cascade=cascade)

    # -- specifications ----------------------------------------------------------------------

    def apply_specification(self, text: str | bytes) -> SpecificationView:
        """Insert and remove all units of an XML text ([Introspection15 §3.2]), or none. Raises
        `LanguageError`."""
        return self.take_specification(parse_specification(text))

    def take_specification(self, specification: Specification) -> SpecificationView:
        """Apply a specification that `parse_specification` parsed, maybe in another process."""
        with self._parts.manager.together():
            view = self._parts.specifications.apply(specification)
            self._parts.settle()
        return view

    def current_specification(self) -> str:
        """The running configuration as an XML text for `apply_specification`."""
        return self._parts.specifications.current()

    def insertions(self) -> tuple[InsertionView, ...]:
        """The insertions of specifications, in order."""
        return self._parts.specifications.views()

    # -- meaning -----------------------------------------------------------------------------

    def load_ontology(self, text: str, *, name: str, format: TextFormat = "turtle") -> None:
        """Add a domain ontology, or replace the one called ``name`` (an IRI). Running queries see
        its sorts, features and objects too. Raises `OntologyError`."""
        self.take_ontology(self.ontology.prepare(text, name=name, format=format))

    def take_ontology(self, prepared: PreparedOntology) -> None:
        """Install an ontology that `Ontology.prepare` parsed, maybe in another thread."""
        self._install(prepared)

    def removable_ontology(self, name: str) -> str:
        """Return the IRI of a loaded ontology that users may remove; ``name`` may be its short
        name. Raises `UnknownOntology`, and `Refused` for a shipped one."""
        graph = self.ontology.loaded(name)
        if graph is None:
            raise UnknownOntology(
                f"there is no ontology {name!r}", "GET /ontologies lists the loaded ones"
            )
        if is_shipped(graph):
            raise Refused(
                f"<{graph.value}> is part of DyKnow: each start loads it",
                "load an ontology of your own beside it",
            )
        return graph.value

    def remove_ontology(self, name: str) -> None:
        """Remove a loaded ontology. Raises `UnknownOntology`, `Refused` for a shipped one, and
        `OntologyInUse` while a text, a request or another ontology names its terms."""
        iri = self.removable_ontology(name)
        self.take_removal(name, self.ontology.prepare_removal(iri))

    def take_removal(self, name: str, prepared: PreparedOntology) -> None:
        """Remove an ontology by what `Ontology.prepare_removal` computed, maybe in another
        thread."""
        iri = self.removable_ontology(name)
        users = self._parts.users_of_terms({*prepared.lost, iri})
        ontologies = self.ontology.ontologies_naming(prepared.lost, prepared.graph)
        users = (*users, *(f"ontology {other}" for other in ontologies))
        if users:
            raise OntologyInUse(
                f"the terms of ontology <{iri}> are used by {', '.join(users)}",
                users,
                "remove or cancel these first",
            )
        self._install(prepared)

    def _install(self, prepared: PreparedOntology) -> None:
        self.ontology.install(prepared)
        self._parts.rdf.forget_all()
        self._parts.templates.publish()
        self._parts.rematching.ontology_changed()
        self._parts.settle()

    # -- matching and explanations -----------------------------------------------------------

    def match(
        self,
        feature: str,
        *,
        sort: str | None = None,
        objects: Sequence[str] = (),
        strategy: str = "fast",
    ) -> MatchView:
        """Match a feature without executing the plan; return the plan and the alternatives."""
        want = checked_want(self.ontology.vocabulary, feature, sort, objects)
        checked_strategy(strategy)
        (found,) = self._parts.plans.match_from([want], strategy, Since.NOW, explained=True)
        view = explanations.match_view(
            want, found, strategy, self._parts.manager.space, self._parts.plans.is_running
        )
        supplies = self._parts.plans.expand_supplies([found])
        texts = [plan_text(supply, self._parts.known_transformations) for supply in supplies]
        return replace(view, specification=next(iter(texts), None))

    def cost_of_node(self, node: Node) -> float:
        """What a node of a plan adds to its cost now."""
        return cost_of_node(node, self._parts.manager.space, self._parts.plans.is_running)

    def explain_running(self, id: str) -> str:
        """Return the text of `running_explanation`."""
        return self.running_explanation(id).text

    def explain(
        self, *, event: str | None = None, template: str | None = None, query: str | None = None
    ) -> str:
        """Return the text of `explanation`."""
        return self.explanation(event=event, template=template, query=query).text

    def running_explanation(self, id: str) -> Explanation:
        """Explain the stages of a running query or request. Raises `UnknownRequest`."""
        if self.queries.has(id):
            return self.queries.running_explanation(id)
        return self._parts.requests.running_explanation(id)

    def explanation(
        self,
        *,
        event: str | None = None,
        template: str | None = None,
        query: str | None = None,
        strategy: str = "fast",
    ) -> Explanation:
        """Explain a request, a template or a query, without starting it."""
        if event is not None:
            request = self.parse_request(event)
            found = self._parts.templates.of(request)
            return self._parts.requests.explanation(found, request, strategy)
        if template is not None:
            text = explanations.explain_template(self._parts.templates.find(template))
            return Explanation(text, (("template", text),))
        if query is not None:
            return self.queries.explanation(query)
        raise BadArguments("explain needs an event, a template or a query")

    @property
    def next_ids(self) -> tuple[str, str]:
        """The ids of the next request and the next subscription."""
        return (
            f"event{self._parts.requests.number + 1}",
            f"subscription{self._parts.subscriptions.number + 1}",
        )

    def keep_id(self, id: str) -> None:
        """Let the next request or subscription have ``id``, as in an earlier run, unless it is
        below an id that was used."""
        for part, number in self._numbered(id):
            part.number_after(number - 1)

    def skip_id(self, id: str) -> None:
        """Give ``id`` to no later request, subscription or unnamed query."""
        for part, number in self._numbered(id):
            part.number_after(number)
        self._parts.configuration.skip_reserved(id)

    def _numbered(self, id: str) -> Iterator[tuple[EventRequests | Subscriptions, int]]:
        """Yield the part that gives ids of this kind, and the number in ``id``."""
        requests, subscriptions = self._parts.requests, self._parts.subscriptions
        for name, part in (("event", requests), ("subscription", subscriptions)):
            number = id.removeprefix(name)
            if number != id and number.isdigit():
                yield part, int(number)

    def report_not_restored(self, reason: str) -> None:
        """Report on the status stream that a part of an earlier run was not restored."""
        self._parts.changed(Change(ChangeKind.NOT_RESTORED, specification=reason))

    def report_sink_failures(self, outcomes: Sequence[Outcome]) -> None:
        """Count outcomes of calls of sinks, and report failures on the status stream."""
        for outcome in outcomes:
            self._parts.application.record_outcome(outcome)
        self._parts.settle()

    def report_unkept(self, process: str, reason: str) -> None:
        """Report on the status stream that checkpoints lack the state of a user-written process."""
        self._parts.changed(
            Change(ChangeKind.STATE_LOST, transformation=process, specification=reason)
        )

    def totals(self) -> Totals:
        """The numbers of objects that clients have created. Cost: O(ontologies)."""
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
        """Resolve the name of an object to a term. An id without a prefix is in the namespace of
        the annotated streams if they share one, else in `dyknow:`.
        """
        if text == "self" or ":" in text or text.startswith("<"):
            return text
        return f"<{self.object_iri(text)}>"

    def object_iri(self, text: str) -> str:
        """The IRI of the object that a text names: as in `object_name`, but also of ``self``."""
        if text == "self":
            return self.ontology.vocabulary.self_object
        streams = [each.stream for each in self._parts.declared.annotations()]
        namespaces = {self._parts.configuration.namespaces[name] for name in streams}
        namespace = namespaces.pop() if len(namespaces) == 1 else DYKNOW
        return object_in_text(text, namespace)

    # -- internals ---------------------------------------------------------------------------

    def _refuse_if_source(self, name: str) -> None:
        if self._parts.application.uses_stream(name):
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
            self._parts.contents_of(name),
            self._parts.configuration.statements.get(name),
        )
