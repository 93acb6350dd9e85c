"""What an engine is made of, put together and told of each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..continuous.columns.budget import Budget
from ..converters.to_triples import SampleConverter
from ..languages.ssl.annotation import StreamAnnotation
from ..ontology.ontology import Ontology
from ..rdf.dictionary import TermDictionary
from ..rdf.namespaces import shorten
from ..templates.library import TemplateLibrary
from .catalog.annotations import Annotations
from .catalog.declared_streams import DeclaredStreams
from .catalog.registered_transformations import RegisteredTransformations
from .catalog.semantics_manager import SemanticsManager
from .catalog.transformation_library import Transformations
from .configuration.configuration import Configuration
from .configuration.idle_streams import Idleness
from .configuration.ingest import Intake
from .kpl.application import Application
from .kpl.declarations import KplDeclarations
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
from .specification.apply import Specifications
from .units.backlog import Backlog, Turns
from .units.work_time import BusyTime, Stopwatch
from .users import Users


@dataclass(frozen=True, slots=True)
class Setting:
    """What an engine is given; see `Engine`."""

    first_reserved: int
    processes: Processes
    runner: Runner
    stopwatch: Stopwatch | None
    budget: Budget
    turns: Turns | None
    rules: int


class Parts:
    """The parts of an engine, each made of those before it. ``clock`` gives the engine's time (ns).

    Who changes something tells `changed`; the status stream has it from there, and so have all that
    listen, in the order of `_listen`.
    """

    def __init__(self, ontology: Ontology, clock: Callable[[], int], given: Setting) -> None:
        self.ontology = ontology
        self.dictionary = TermDictionary()
        self.failures = 0
        """Number of failures on the status stream: while it stays, nothing more has failed."""
        self._status = StatusStream(clock)
        self.changed = self._status.report
        self._make_streams(given)
        self._make_requests(clock, given)
        self._listen()

    def _make_streams(self, given: Setting) -> None:
        """What streams and units there are, and what is known of them."""
        self.known_transformations = Transformations(self.ontology.vocabulary, given.processes)
        busy_time = None if given.stopwatch is None else BusyTime(given.stopwatch)
        self.backlog = Backlog(given.turns)
        """Units whose windows take long, if there are turns for them."""
        self.configuration = Configuration(
            self.changed, given.first_reserved, busy_time, self.backlog
        )
        self.configuration.rules.version = given.rules
        self.manager = SemanticsManager(self.ontology, self._subscribers)
        self.configuration.annotations = self.manager.annotations
        self.intake = Intake(self.configuration)
        self.idleness = Idleness()
        self.declared = DeclaredStreams(
            self.ontology, self.dictionary, self.configuration, self.changed
        )
        self.rdf = SampleRdf(
            self.configuration, self.declared, self.manager, self._answered, self._of_query
        )
        self.transformations = RegisteredTransformations(
            self.ontology,
            self.known_transformations,
            self.configuration,
            self.changed,
            self.declared.check_name,
            self.manager.together,
        )
        self.annotations = Annotations(
            self.ontology,
            self.declared,
            self.transformations,
            self.known_transformations,
            self.changed,
        )

    def _make_requests(self, clock: Callable[[], int], given: Setting) -> None:
        """What people ask for."""
        self.library = TemplateLibrary(self.ontology)
        space = self.manager.space
        self.plans = Plans(
            self.ontology,
            self.dictionary,
            self.known_transformations,
            self.configuration,
            space,
            self.changed,
            given.runner,
            given.budget,
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
            given.processes,
            runner=given.runner,
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
            self.subscriptions.adapted,
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
        self.evaluation = Evaluation(
            self.configuration, self.backlog, self.requests, self.queries, self.subscriptions
        )

    def _listen(self) -> None:
        # What the ontology and matching know of a change comes first: who is told next asks them.
        for listener in (
            self.manager.mirror,
            self._heard,
            self.plans.heard,
            self.rematching.heard,
            self.specifications.heard,
        ):
            self._status.listen(listener)

    def restore(self, now: int) -> None:
        """Take up again what an earlier run was told, as the ontology keeps it."""
        self._status.open(self.configuration.add_stream(STATUS, SCHEMA, retention=RETENTION))
        self.transformations.report_all()
        for event, reason in self.library.broken.items():
            self.changed(Change(ChangeKind.NOT_RESTORED, shorten(event), specification=reason))
        self.transformations.restore()
        self.templates.tell()
        self.declared.restore_streams()
        for generator in self.configuration.streams.values():
            self.idleness.note_samples(generator, now)
        # Policies depend on the annotations of the streams that they read.
        with self.manager.together():
            self.kpl.restore(self.annotations.restore_one)
        # Queries read streams that are declared, annotated, specified, and each other's; what is
        # said of their own streams, and specifications that read these, wait for them.
        self.annotations.restore(later=self.queries.recall())
        with self.manager.together():
            self.queries.restore(self.annotations.restore_one)
            self.specifications.restore()
            self.queries.restore(self.annotations.restore_one)
        self.queries.tell_lost()

    def settle(self) -> None:
        """Carry out what the last change has caused, until nothing more follows."""
        with self.manager.together():
            self.application.settle()
            reports = self.configuration.reports
            while reports:
                self.annotations.apply_report(*reports.pop(0))
            self.rematching.settle()

    def collect(self) -> None:
        """Forget terms that nobody has any more."""
        # What is half done holds terms that nobody knows of.
        if not self.backlog.is_mid_window:
            self.dictionary.collect()

    def count_subscribers(self) -> None:
        """Mirror how many read each stream."""
        streams = self.configuration.streams.items()
        self.manager.count_subscribers(
            (name, each.subscribers + each.listeners) for name, each in streams
        )

    def _heard(self, change: Change) -> None:
        """What is remembered of a stream holds no more."""
        self.failures += change.kind in (ChangeKind.UNIT_FAILED, ChangeKind.UNIT_STOPPED_BY_RULE)
        if change.kind is ChangeKind.STREAM_REMOVED:
            self.intake.forget_keys(change.stream)
        self.rdf.forget(change.stream)

    def _subscribers(self, name: str) -> int:
        """Those within the engine: what is matched does not depend on who looks on."""
        generator = self.configuration.streams.get(name)
        return 0 if generator is None else generator.subscribers

    def _answered(self, name: str) -> StreamAnnotation | None:
        """How samples of what the system answers are written as triples."""
        found = self.rematching.of_stream(name)
        if found is None:
            return self.requests.rdf_of(name)
        return found.rdf(self.ontology.vocabulary)

    def _of_query(self, name: str) -> SampleConverter | None:
        return self.queries.converter(name)
