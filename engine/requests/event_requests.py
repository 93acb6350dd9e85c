"""Event requests: from what somebody wants to know to the units that answer it
([Events14 §V.B-C]).

request → template → query → needed features → semantic matching → streams and units → a C-SPARQL
unit over them. Requests for the same thing share one stream.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from pyoxigraph import Literal, Variable

from ...languages.csparql.ast import ContinuousQuery, EventRequest, Template
from ...languages.ssl.annotation import StreamAnnotation
from ...matching.match import Match
from ...matching.space import StreamSpace
from ...matching.strategy import Kind
from ...ontology.ontology import Ontology
from ...rdf.dictionary import TermDictionary
from ...rdf.namespaces import XSD, shorten
from ...streams.past_queries import Moment
from ...templates.instantiate import ArgumentError, instantiate
from ...templates.library import TemplateLibrary
from ...templates.needs import Needs, NeedsError
from ..configuration.configuration import Configuration
from ..model.beginning import Beginning
from ..model.errors import BadArguments, NoPlan, UnknownRequest
from ..model.status_changes import Change, ChangeKind
from ..model.views import EventView, Since
from ..planning import explain as explanations
from ..planning.plan_execution import Plans
from ..planning.query_units import BuiltQuery
from ..planning.request_sharing import Common, Sharing
from ..planning.stream_binding import (
    check_graphs,
    find_streams,
    mean_the_same,
    supplies_of,
)
from ..units.query import QueryUnit
from ..units.shared_query import InstanceUnit, TemplateUnit
from .empty_reasons import why_empty

_SHORT = {
    XSD + "integer": re.compile(r"[+-]?[0-9]+"),
    XSD + "decimal": re.compile(r"[+-]?[0-9]*\.[0-9]+"),
    XSD + "double": re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)[eE][+-]?[0-9]+"),
    XSD + "boolean": re.compile(r"true|false"),
}
"""Literals that SPARQL writes without quotes and datatype."""


@dataclass(frozen=True, slots=True, eq=False)
class _Running:
    """One C-SPARQL unit that answers requests, with what was decided when it started.

    ``annotation`` says what its stream means, ``rdf`` how its samples are written as triples;
    ``common``, with whom it could share what it computes by itself.
    """

    unit: QueryUnit | InstanceUnit
    matches: tuple[Match, ...]
    annotation: StreamAnnotation | None
    rdf: StreamAnnotation | None
    common: Common | None


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
        self._changed = changed
        self._sharing = Sharing(ontology, templates, plans)
        self._requests: dict[str, _Request] = {}
        # By what was asked, to share; by the stream it makes, to say what that means. One that is
        # not sound any more is shared no longer, and still makes its stream.
        self._running: dict[tuple[object, ...], _Running] = {}
        self._answers: dict[str, _Running] = {}
        self._number = 0

    def start(
        self, template: Template, request: EventRequest, strategy: str, since: Beginning
    ) -> EventView:
        """Answer ``request`` by the streams there are; raises `BadArguments`, `NoPlan` and
        `Forgotten`."""
        plan = None
        if isinstance(since, Moment) and since.before is not None:
            # Which time a duration means, and so with whom it is shared, its streams say.
            plan = self._plan(template, request, strategy, since)
            since = self._plans.settled(since, supplies_of(plan[1]))
        key = _key(template, request, strategy, since)
        running = self._running.get(key)
        if running is None or not self._is_sound(running):
            query, matches = plan or self._plan(template, request, strategy, since)
            try:
                running = self._build(template, request, query, matches, strategy, since)
            except Exception:
                self._configuration.release_unused()
                raise
            self._running[key] = running
            self._answers[running.unit.output.name] = running
            if running.common is not None:
                self._sharing.began_alone(running.common)
            self._tell_meaning(running)
        running.unit.users += 1
        # Of a stream that others asked for before, what came until now is their past.
        position = running.unit.output.stream.last_number if since is Since.NOW else 0
        self._number += 1
        id = f"event{self._number}"
        self._requests[id] = _Request(
            id, self._number, request, strategy, since, position, key, running
        )
        return self.view(id)

    @property
    def number(self) -> int:
        """That of the latest request, whether it runs or not."""
        return self._number

    def number_after(self, number: int) -> None:
        """The next request has a number after this one, and after those there are."""
        self._number = max(self._number, number)

    def cancel(self, id: str) -> None:
        """One user less; raises `UnknownRequest`."""
        request = self._request(id)
        del self._requests[id]
        running = request.running
        if running.unit.users == 1:
            del self._answers[running.unit.output.name]
            # One that is not sound any more may have been replaced under the same key since.
            if self._running.get(request.key) is running:
                del self._running[request.key]
            if running.common is not None:
                self._sharing.ended_alone(running.common)
        self._configuration.release(running.unit)

    def forget(self, template: Template) -> None:
        """``template`` is gone."""
        self._sharing.forget(template)

    def __len__(self) -> int:
        """How many requests run."""
        return len(self._requests)

    def views(self) -> tuple[EventView, ...]:
        """The running requests, oldest first."""
        return tuple(map(self.view, self.ids()))

    def ids(self) -> tuple[str, ...]:
        """Those of the running requests, oldest first."""
        return tuple(self._requests)

    def of_event(self, event: str) -> tuple[str, ...]:
        """The ids of the requests that run for ``event`` (an IRI)."""
        return tuple(r.id for r in self._requests.values() if r.request.event == event)

    def of_stream(self, stream: str) -> tuple[str, ...]:
        """The ids of the requests that a stream answers."""
        requests = self._requests.values()
        return tuple(r.id for r in requests if r.running.unit.output.name == stream)

    def view(self, id: str) -> EventView:
        """One running request; raises `UnknownRequest`."""
        request = self._request(id)
        running = request.running
        return EventView(
            id=id,
            event=request.request.event,
            arguments=tuple(_argument_text(argument) for argument in request.request.arguments),
            strategy=request.strategy,
            since=str(request.since),
            position=request.position,
            stream=running.unit.output.name,
            waits_for=explanations.waits_for(self._configuration, running.unit),
            held_back_by=explanations.held_back_by(self._configuration, running.unit),
            late=running.unit.late,
            plan=explanations.plan_view(self._configuration, running.unit),
            created=request.number,
            failure=self._configuration.failure_of(running.unit),
            empty=why_empty(self._configuration, running.unit, self._ontology.vocabulary),
        )

    def rdf_of(self, stream: str) -> StreamAnnotation | None:
        """How samples of a request's answer are written as triples; None for another stream."""
        running = self._answers.get(stream)
        return None if running is None else running.rdf

    def explain_running(self, id: str) -> str:
        """What answers a running request, and how its query is evaluated; raises
        `UnknownRequest`."""
        unit = self._request(id).running.unit
        view = explanations.plan_view(self._configuration, unit)
        return f"{view.text.rstrip()}\n\n{unit.explain()}"

    def explain(self, template: Template, request: EventRequest) -> str:
        """Each stage of answering ``request``, without starting anything."""
        query, wanted = self._query(template, request)
        matches = self._plans.match(wanted.wants, str(Kind.FAST), explained=True)
        return explanations.request(
            template, request, query, wanted, matches, self._ontology, self._dictionary
        )

    def _request(self, id: str) -> _Request:
        found = self._requests.get(id)
        if found is None:
            raise UnknownRequest(f"there is no request {id!r}", "GET /events lists those that run")
        return found

    def _query(self, template: Template, request: EventRequest) -> tuple[ContinuousQuery, Needs]:
        vocabulary = self._ontology.vocabulary
        try:
            query = instantiate(template, request.arguments, vocabulary)
            return query, self._templates.needs(query)
        except ArgumentError as error:
            raise BadArguments(error.message, error.hint) from error
        except NeedsError as error:
            raise NoPlan(error.message, (), error.hint) from error

    def _plan(
        self, template: Template, request: EventRequest, strategy: str, since: Beginning
    ) -> tuple[ContinuousQuery, tuple[Match, ...]]:
        query, wanted = self._query(template, request)
        check_graphs(self._ontology, query)
        asked = shorten(request.event)
        return query, find_streams(self._plans, wanted, strategy, since, asked)

    def _build(
        self,
        template: Template,
        request: EventRequest,
        query: ContinuousQuery,
        matches: Sequence[Match],
        strategy: str,
        since: Beginning,
    ) -> _Running:
        """Start what the matches ask for, inputs first, then the query unit, or its part in the
        query that others have as well."""
        supplies = supplies_of(matches)
        common = None
        if since is Since.NOW:
            common = self._sharing.common(template, request, query, matches, strategy)
        if common is not None and self._sharing.is_worth_it(common):
            start = partial(self._plans.queries.start_template, common.query, common.supplies)
            unit = self._configuration.share(common.key, start)
            assert isinstance(unit, TemplateUnit)
            built: BuiltQuery[Any] = self._plans.queries.start_instance(
                unit, query, supplies, request.source.strip()
            )
            common = None
        else:
            built = self._plans.queries.start(query, supplies, since)
        return _Running(built.unit, tuple(matches), built.annotation, built.rdf, common)

    def _is_sound(self, running: _Running) -> bool:
        """It works, and the streams it reads mean what they meant when it started."""
        broken = self._configuration.is_broken(running.unit)
        return not broken and mean_the_same(running.matches, self._space)

    def _tell_meaning(self, running: _Running) -> None:
        if running.annotation is not None:
            self._changed(
                Change(
                    ChangeKind.STREAM_ANNOTATED,
                    running.unit.output.name,
                    specification=running.annotation.source,
                    annotation=running.annotation,
                )
            )


def _key(
    template: Template, request: EventRequest, strategy: str, since: Beginning
) -> tuple[object, ...]:
    """Requests with equal keys want the same stream: the name of a variable does not matter."""
    arguments = tuple(
        None if isinstance(argument, Variable) else argument for argument in request.arguments
    )
    return (template.source, arguments, strategy, since)


def _argument_text(argument: object) -> str:
    """As people write it in a request; read again it is the same term."""
    if isinstance(argument, Literal):
        pattern = _SHORT.get(argument.datatype.value)
        if pattern is not None and pattern.fullmatch(argument.value):
            return argument.value
    text = str(argument)
    return shorten(text[1:-1]) if text.startswith("<") else text
