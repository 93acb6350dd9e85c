"""Event requests: start the units that answer them ([Events14 §V.B-C]).

request → template → query → needed features → semantic matching → streams and units → a C-SPARQL
unit over them. Equal requests share one stream.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias

from pyoxigraph import Variable

from ...continuous.sharing.similar_queries import Unshared
from ...languages.arguments import argument_text
from ...languages.csparql.ast import ContinuousQuery, EventRequest, Template
from ...languages.ssl.annotation import StreamAnnotation
from ...languages.templates import AnyTemplate
from ...matching.match import Match
from ...matching.space import StreamSpace
from ...ontology.ontology import Ontology
from ...rdf.dictionary import TermDictionary
from ...rdf.namespaces import shorten
from ...reasoning.mtl.explanation import Explanation
from ...reasoning.patterns.recognition.explanation import ExplainedMatch, PartialMatches
from ...streams.past_queries import Moment
from ...templates.defaults import completed_arguments
from ...templates.instantiate import ArgumentError
from ...templates.library import TemplateLibrary
from ...templates.needs import Needs, NeedsError
from ...templates.reasoning import Bound
from ..configuration.configuration import Configuration
from ..model.beginning import Beginning
from ..model.errors import BadArguments, NoPlan, UnknownRequest
from ..model.graph import Node, NodeKind
from ..model.named_terms import names_any
from ..model.status_changes import Change, ChangeKind
from ..model.views import EventView, Since
from ..planning import explanations
from ..planning.object_sharing import ObjectSharing
from ..planning.plan_execution import Plans
from ..planning.query_units import StartedUnit
from ..planning.reasoning_start import (
    ReasoningUnit,
    ShareableEvaluation,
    SharedUnit,
    result_annotation,
)
from ..planning.request_sharing import RequestSharing, Shareable, ShareableQuery
from ..planning.static_side import check_graphs
from ..planning.stream_binding import (
    find_streams,
    mean_the_same,
    supplies_of,
)
from ..units.query import QueryUnit
from ..units.reasoning.monitor import MonitorUnit
from ..units.reasoning.pattern import PatternUnit
from ..units.sharing.shared_monitor import MonitorInstance
from ..units.sharing.shared_pattern import PatternInstance
from ..units.sharing.shared_query import QueryInstance, TemplateUnit
from . import reasoning_answers
from .empty_reasons import note_query, why_empty

Body: TypeAlias = ContinuousQuery | Bound
"""What a template says, with the arguments of a request."""


@dataclass(frozen=True, slots=True, eq=False)
class _Running:
    """A unit that answers requests. ``annotation`` is that of its stream; by ``rdf`` its
    samples convert to triples; ``shareable`` is the query that it could share, while it runs alone,
    and ``alone`` says why it does.
    """

    unit: QueryUnit | QueryInstance | ReasoningUnit
    matches: tuple[Match, ...]
    annotation: StreamAnnotation | None
    rdf: StreamAnnotation | None
    shareable: Shareable | None
    alone: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class _Request:
    id: str
    number: int
    request: EventRequest
    strategy: str
    since: Beginning
    position: int
    key: tuple[object, ...]
    running: _Running


class EventRequests:
    """The requests that run, and the query units that answer them."""

    def __init__(
        self,
        ontology: Ontology,
        dictionary: TermDictionary,
        templates: TemplateLibrary,
        configuration: Configuration,
        plans: Plans,
        space: StreamSpace,
        changed: Callable[[Change], None],
    ) -> None:
        self._ontology = ontology
        self._dictionary = dictionary
        self._templates = templates
        self._configuration = configuration
        self._plans = plans
        self._space = space
        self._report = changed
        self._sharing = RequestSharing(ontology, templates, plans)
        self._by_object = ObjectSharing(templates, plans)
        self._requests: dict[str, _Request] = {}
        # `_running` is by key, for sharing, and `_answers` by output stream. A unit that is no
        # longer valid leaves the first when it is replaced, and the second when its users leave.
        self._running: dict[tuple[object, ...], _Running] = {}
        self._answers: dict[str, _Running] = {}
        self._number = 0

    def start(
        self, template: AnyTemplate, request: EventRequest, strategy: str, since: Beginning
    ) -> EventView:
        """Start the answer to ``request``. Raises `BadArguments`, `NoPlan` and `Forgotten`."""
        # A request that leaves defaults out equals one that writes them, and shares its stream.
        request = _completed(template, request)
        plan = None
        if isinstance(since, Moment) and since.before is not None:
            # The last times of the streams decide which time a duration means, so the key that
            # finds an equal request needs a plan first.
            plan = self._plan(template, request, strategy, since)
            since = self._plans.resolve_duration(since, supplies_of(plan[1]))
        key = _key(template, request, strategy, since)
        running = self._running.get(key)
        if running is None or not self._is_valid(running):
            query, matches = plan or self._plan(template, request, strategy, since)
            try:
                running = self._build(template, request, query, matches, strategy, since)
            except Exception:
                self._configuration.release_unused()
                raise
            self._running[key] = running
            self._answers[running.unit.output.name] = running
            if isinstance(query, ContinuousQuery):
                note_query(running.unit, query, self._ontology)
            if running.shareable is not None:
                # Requests that run alone are counted, so that the next one of their kind shares.
                self._sharing.add_alone(running.shareable)
            self._annotate(running)
        running.unit.users += 1
        # If an earlier request started the stream, its samples until now are not for this one.
        position = running.unit.output.stream.last_number if since is Since.NOW else 0
        self._number += 1
        id = f"event{self._number}"
        self._requests[id] = _Request(
            id, self._number, request, strategy, since, position, key, running
        )
        return self.view(id)

    @property
    def number(self) -> int:
        """The number of the latest request, whether it runs or not."""
        return self._number

    def number_after(self, number: int) -> None:
        """Let the next request have a number greater than this one and than the present ones."""
        self._number = max(self._number, number)

    def cancel(self, id: str) -> None:
        """Cancel a request. Raises `UnknownRequest`."""
        request = self._request(id)
        del self._requests[id]
        running = request.running
        if running.unit.users == 1:
            del self._answers[running.unit.output.name]
            # A newer unit may have replaced an invalid one under the same key.
            if self._running.get(request.key) is running:
                del self._running[request.key]
            if running.shareable is not None:
                self._sharing.remove_alone(running.shareable)
        self._configuration.release(running.unit)

    def forget(self, template: AnyTemplate) -> None:
        """Drop caches of a removed template."""
        self._sharing.forget(template)

    def __len__(self) -> int:
        """The number of running requests."""
        return len(self._requests)

    def views(self) -> tuple[EventView, ...]:
        """The running requests, oldest first."""
        return tuple(map(self.view, self.ids()))

    def ids(self) -> tuple[str, ...]:
        """The ids of the running requests, oldest first."""
        return tuple(self._requests)

    def of_event(self, event: str) -> tuple[str, ...]:
        """The ids of the running requests for ``event`` (an IRI)."""
        return tuple(r.id for r in self._requests.values() if r.request.event == event)

    def naming(self, terms: Set[str]) -> tuple[str, ...]:
        """The ids of the running requests whose event or arguments are one of ``terms``."""
        requests = self._requests.values()
        return tuple(
            r.id for r in requests if names_any((r.request.event, r.request.arguments), terms)
        )

    def of_stream(self, stream: str) -> tuple[str, ...]:
        """The ids of the requests whose answer is ``stream``."""
        requests = self._requests.values()
        return tuple(r.id for r in requests if r.running.unit.output.name == stream)

    def nodes(self) -> Iterator[tuple[Node, str]]:
        """Yield the node of each request, and the stream that answers it."""
        for one in self._requests.values():
            unit = one.running.unit
            state, _ = self._configuration.state_of(unit, unit.output)
            text = one.request.source.strip()
            yield Node(NodeKind.REQUEST, one.id, text, state), unit.output.name

    def view(self, id: str) -> EventView:
        """The view of a running request. Raises `UnknownRequest`."""
        request = self._request(id)
        running = request.running
        state, failure = self._configuration.state_of(running.unit, running.unit.output)
        return EventView(
            id=id,
            event=request.request.event,
            arguments=tuple(argument_text(argument) for argument in request.request.arguments),
            strategy=request.strategy,
            since=str(request.since),
            position=request.position,
            stream=running.unit.output.name,
            waits_for=explanations.waits_for(self._configuration, running.unit),
            held_back_by=explanations.held_back_by(self._configuration, running.unit),
            late=running.unit.late,
            plan=explanations.plan_view(self._configuration, running.unit),
            created=request.number,
            kind=_kind(running.unit),
            state=state,
            failure=failure,
            empty=why_empty(self._configuration, running.unit, self._ontology),
        )

    def rdf_of(self, stream: str) -> StreamAnnotation | None:
        """The annotation by which the samples of an answer convert to triples; None for another
        stream."""
        running = self._answers.get(stream)
        return None if running is None else running.rdf

    def running_explanation(self, id: str) -> explanations.Explanation:
        """Explain the plan of a running request and the evaluation of its query. Raises
        `UnknownRequest`."""
        running = self._request(id).running
        view = explanations.plan_view(self._configuration, running.unit)
        evaluation = running.unit.explain()
        if running.alone:
            evaluation += f"\nnot shared   {running.alone}"
        stages = ("units", view.text.rstrip()), ("evaluation", evaluation)
        text = "\n\n".join(text for _, text in stages)
        operators = explanations.operators_of(running.unit)
        return explanations.Explanation(text, stages, operators=operators)

    def why(
        self, id: str, objects: Sequence[str], start: int
    ) -> Callable[[], Explanation | tuple[ExplainedMatch, ...]]:
        """Return the work that explains a verdict or a match, for another thread: see
        `reasoning_answers.why`. Raises `UnknownRequest`."""
        return reasoning_answers.why(id, self._request(id).running.unit, objects, start)

    def partial(self, id: str, objects: Sequence[str], limit: int) -> PartialMatches:
        """The partial matches of a pattern: see `reasoning_answers.partial`. Raises
        `UnknownRequest`."""
        return reasoning_answers.partial(id, self._request(id).running.unit, objects, limit)

    def explanation(
        self, template: AnyTemplate, request: EventRequest, strategy: str
    ) -> explanations.Explanation:
        """Explain the stages of answering ``request`` without starting it."""
        request = _completed(template, request)
        query, wanted = self._query(template, request)
        matches = self._plans.match_from(wanted.wants, strategy, Since.NOW, explained=True)
        return explanations.explain_request(
            template, request, query, wanted, matches, self._ontology, self._dictionary
        )

    def _request(self, id: str) -> _Request:
        found = self._requests.get(id)
        if found is None:
            raise UnknownRequest(f"there is no request {id!r}", "GET /events lists those that run")
        return found

    def _query(self, template: AnyTemplate, request: EventRequest) -> tuple[Body, Needs]:
        try:
            query = self._templates.instantiate(template, request.arguments)
            return query, self._templates.needs(query)
        except ArgumentError as error:
            raise BadArguments(error.message, error.hint) from error
        except NeedsError as error:
            raise NoPlan(error.message, (), error.hint) from error

    def _plan(
        self, template: AnyTemplate, request: EventRequest, strategy: str, since: Beginning
    ) -> tuple[Body, tuple[Match, ...]]:
        query, wanted = self._query(template, request)
        if isinstance(query, ContinuousQuery):
            check_graphs(self._ontology, query.static, query.static_named)
        event = shorten(request.event)
        return query, find_streams(self._plans, wanted, strategy, since, event)

    def _build(
        self,
        template: AnyTemplate,
        request: EventRequest,
        query: Body,
        matches: Sequence[Match],
        strategy: str,
        since: Beginning,
    ) -> _Running:
        """Start the units of the matches, then the query unit, or an instance of a shared query."""
        supplies = supplies_of(matches)
        if not isinstance(query, ContinuousQuery):
            return self._build_reasoning(template, request, query, matches, strategy, since)
        assert isinstance(template, Template)
        shareable = None
        # A shared query runs already, and cannot give a request its past.
        if since is Since.NOW:
            shareable = self._sharing.find_shareable(template, request, query, matches, strategy)
        if shareable is not None and self._shares_query(shareable):
            queries = self._plans.queries
            start = partial(
                queries.start_template, shareable.query, shareable.supplies, shareable.nodes
            )
            unit = self._configuration.share(shareable.unit_key, start)
            assert isinstance(unit, TemplateUnit)
            text = request.source.strip()
            built: StartedUnit[Any] = queries.start_instance(
                unit, query, supplies, text, shareable.objects
            )
            shareable = None
        else:
            built = self._plans.queries.start(query, supplies, since)
        return _Running(built.unit, tuple(matches), built.annotation, built.rdf, shareable)

    def _build_reasoning(
        self,
        template: AnyTemplate,
        request: EventRequest,
        bound: Bound,
        matches: Sequence[Match],
        strategy: str,
        since: Beginning,
    ) -> _Running:
        """Start the units of the matches, then the formula or pattern, or an instance of a shared
        pattern."""
        text = request.source.strip()
        starter = self._plans.reasoning
        shareable, alone = None, ""
        unit: ReasoningUnit
        try:
            if since is not Since.NOW:
                raise Unshared("it begins in the past")
            shareable = self._by_object.find_shareable(template, request, bound, matches, strategy)
            self._check_sharing(shareable)
        except Unshared as reason:
            alone = str(reason)
            unit = starter.start(bound, supplies_of(matches), since, request=text)
        else:
            shared = self._configuration.share(
                shareable.key, partial(starter.start_shared, shareable)
            )
            assert isinstance(shared, SharedUnit)
            unit, shareable = starter.start_instance(shared, shareable, text), None
        annotation = result_annotation(request.event, unit)
        return _Running(unit, tuple(matches), annotation, annotation, shareable, alone)

    def _shares_query(self, shareable: ShareableQuery) -> bool:
        """Whether a request joins the shared query that runs, or begins one."""
        shared = self._configuration.find_shared(shareable.unit_key)
        if isinstance(shared, TemplateUnit):
            return shared.can_enter(shareable.objects)
        return self._sharing.is_worth_it(shareable)

    def _check_sharing(self, shareable: ShareableEvaluation) -> None:
        """Raise `Unshared` unless a request joins the shared evaluation that runs, or begins
        one."""
        shared = self._configuration.find_shared(shareable.key)
        if shared is None and not self._sharing.is_worth_it(shareable):
            raise Unshared("it was the first of its kind")
        if isinstance(shared, SharedUnit) and not shared.can_enter:
            raise Unshared(
                "a silent stream has gone on, which the shared evaluation had not waited for"
            )

    def _is_valid(self, running: _Running) -> bool:
        """Whether the unit works, and its streams have the annotations that they had."""
        broken = self._configuration.is_broken(running.unit)
        return not broken and mean_the_same(running.matches, self._space)

    def _annotate(self, running: _Running) -> None:
        if running.annotation is not None:
            self._report(
                Change(
                    ChangeKind.STREAM_ANNOTATED,
                    running.unit.output.name,
                    specification=running.annotation.source,
                    annotation=running.annotation,
                )
            )


def _completed(template: AnyTemplate, request: EventRequest) -> EventRequest:
    """The request with an argument for each parameter. Raises `BadArguments`."""
    try:
        arguments = completed_arguments(template, request)
    except ArgumentError as error:
        raise BadArguments(error.message, error.hint) from error
    return replace(request, arguments=arguments, named=())


def _kind(unit: QueryUnit | QueryInstance | ReasoningUnit) -> str:
    if isinstance(unit, MonitorUnit | MonitorInstance):
        return "MONITOR"
    return "PATTERN" if isinstance(unit, PatternUnit | PatternInstance) else "QUERY"


def _key(
    template: AnyTemplate, request: EventRequest, strategy: str, since: Beginning
) -> tuple[object, ...]:
    """Return the key of a request. Equal keys share a stream; names of variables do not matter."""
    arguments = tuple(
        None if isinstance(argument, Variable) else argument for argument in request.arguments
    )
    # A template may be replaced under its name, and then its requests are different ones.
    return (template.source, arguments, strategy, since)
