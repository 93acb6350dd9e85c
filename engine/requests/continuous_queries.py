"""Registered continuous queries: queries without a template ([Events14 §III-V], SPEC §5).

A query names its streams (FROM STREAM), or matching finds them from the features that it needs, as
for events. Its results are a stream of its name; the last windows are kept too, with their terms.
The ontology stores registrations with a name over a restart; `accepted_commands` keeps the others.

The class is long, since names, registrations and running queries change together.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import dataclass, replace

from ...continuous.algebra.options import Bounds, Report, Semantics
from ...continuous.operators.results import WindowResult
from ...converters.to_triples import ToTriples
from ...languages.csparql.ast import ContinuousQuery
from ...languages.errors import LanguageError, Span
from ...languages.specification.ast import RESERVED
from ...matching.space import StreamSpace
from ...ontology.ontology import Ontology
from ...rdf.dictionary import TermDictionary
from ...rdf.namespaces import local_name
from ...reasoning.mtl.explanation import Explanation
from ...reasoning.patterns.recognition.explanation import ExplainedMatch, PartialMatches
from ...templates.library import TemplateLibrary
from ..catalog.declared_streams import DeclaredStreams
from ..catalog.name_resolution import checked_strategy, did_you_mean
from ..configuration.configuration import Configuration
from ..model.beginning import parse_beginning
from ..model.errors import (
    AlreadyExists,
    BadArguments,
    Conflict,
    DyknowError,
    NoResult,
    UnknownQuery,
)
from ..model.graph import Node, NodeKind
from ..model.named_terms import names_any
from ..model.status_changes import Change, ChangeKind
from ..model.views import QueryView, Since
from ..planning import explanations
from ..planning.plan_execution import Plans
from ..planning.query_start import (
    QueryStarter,
    RegisteredUnit,
    StartedQuery,
    bad_arguments_for_unsupported,
)
from ..planning.reasoning_start import bound_of, explain_bound
from ..planning.registrations import (
    AnyQuery,
    Registration,
    Submission,
    check_same,
    name_of,
    options_of,
    parse_registered,
    registration_of,
)
from ..units.reasoning.monitor import MonitorUnit
from ..units.reasoning.pattern import PatternUnit
from ..units.sharing.shared_query import QueryInstance, TemplateUnit
from . import reasoning_answers
from .empty_reasons import NO_WINDOW, note_query, why_empty


@dataclass(slots=True, eq=False)
class _Running:
    """A running query. Not ``is_named``: the system chose its name."""

    name: str
    is_named: bool
    registration: Registration
    started: StartedQuery
    users: int = 1

    @property
    def unit(self) -> RegisteredUnit:
        return self.started.unit


@dataclass(frozen=True, slots=True)
class _Lost:
    """A registration whose query could not be started again."""

    registration: Registration
    reason: str


class RegisteredQueries:
    """``changed`` gets the changes that report queries which cannot be restored; `QueryStarter`
    describes the other arguments."""

    def __init__(
        self,
        ontology: Ontology,
        dictionary: TermDictionary,
        templates: TemplateLibrary,
        configuration: Configuration,
        plans: Plans,
        space: StreamSpace,
        declared: DeclaredStreams,
        changed: Callable[[Change], None],
        converter_of: Callable[[str], ToTriples | None],
    ) -> None:
        self._ontology = ontology
        self._dictionary = dictionary
        self._configuration = configuration
        self._plans = plans
        self._declared = declared
        self._report = changed
        self._starter = QueryStarter(
            ontology, dictionary, templates, configuration, plans, space, converter_of
        )
        self._running: dict[str, _Running] = {}
        self._lost: dict[str, _Lost] = {}
        self._number = 0

    # -- registering -------------------------------------------------------------------------

    def register(
        self,
        text: str,
        *,
        semantics: Semantics | None = None,
        bounds: Bounds = "(]",
        origin: int = 0,
        report: Report = "non-empty",
        strategy: str = "fast",
        since: str = Since.NOW,
        name: str = "",
    ) -> QueryView:
        """Start a query. Registering an equal query again adds a user to it.

        ``semantics`` defaults to that of the dialect. ``name`` is used for a text without a name,
        if it is free. For ``since`` see `Engine.request_event`. Raises `LanguageError`, `Refused`
        for a reserved name, `AlreadyExists` for a name in use, `UnknownStream`, `NotAnnotated`,
        `NoPlan`, `BadArguments`, `Forgotten` and `ConversionError`, and starts nothing then.
        """
        query = parse_registered(text)
        options = options_of(query, semantics, bounds, origin, report)
        return self.start(
            query, Submission(text.strip(), options, strategy, parse_beginning(since)), name
        )

    def name_for(self, text: str, wanted: str = "") -> str:
        """Return the name that a query would get; for a text without a name, or with errors,
        ``wanted`` or the next reserved name."""
        try:
            name = name_of(parse_registered(text))
        except LanguageError:
            name = ""
        return _own_name(name) if name else wanted or self._configuration.next_reserved

    def start(self, query: AnyQuery, submission: Submission, wanted: str = "") -> QueryView:
        """`register` for a parsed query."""
        checked_strategy(submission.strategy)
        name = self._name_of(query, submission, wanted)
        existing = self._running.get(name)
        if existing is not None:
            check_same(name, existing.registration.submission, submission)
            if self._starter.is_valid(existing.started):
                existing.users += 1
                existing.unit.users += 1
                return self.view(name)
            # A unit failed, or a stream was removed or has another annotation: start it anew.
            self._stop(existing)
        self._number += 1
        registration = Registration.of(self._number, submission, query)
        try:
            running = self._start(name, registration, query)
        except Exception as error:
            if existing is not None:
                # It has stopped already; its registration stays, for a later attempt.
                self._lost[name] = _Lost(existing.registration, str(error))
            if isinstance(error, RecursionError):
                # Parsers bound the depth of each construct, but their combinations can be deeper.
                raise LanguageError(
                    "the query is nested too deeply to be evaluated",
                    submission.source,
                    Span(0, 0),
                    "split it into several queries",
                ) from error
            raise
        if existing is not None:
            # The new query takes over the users of the one that it replaces.
            running.users = running.unit.users = existing.users + 1
        if name_of(query) and not any(
            each.name.startswith(RESERVED) for each in running.started.reads
        ):
            # Another run may give a reserved name to another stream, so such a query is not stored.
            self._ontology.registered.queries[name] = registration.json()
        self._lost.pop(name, None)
        return self.view(name)

    def remove(self, name: str) -> None:
        """Remove a user; with the last one the query stops. Raises `UnknownQuery`, and `Conflict`
        for the last user while others read its stream."""
        if name in self._lost:
            del self._lost[name]
            self._ontology.registered.queries.pop(name, None)
            return
        running = self._get(name)
        if running.users > 1:
            running.users -= 1
            running.unit.users -= 1
            return
        readers = self._readers(running)
        if readers:
            raise Conflict(
                f"the stream of query {name!r} is read by {', '.join(readers)}",
                "remove or cancel these readers first",
            )
        self._stop(running)
        self._declared.forget_annotation(name)
        self._ontology.registered.queries.pop(name, None)

    # -- views -------------------------------------------------------------------------------

    def __len__(self) -> int:
        """The number of registered queries, with those that could not be restored."""
        return len(self._lost) + len(self._running)

    def views(self) -> tuple[QueryView, ...]:
        """The registered queries, oldest first, with those that could not be restored."""
        return tuple(map(self.view, self.names()))

    def names(self) -> tuple[str, ...]:
        """Their names, oldest first."""
        registrations = {name: lost.registration for name, lost in self._lost.items()}
        registrations |= {name: one.registration for name, one in self._running.items()}
        return tuple(sorted(registrations, key=lambda name: registrations[name].number))

    def has(self, name: str) -> bool:
        """Whether a query of this name runs."""
        return name in self._running

    def view(self, name: str) -> QueryView:
        """The view of a query. Raises `UnknownQuery`."""
        lost = self._lost.get(name)
        if lost is not None:
            return lost.registration.view(name, "not restored", lost.reason, 0)
        running = self._get(name)
        unit, output = running.unit, running.unit.output
        state, failure = self._state(running)
        view = running.registration.view(name, state, failure, running.users)
        latest = running.started.kept.latest
        counters = [unit.counters]
        if isinstance(unit, QueryInstance):
            # Its windows are evaluated there, its samples made here.
            counters.append(unit.template.counters)
        told = [each for each in counters if each.last_error is not None]
        return replace(
            view,
            stream=output.name,
            fields=output.schema.fields,
            reads=tuple(source.name for source in unit.reads),
            position=output.stream.last_number,
            waits_for=explanations.waits_for(self._configuration, unit),
            watermark=unit.least_watermark,
            held_back_by=explanations.held_back_by(self._configuration, unit),
            windows=len(running.started.kept),
            last_window=None if latest is None else latest.end,
            late=unit.late,
            errors=sum(each.errors for each in counters),
            last_error=told[0].last_error if told else None,
            empty=why_empty(self._configuration, unit, self._ontology),
            plan=explanations.plan_view(self._configuration, unit),
        )

    def nodes(self) -> Iterator[tuple[Node, str]]:
        """Yield the node of each running query, and the stream of its results."""
        for name, one in self._running.items():
            state, _ = self._state(one)
            yield (
                Node(NodeKind.QUERY, name, one.registration.kind.lower(), state),
                one.unit.output.name,
            )

    def unit(self, name: str) -> RegisteredUnit:
        """The unit of a query. Raises `UnknownQuery`."""
        return self._get(name).unit

    def latest(self, name: str) -> WindowResult:
        """The result of the last closed window. Raises `UnknownQuery` and `NoResult`."""
        running = self._get(name)
        if isinstance(running.unit, MonitorUnit | PatternUnit):
            what = running.registration.kind.lower()
            raise NoResult(
                f"{name!r} is a {what} and has no windows",
                f"its results are the samples of stream {name} (GET /streams/{name}/samples)",
            )
        found = running.started.kept.latest
        if found is None:
            view = self.view(name)
            hint = "a window closes when the watermarks of its streams have passed its end"
            if view.waits_for:
                hint = f"it waits for {', '.join(view.waits_for)}"
            elif view.empty is not None and not view.empty.endswith(NO_WINDOW):
                hint = view.empty
            raise NoResult(f"no window of query {name!r} has closed yet", hint)
        return found

    def results(
        self,
        name: str,
        start: int | None = None,
        end: int | None = None,
        limit: int | None = None,
    ) -> Sequence[WindowResult]:
        """The results of kept windows (`KeptWindows.between`). Raises `UnknownQuery`."""
        return self._get(name).started.kept.between(start, end, limit)

    def why(
        self, name: str, objects: Sequence[str], start: int
    ) -> Callable[[], Explanation | tuple[ExplainedMatch, ...]]:
        """Return the work that explains a verdict or a match, for another thread: see
        `reasoning_answers.why`. Raises `UnknownQuery`."""
        return reasoning_answers.why(name, self._get(name).unit, objects, start)

    def partial(self, name: str, objects: Sequence[str], limit: int) -> PartialMatches:
        """The partial matches of a pattern: see `reasoning_answers.partial`. Raises
        `UnknownQuery`."""
        return reasoning_answers.partial(name, self._get(name).unit, objects, limit)

    def explain_running(self, name: str) -> str:
        """Return the text of `running_explanation`."""
        return self.running_explanation(name).text

    def explain(self, text: str) -> str:
        """Return the text of `explanation`."""
        return self.explanation(text).text

    def running_explanation(self, name: str) -> explanations.Explanation:
        """Explain the stages of a running query. Raises `UnknownQuery`."""
        running = self._get(name)
        return explanations.explain_running_query(
            running.registration.submission.source,
            [each.annotation for each in running.started.reads],
            running.started.matches,
            explanations.plan_text(self._configuration, running.unit),
            running.unit.explain(),
            running.started.unshared,
            explanations.operators_of(running.unit),
        )

    def explanation(self, text: str) -> explanations.Explanation:
        """Explain the stages of a query without starting it. Its streams need not exist. Raises
        `LanguageError`, `NoPlan` and `BadArguments`."""
        query = parse_registered(text)
        context = self._ontology, self._dictionary
        if not isinstance(query, ContinuousQuery):
            bound = bound_of(query, text, self._ontology)
            found = self._plans.match_from(bound.needs.wants, "fast", Since.NOW, explained=True)
            return explanations.explain_reasoning_plan(text, found, explain_bound(bound))
        with bad_arguments_for_unsupported():
            if query.streams:
                return explanations.explain_query(query, *context, self._starter.flows(query))
            wanted = self._starter.needs(query)
            matches = self._plans.match_from(wanted.wants, "fast", Since.NOW, explained=True)
            return explanations.explain_matched_query(query, wanted, matches, *context)

    def naming(self, terms: Set[str]) -> tuple[str, ...]:
        """The queries that name one of ``terms``, with those that could not be restored."""
        registrations = {name: lost.registration for name, lost in self._lost.items()}
        registrations |= {name: one.registration for name, one in self._running.items()}
        return tuple(
            name
            for name, registration in registrations.items()
            if names_any(self._named(registration.submission.source), terms)
        )

    def _named(self, source: str) -> object:
        """A value with all terms that a text names. A text that is not valid any more names none:
        it cannot lose anything."""
        try:
            query = parse_registered(source)
            if isinstance(query, ContinuousQuery):
                return query
            return bound_of(query, source, self._ontology).needs
        except (LanguageError, DyknowError):
            return ()

    def of_stream(self, stream: str) -> tuple[str, ...]:
        """The query whose results are a stream, as ``query NAME``."""
        return (f"query {stream}",) if stream in self._running else ()

    def converter(self, stream: str) -> ToTriples | None:
        """The converter of a query's samples to the triples of its head; None for other streams,
        for tables, and for a stream with an annotation of its own, which takes precedence."""
        running = self._running.get(stream)
        if running is None or self._declared.annotation_of(stream) is not None:
            return None
        return running.started.converter

    # -- an earlier run ----------------------------------------------------------------------

    def recall(self) -> tuple[str, ...]:
        """Read the registrations of an earlier run and return their names; `restore` starts
        them."""
        kept = dict(self._ontology.registered.queries)
        for name, text in kept.items():
            try:
                self._lost[name] = _Lost(registration_of(text), "not started yet")
            except (ValueError, KeyError, TypeError, BadArguments) as error:
                reason = f"{type(error).__name__}: {error}\n{text}"
                self._report(Change(ChangeKind.NOT_RESTORED, name, specification=reason))
        numbers = (lost.registration.number for lost in self._lost.values())
        self._number = max(numbers, default=0)
        return tuple(kept)

    def restore(self, restored: Callable[[str], None]) -> None:
        """Start the recalled queries in order of registration; call ``restored`` with the name of
        each that starts."""
        for name, lost in sorted(self._lost.items(), key=lambda item: item[1].registration.number):
            registration = lost.registration
            try:
                self._start(name, registration, parse_registered(registration.submission.source))
            except Exception as error:  # noqa: BLE001  the engine starts without it, and reports it
                self._lost[name] = replace(lost, reason=str(error))
                continue
            del self._lost[name]
            restored(name)

    def report_lost(self) -> None:
        """Report on the status stream the queries that could not be restored. They are kept."""
        for name, lost in self._lost.items():
            reason = f"{lost.reason}\n{lost.registration.submission.source}"
            self._report(Change(ChangeKind.NOT_RESTORED, name, specification=reason))

    # -- internals ---------------------------------------------------------------------------

    def _name_of(self, query: AnyQuery, submission: Submission, wanted: str) -> str:
        """Return the name of the query and its stream. Raises `Refused` and `AlreadyExists`."""
        own = name_of(query)
        if not own:
            for running in self._running.values():
                if not running.is_named and running.registration.submission == submission:
                    return running.name
            if wanted and not self._configuration.has(wanted):
                # A replay brings the reserved name of the first run, which no later query may get.
                self._configuration.skip_reserved(wanted)
                return wanted
            return self._configuration.reserved_name()
        name = _own_name(own)
        if name not in self._running:
            self._declared.check_stream_name(name)
            if self._configuration.has(name):
                raise AlreadyExists(
                    f"there is a stream called {name!r}, and a query needs its name for the stream "
                    "of its results",
                    "give the query another name",
                )
        return name

    def _start(self, name: str, registration: Registration, query: AnyQuery) -> _Running:
        started = self._starter.start(name, query, registration.submission)
        started.unit.users += 1
        if isinstance(query, ContinuousQuery):
            note_query(started.unit, query, self._ontology)
        self._running[name] = _Running(name, bool(name_of(query)), registration, started)
        return self._running[name]

    def _get(self, name: str) -> _Running:
        found = self._running.get(name)
        if found is None:
            near = difflib.get_close_matches(name, self._running, n=3)
            raise UnknownQuery(
                f"there is no query called {name!r}",
                did_you_mean(near) or "GET /queries lists those that are registered",
            )
        return found

    def _state(self, running: _Running) -> tuple[str, str | None]:
        return self._configuration.state_of(running.unit, running.unit.output)

    def _readers(self, running: _Running) -> tuple[str, ...]:
        if self._configuration.units.get(running.name) is not running.unit:
            return ()
        streams = {unit.name: stream for stream, unit in self._configuration.units.items()}
        readers: dict[str, None] = {}
        for reader in self._configuration.readers_of(running.name):
            outputs = [streams.get(reader, "")]
            if isinstance(self._configuration.units.get(outputs[0]), TemplateUnit):
                # A shared query reads the stream for its instances: name these.
                parts = self._configuration.readers_of(outputs[0])
                outputs = [streams.get(part, part) for part in parts]
            queries = [stream for stream in outputs if stream in self._running]
            readers |= dict.fromkeys([f"query {name}" for name in queries] or [reader])
        return tuple(readers)

    def _stop(self, running: _Running) -> None:
        del self._running[running.name]
        self._starter.stop(running.name, running.started)


def _own_name(name: str) -> str:
    """Return the name of a query's stream for the name in its text."""
    return local_name(name) if ":" in name else name
