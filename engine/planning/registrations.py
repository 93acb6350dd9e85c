"""Registrations of continuous queries: compared, stored over a restart, and shown."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TypeAlias

from ...continuous.algebra.options import Bounds, Options, Report, Semantics
from ...languages.csparql import parse_query
from ...languages.csparql.ast import ContinuousQuery, Dialect
from ...languages.mtl import Monitor, is_monitor, parse_monitor
from ...languages.patterns import (
    Pattern,
    is_pattern,
    language_of,
    parse_pattern,
    registered_name,
)
from ..model.beginning import Beginning, parse_beginning
from ..model.errors import AlreadyExists, BadArguments
from ..model.views import QueryView

AnyQuery: TypeAlias = ContinuousQuery | Monitor | Pattern
"""What a client may register under a name."""
MTL = "MTL"
"""The dialect of monitors."""


def parse_registered(text: str) -> AnyQuery:
    """Parse a continuous query, a monitor or a pattern. Raises `LanguageError`."""
    if is_pattern(text):
        return parse_pattern(text)
    return parse_monitor(text) if is_monitor(text) else parse_query(text)


def name_of(query: AnyQuery) -> str:
    """Return the name that a text registers; "" if it gives none."""
    if isinstance(query, ContinuousQuery | Monitor):
        return query.name
    return registered_name(query)


def max_delay_of(query: AnyQuery) -> int | None:
    """Return how long (ns) after its valid time a sample is waited for, if the text says it."""
    match query:
        case Monitor():
            return query.policy.max_delay
        case ContinuousQuery():
            return None
        case _:
            return query.max_delay


@dataclass(frozen=True, slots=True)
class Submission:
    """A query text with its options. Registering a name again requires an equal one."""

    source: str
    options: Options
    strategy: str
    since: Beginning

    @property
    def how(self) -> str:
        """The options as text."""
        options = self.options
        return (
            f"semantics={options.semantics}, bounds={options.bounds}, origin={options.origin}, "
            f"report={options.report}, strategy={self.strategy}, since={self.since}"
        )


@dataclass(frozen=True, slots=True)
class Registration:
    """The ``number``-th submission. Kind (STREAM, QUERY, MONITOR or PATTERN), form and dialect are
    stored, because a later version may not be able to parse the text."""

    number: int
    submission: Submission
    kind: str
    form: str
    dialect: str

    @classmethod
    def of(cls, number: int, submission: Submission, query: AnyQuery) -> Registration:
        if isinstance(query, Monitor):
            return cls(number, submission, "MONITOR", "", MTL)
        if not isinstance(query, ContinuousQuery):
            return cls(number, submission, "PATTERN", "", language_of(query))
        kind = "STREAM" if query.produces_stream else "QUERY"
        return cls(number, submission, kind, str(query.form), str(query.dialect))

    def json(self) -> str:
        """Encode it for storage; the inverse of `registration_of`."""
        submission, options = self.submission, self.submission.options
        return json.dumps(
            {
                "number": self.number,
                "source": submission.source,
                "semantics": options.semantics,
                "bounds": options.bounds,
                "origin": options.origin,
                "report": options.report,
                "strategy": submission.strategy,
                "since": str(submission.since),
                "kind": self.kind,
                "form": self.form,
                "dialect": self.dialect,
            }
        )

    def view(self, name: str, state: str, failure: str | None, users: int) -> QueryView:
        """Return the view of the query without its running parts."""
        options = self.submission.options
        return QueryView(
            name=name,
            kind=self.kind,
            form=self.form,
            dialect=self.dialect,
            source=self.submission.source,
            semantics=options.semantics,
            bounds=options.bounds,
            origin=options.origin,
            report=options.report,
            strategy=self.submission.strategy,
            since=str(self.submission.since),
            state=state,
            failure=failure,
            users=users,
            created=self.number,
        )


def usual_semantics(query: AnyQuery) -> Semantics:
    """Return the default of the query's dialect for equal triples of a window."""
    is_rsp_ql = isinstance(query, ContinuousQuery) and query.dialect is Dialect.RSP_QL
    return "set" if is_rsp_ql else "bag"


def options_of(
    query: AnyQuery, semantics: Semantics | None, bounds: Bounds, origin: int, report: Report
) -> Options:
    """Return the options of a registration. Raises `BadArguments` for options of windows given to a
    monitor or a pattern."""
    options = Options(semantics or usual_semantics(query), bounds, origin, report)
    has_windows = isinstance(query, ContinuousQuery)
    if not has_windows and (semantics is not None or options != Options("bag")):
        what = "monitor" if isinstance(query, Monitor) else "pattern"
        raise BadArguments(
            f"a {what} has no windows: `semantics`, `bounds`, `origin` and `report` mean nothing",
            "leave them out"
            + ("; the text says what is reported: `with report changes`" * (what == "monitor")),
        )
    return options


def registration_of(text: str) -> Registration:
    """Decode a stored registration. Raises ``ValueError``, ``KeyError``, ``TypeError`` or
    `BadArguments`."""
    kept = json.loads(text)
    options = Options(kept["semantics"], kept["bounds"], kept["origin"], kept["report"])
    submission = Submission(
        kept["source"], options, kept["strategy"], parse_beginning(kept["since"])
    )
    return Registration(kept["number"], submission, kept["kind"], kept["form"], kept["dialect"])


def check_same(name: str, existing: Submission, submission: Submission) -> None:
    """Raise `AlreadyExists` for another text or other options under a name in use."""
    if existing == submission:
        return
    difference = (
        "with another text"
        if existing.source != submission.source
        else f"that runs with {existing.how}"
    )
    raise AlreadyExists(
        f"there is a query {name!r} {difference}",
        f"remove it first (DELETE /queries/{name}), or give this one another name",
    )
