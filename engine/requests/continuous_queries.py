"""Continuous queries that people register without a template ([Events14 §III-V], SPEC §5).

A query names its streams (FROM STREAM), or they are found from the features that it needs, as for
events. Its results are a stream of its name; the windows themselves are kept beside, for people.
What is registered survives a restart, unless the system had to invent a name for it.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from ...continuous.algebra.options import Bounds, Options, Report, Semantics
from ...continuous.operators.results import WindowResult
from ...converters.to_triples import SampleConverter
from ...languages.csparql import parse_query
from ...languages.csparql.ast import ContinuousQuery
from ...languages.errors import LanguageError, Span
from ...languages.specification.ast import RESERVED
from ...matching.space import StreamSpace
from ...ontology.ontology import Ontology
from ...rdf.dictionary import TermDictionary
from ...rdf.namespaces import local_name
from ...templates.library import TemplateLibrary
from ..catalog.declared_streams import DeclaredStreams
from ..catalog.name_resolution import checked_strategy, did_you_mean
from ..configuration.configuration import Configuration
from ..model.beginning import beginning_of
from ..model.errors import (
    AlreadyExists,
    BadArguments,
    Conflict,
    NoResult,
    UnknownQuery,
)
from ..model.status_changes import Change, ChangeKind
from ..model.views import QueryView, Since
from ..planning import explain as explanations
from ..planning.plan_execution import Plans
from ..planning.query_start import Started, Starter, told_as_arguments
from ..planning.registrations import (
    Asked,
    Registration,
    check_same,
    registration_of,
    usual_semantics,
)
from ..units.query import QueryUnit
from ..units.shared_query import InstanceUnit, TemplateUnit
from .empty_reasons import why_empty


@dataclass(slots=True, eq=False)
class _Running:
    """A query at work under its name; ``is_named`` unless the system had to invent that."""

    name: str
    is_named: bool
    registration: Registration
    started: Started
    users: int = 1

    @property
    def unit(self) -> QueryUnit | InstanceUnit:
        return self.started.unit


@dataclass(frozen=True, slots=True)
class _Lost:
    """A query that cannot be started any more; what was asked is kept."""

    registration: Registration
    reason: str


class RegisteredQueries:
    """The queries that people registered; the engine's face for them.

    ``changed`` hears what cannot be restored; for the others see `Starter`.
    """

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
        converter_of: Callable[[str], SampleConverter | None],
    ) -> None:
        self._ontology = ontology
        self._dictionary = dictionary
        self._configuration = configuration
        self._plans = plans
        self._declared = declared
        self._changed = changed
        self._starter = Starter(
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
        """Start a query; registered again it is shared, with one user more.

        ``semantics`` is the dialect's unless given; ``name`` is what a query is to be called whose
        text says no name, if that is free. Raises `LanguageError`, `Refused` for a name
        that is not the user's to give, `AlreadyExists` for one that is taken, `UnknownStream`,
        `NotAnnotated`, `NoPlan`, `BadArguments`, `Forgotten` and `ConversionError`; nothing has
        begun then. For ``since`` see `Engine.request_event`.
        """
        query = parse_query(text)
        options = Options(semantics or usual_semantics(query.dialect), bounds, origin, report)
        return self.start(query, Asked(text.strip(), options, strategy, beginning_of(since)), name)

    def name_for(self, text: str, wanted: str = "") -> str:
        """What a query would be called, if nothing is in its way; ``wanted`` or the next free name
        where it says none or cannot be read."""
        try:
            name = parse_query(text).name
        except LanguageError:
            name = ""
        return _own_name(name) if name else wanted or self._configuration.next_reserved

    def start(self, query: ContinuousQuery, asked: Asked, wanted: str = "") -> QueryView:
        """The same for a query that was read already."""
        checked_strategy(asked.strategy)
        name = self._name_of(query, asked, wanted)
        known = self._running.get(name)
        if known is not None:
            check_same(name, known.registration.asked, asked)
            if self._starter.is_sound(known.started):
                known.users += 1
                known.unit.users += 1
                return self.view(name)
            self._stop(known)
        self._number += 1
        registration = Registration.of(self._number, asked, query)
        try:
            running = self._start(name, registration, query)
        except Exception as error:
            if known is not None:
                self._lost[name] = _Lost(known.registration, str(error))
            if isinstance(error, RecursionError):
                # The text is to blame, however many kinds of things in each other are bounded.
                raise LanguageError(
                    "the query is nested too deeply to be evaluated",
                    asked.source,
                    Span(0, 0),
                    "ask with several queries",
                ) from error
            raise
        if known is not None:
            running.users = running.unit.users = known.users + 1
        if query.name and not any(each.name.startswith(RESERVED) for each in running.started.reads):
            # Another run may give such a name to another stream.
            self._ontology.registered.queries[name] = registration.json()
        self._lost.pop(name, None)
        return self.view(name)

    def remove(self, name: str) -> None:
        """One user less; with the last the query stops. Raises `UnknownQuery`, and `Conflict` for
        the last one while others read its stream."""
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
                "remove or cancel what reads it first",
            )
        self._stop(running)
        self._declared.forget_annotation(name)
        self._ontology.registered.queries.pop(name, None)

    # -- asking ------------------------------------------------------------------------------

    def __len__(self) -> int:
        """How many there are, with those of an earlier run that do not hold."""
        return len(self._lost) + len(self._running)

    def views(self) -> tuple[QueryView, ...]:
        """The registered queries, oldest first, with those of an earlier run that do not hold."""
        return tuple(map(self.view, self.names()))

    def names(self) -> tuple[str, ...]:
        """Those of all of them, oldest first."""
        registrations = {name: lost.registration for name, lost in self._lost.items()}
        registrations |= {name: one.registration for name, one in self._running.items()}
        return tuple(sorted(registrations, key=lambda name: registrations[name].number))

    def has(self, name: str) -> bool:
        """Whether a query of this name runs."""
        return name in self._running

    def view(self, name: str) -> QueryView:
        """One query; raises `UnknownQuery`."""
        lost = self._lost.get(name)
        if lost is not None:
            return lost.registration.view(name, "not restored", lost.reason, 0)
        running = self._get(name)
        unit, output = running.unit, running.unit.output
        state, failure = self._state(running)
        view = running.registration.view(name, state, failure, running.users)
        latest = running.started.kept.latest
        evaluating = unit.template if isinstance(unit, InstanceUnit) else unit
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
            errors=evaluating.counters.errors,
            last_error=evaluating.counters.last_error,
            empty=why_empty(self._configuration, unit, self._ontology.vocabulary),
            plan=explanations.plan_view(self._configuration, unit),
        )

    def latest(self, name: str) -> WindowResult:
        """What the last window that closed gave; raises `UnknownQuery` and `NoResult`."""
        found = self._get(name).started.kept.latest
        if found is None:
            waiting = self.view(name).waits_for
            raise NoResult(
                f"no window of query {name!r} has closed yet",
                f"it waits for {', '.join(waiting)}"
                if waiting
                else "a window closes when its streams have passed its end",
            )
        return found

    def results(
        self,
        name: str,
        start: int | None = None,
        end: int | None = None,
        limit: int | None = None,
    ) -> Sequence[WindowResult]:
        """What kept windows gave; see `KeptWindows.between`. Raises `UnknownQuery`."""
        return self._get(name).started.kept.between(start, end, limit)

    def explain_running(self, name: str) -> str:
        """Each stage of a query that runs; raises `UnknownQuery`."""
        running = self._get(name)
        return explanations.running_query(
            running.registration.asked.source,
            [each.annotation for each in running.started.reads],
            running.started.matches,
            explanations.plan_text(self._configuration, running.unit),
            running.unit.explain(),
            running.started.alone,
        )

    def explain(self, text: str) -> str:
        """Each stage of a query that is not registered: nothing is started. Its streams need not
        exist. Raises `LanguageError`, `NoPlan` and `BadArguments`."""
        query = parse_query(text)
        known = self._ontology, self._dictionary
        with told_as_arguments():
            if query.streams:
                return explanations.query(query, *known, self._starter.flows(query))
            wanted = self._starter.needs(query)
            matches = self._plans.match(wanted.wants, "fast", explained=True)
            return explanations.inferred(query, wanted, matches, *known)

    def of_stream(self, stream: str) -> tuple[str, ...]:
        """The queries that a stream answers, as people call them."""
        return (f"query {stream}",) if stream in self._running else ()

    def converter(self, stream: str) -> SampleConverter | None:
        """Converts the samples of a query's stream to the triples that its head constructed; None
        of another stream, of a table, and where people have said what the stream contains."""
        running = self._running.get(stream)
        if running is None or self._declared.annotation_of(stream) is not None:
            return None
        return running.started.converter

    # -- an earlier run ----------------------------------------------------------------------

    def recall(self) -> tuple[str, ...]:
        """The names of the queries that an earlier run was told of; `restore` starts them."""
        kept = dict(self._ontology.registered.queries)
        for name, text in kept.items():
            try:
                self._lost[name] = _Lost(registration_of(text), "not started yet")
            except (ValueError, KeyError, TypeError, BadArguments) as error:
                reason = f"{type(error).__name__}: {error}\n{text}"
                self._changed(Change(ChangeKind.NOT_RESTORED, name, specification=reason))
        numbers = (lost.registration.number for lost in self._lost.values())
        self._number = max(numbers, default=0)
        return tuple(kept)

    def restore(self, restored: Callable[[str], None]) -> None:
        """Start what can be, in order of registration; ``restored`` hears of each."""
        for name, lost in sorted(self._lost.items(), key=_number_of):
            registration = lost.registration
            try:
                self._start(name, registration, parse_query(registration.asked.source))
            except Exception as error:  # noqa: BLE001  the engine starts without it, and says why
                self._lost[name] = replace(lost, reason=str(error))
                continue
            del self._lost[name]
            restored(name)

    def tell_lost(self) -> None:
        """Tell what could not be restored on the status stream; it is kept."""
        for name, lost in self._lost.items():
            reason = f"{lost.reason}\n{lost.registration.asked.source}"
            self._changed(Change(ChangeKind.NOT_RESTORED, name, specification=reason))

    # -- within ------------------------------------------------------------------------------

    def _name_of(self, query: ContinuousQuery, asked: Asked, wanted: str) -> str:
        """The name of the query and its stream; raises `Refused` and `AlreadyExists`."""
        if not query.name:
            for running in self._running.values():
                if not running.is_named and running.registration.asked == asked:
                    return running.name
            if wanted and not self._configuration.has(wanted):
                self._configuration.pass_over(wanted)
                return wanted
            return self._configuration.reserved_name()
        name = _own_name(query.name)
        if name not in self._running:
            self._declared.check_stream_name(name)
            if self._configuration.has(name):
                raise AlreadyExists(
                    f"there is a stream called {name!r}, and a query's results are a stream of "
                    "its name",
                    "give the query another name",
                )
        return name

    def _start(self, name: str, registration: Registration, query: ContinuousQuery) -> _Running:
        started = self._starter.start(name, query, registration.asked)
        started.unit.users += 1
        running = _Running(name, bool(query.name), registration, started)
        self._running[name] = running
        return running

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
        failure = self._configuration.failure_of(running.unit)
        if failure is not None:
            return "failed", failure
        return ("ended" if running.unit.output.is_ended else "running"), None

    def _readers(self, running: _Running) -> tuple[str, ...]:
        if self._configuration.units.get(running.name) is not running.unit:
            return ()
        streams = {unit.name: stream for stream, unit in self._configuration.units.items()}
        told: dict[str, None] = {}
        for reader in self._configuration.readers_of(running.name):
            made = [streams.get(reader, "")]
            if isinstance(self._configuration.units.get(made[0]), TemplateUnit):
                # It reads for those that share it.
                parts = self._configuration.readers_of(made[0])
                made = [streams.get(part, part) for part in parts]
            queries = [stream for stream in made if stream in self._running]
            told |= dict.fromkeys([f"query {name}" for name in queries] or [reader])
        return tuple(told)

    def _stop(self, running: _Running) -> None:
        del self._running[running.name]
        self._starter.stop(running.name, running.started)


def _own_name(name: str) -> str:
    """The name of a query's stream, by the one that its text gives it."""
    return local_name(name) if ":" in name else name


def _number_of(item: tuple[str, _Lost]) -> int:
    return item[1].registration.number
