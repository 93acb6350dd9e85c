"""The parts of an engine: creates and connects them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..continuous.columns.budget import Budget
from ..converters.rdf.statements import SUBJECT
from ..converters.to_triples import ToTriples
from ..languages.ssl.annotation import Content, StreamAnnotation, id_fields
from ..ontology.ontology import Ontology
from ..rdf.dictionary import TermDictionary
from ..rdf.namespaces import DYKNOW, shorten
from ..streams.generator import StreamGenerator
from ..streams.sample import Mask, SampleBatch
from ..templates.library import TemplateLibrary
from .catalog.annotations import Annotations
from .catalog.declared_streams import DeclaredStreams
from .catalog.known_objects import KnownObjects, rows_about, statements_about
from .catalog.registered_transformations import RegisteredTransformations
from .catalog.semantics_manager import SemanticsManager
from .catalog.transformation_library import Transformations
from .configuration.configuration import Configuration
from .configuration.idle_streams import Idleness
from .configuration.ingest import Intake
from .configuration.policy_keys import contents_before_policies, policy_keys
from .kpl.application import Application
from .kpl.declarations import KplDeclarations
from .model.errors import Conflict
from .model.status_changes import Change, ChangeKind
from .model.status_stream import RETENTION, SCHEMA, STATUS, StatusStream
from .planning.plan_execution import Plans
from .processes.registry import Processes
from .processes.supervision import Runner
from .requests.continuous_queries import RegisteredQueries
from .requests.evaluation import Evaluation
from .requests.event_requests import EventRequests
from .requests.event_templates import EventTemplates
from .requests.rematching import Rematching
from .requests.sample_rdf import SampleRdf
from .requests.subscriptions import Subscriptions
from .specification.specifications import Specifications
from .units.backlog import Backlog, Turns
from .units.work_time import BusyTime, Stopwatch
from .users import TermUsers, Users


@dataclass(frozen=True, slots=True)
class EngineArguments:
    """The arguments of `Engine` that its parts need."""

    first_reserved: int
    processes: Processes
    runner: Runner
    stopwatch: Stopwatch | None
    budget: Budget
    turns: Turns | None
    rules: int


class Parts:
    """The parts of an engine, in order of dependency. ``clock`` returns the engine's time (ns).

    A part that changes something calls `changed`. That adds the change to the status stream and
    calls the listeners, in the order of `_listen`.
    """

    def __init__(
        self, ontology: Ontology, clock: Callable[[], int], arguments: EngineArguments
    ) -> None:
        self.ontology = ontology
        self.dictionary = TermDictionary()
        self.failures = 0
        """The number of failures on the status stream. A caller polls it to notice new failures."""
        self._status = StatusStream(clock)
        self.changed = self._status.report
        self._make_streams(arguments)
        self._make_requests(clock, arguments)
        self._listen()

    def _make_streams(self, arguments: EngineArguments) -> None:
        """Create the parts for streams, units and their meaning."""
        self.known_transformations = Transformations(self.ontology.vocabulary, arguments.processes)
        busy_time = None if arguments.stopwatch is None else BusyTime(arguments.stopwatch)
        self.backlog = Backlog(arguments.turns)
        """The units with windows to close; always empty without turns."""
        self.configuration = Configuration(
            self.changed, arguments.first_reserved, busy_time, self.backlog
        )
        self.configuration.rules.version = arguments.rules
        self.manager = SemanticsManager(self.ontology, self._subscribers)
        self.configuration.annotations = self.manager.annotations
        self.intake = Intake(self.configuration)
        self.idleness = Idleness()
        self.declared = DeclaredStreams(
            self.ontology, self.dictionary, self.configuration, self.changed
        )
        self.rdf = SampleRdf(
            self.configuration,
            self.declared,
            self.manager,
            self.dictionary,
            self._annotation_of_answer,
            self._query_converter,
        )
        self.transformations = RegisteredTransformations(
            self.ontology,
            self.known_transformations,
            self.configuration,
            self.changed,
            self.declared.check_name,
            self.manager.together,
        )
        self.objects = KnownObjects(self.ontology, self.configuration, self.manager.annotations)
        self.annotations = Annotations(
            self.ontology,
            self.declared,
            self.transformations,
            self.known_transformations,
            self.changed,
        )

    def _make_requests(self, clock: Callable[[], int], arguments: EngineArguments) -> None:
        """Create the parts for requests, queries, subscriptions, KPL and specifications."""
        self.library = TemplateLibrary(self.ontology)
        space = self.manager.space
        self.plans = Plans(
            self.ontology,
            self.dictionary,
            self.known_transformations,
            self.configuration,
            space,
            self.changed,
            arguments.runner,
            arguments.budget,
        )
        self.requests = EventRequests(
            self.ontology,
            self.dictionary,
            self.library,
            self.configuration,
            self.plans,
            space,
            self.changed,
        )
        self.templates = EventTemplates(
            self.ontology, self.library, self.requests, space, self.changed
        )
        self.queries = RegisteredQueries(
            self.ontology,
            self.dictionary,
            self.library,
            self.configuration,
            self.plans,
            space,
            self.declared,
            self.changed,
            self.rdf.converter,
        )
        self.application = Application(
            self.configuration,
            arguments.processes,
            runner=arguments.runner,
            check_name=self.declared.check_name,
            forget=self.declared.forget_annotation,
        )
        self.kpl = KplDeclarations(self.ontology, self.application, self.changed)
        self.subscriptions = Subscriptions(self.configuration)
        self.rematching = Rematching(
            self.ontology,
            self.dictionary,
            self.configuration,
            self.plans,
            space,
            clock,
            self.subscriptions.adapt,
        )
        self.subscriptions.rematch_with(self.rematching)
        self.specifications = Specifications(
            self.ontology,
            self.known_transformations,
            self.configuration,
            self.plans,
            self.subscriptions,
            self.changed,
            check_name=self.declared.check_name,
            users=Users(self.requests, self.queries, self.subscriptions, self.kpl),
        )
        self.users_of_terms = TermUsers(
            self.annotations,
            self.templates,
            self.requests,
            self.queries,
            self.subscriptions,
            self.kpl,
        )
        self.evaluation = Evaluation(
            self.configuration, self.backlog, self.requests, self.queries, self.subscriptions
        )

    def _listen(self) -> None:
        # The semantics manager first: the other listeners query the ontology and matching, which
        # have to include the change.
        for listener in (
            self.manager.mirror,
            self._on_change,
            self.plans.on_change,
            self.rematching.on_change,
            self.specifications.on_change,
        ):
            self._status.listen(listener)

    def restore(self, now: int) -> None:
        """Restore the definitions of an earlier run that the ontology stores."""
        self._status.open(self.configuration.add_stream(STATUS, SCHEMA, retention=RETENTION))
        self.transformations.report_all()
        for event, reason in self.library.broken.items():
            self.changed(Change(ChangeKind.NOT_RESTORED, shorten(event), specification=reason))
        self.transformations.restore()
        self.templates.publish()
        self.declared.restore_streams()
        for generator in self.configuration.streams.values():
            self.idleness.note_samples(generator, now)
        # KPL restores annotations as its streams start: policies depend on the annotations of
        # their inputs.
        with self.manager.together():
            self.kpl.restore(self.annotations.restore_one)
        # A query may read declared streams, streams of specifications and those of other queries,
        # and a specification may read those of queries. So queries are tried before and after
        # specifications, and annotations of a query's stream wait until the query has started.
        self.annotations.restore(later=self.queries.recall())
        with self.manager.together():
            self.queries.restore(self.annotations.restore_one)
            self.specifications.restore()
            self.queries.restore(self.annotations.restore_one)
        self.queries.report_lost()

    def settle(self) -> None:
        """Process the consequences of the last change until there are no more: KPL, annotations
        that units report, rematching."""
        with self.manager.together():
            self.application.settle()
            reports = self.configuration.reports
            while reports:
                self.annotations.apply_report(*reports.pop(0))
            self.rematching.settle()

    def collect(self) -> None:
        """Evict terms that have no holder."""
        # A half-done window uses terms that no holder reports.
        if not self.backlog.is_mid_window:
            self.dictionary.collect()

    def count_subscribers(self) -> None:
        """Mirror the number of readers of each stream in the ontology."""
        streams = self.configuration.streams.items()
        self.manager.count_subscribers(
            (name, each.subscribers + each.listeners) for name, each in streams
        )

    def _on_change(self, change: Change) -> None:
        """Count failures, and drop caches of a changed stream."""
        self.failures += change.kind in (ChangeKind.UNIT_FAILED, ChangeKind.UNIT_STOPPED_BY_RULE)
        if change.kind is ChangeKind.STREAM_REMOVED:
            self.intake.forget_keys(change.stream)
        self.rdf.forget(change.stream)

    def _subscribers(self, name: str) -> int:
        """The number of subscribers within the engine. Clients do not count, since matching must
        not depend on them."""
        generator = self.configuration.streams.get(name)
        return 0 if generator is None else generator.subscribers

    def contents_of(self, name: str) -> tuple[Content, ...]:
        """What a stream contains, by its annotation. That of a subscription to a feature has none,
        since matching must not see it; it contains the feature."""
        annotation = self.manager.annotations.get(name)
        if annotation is not None:
            return annotation.contents
        found = self.rematching.of_stream(name)
        return () if found is None else found.contents(self.ontology.vocabulary)

    def object_fields(self, generator: StreamGenerator) -> tuple[str, ...]:
        """The fields that name the objects of its samples; none if they are not known."""
        name = generator.name
        if name in self.configuration.statements:
            return (SUBJECT,)
        contents = self._contents_of_answer(name)
        if contents is not None:
            return id_fields(contents)
        return policy_keys(self.configuration, generator)

    def rows_about(self, generator: StreamGenerator, iri: str) -> Callable[[SampleBatch], Mask]:
        """Return a function from samples of a stream to those that are about an object. Raises
        `Conflict` for a stream whose objects are not known."""
        name = generator.name
        if name in self.configuration.statements:
            return lambda batch: statements_about(batch, iri)
        contents = self._contents_of_answer(name)
        if contents is None:
            contents = contents_before_policies(self.configuration, generator)
        if not contents:
            raise Conflict(
                f"what the samples of {name!r} are about is not known",
                "annotate the stream",
            )
        namespace = self.configuration.namespaces.get(name, DYKNOW)
        return lambda batch: rows_about(batch, contents, iri, namespace)

    def _contents_of_answer(self, name: str) -> tuple[Content, ...] | None:
        """What the samples of an answer or of a query's results contain; None: it is neither."""
        annotation = self._annotation_of_answer(name)
        if annotation is None:
            converter = self._query_converter(name)
            annotation = None if converter is None else converter.annotation
        return None if annotation is None else annotation.contents

    def _annotation_of_answer(self, name: str) -> StreamAnnotation | None:
        """The annotation by which the samples of an answer convert to triples."""
        found = self.rematching.of_stream(name)
        if found is None:
            return self.requests.rdf_of(name)
        return found.rdf(self.ontology.vocabulary)

    def _query_converter(self, name: str) -> ToTriples | None:
        return self.queries.converter(name)
