"""Registrations of continuous queries: compared, stored over a restart, and shown."""

from __future__ import annotations

import json
from dataclasses import dataclass

from ...continuous.algebra.options import Options, Semantics
from ...languages.csparql.ast import ContinuousQuery, Dialect
from ..model.beginning import Beginning, parse_beginning
from ..model.errors import AlreadyExists
from ..model.views import QueryView


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
    """The ``number``-th submission. Kind (STREAM or QUERY), form and dialect are stored, because a
    later version may not be able to parse the text."""

    number: int
    submission: Submission
    kind: str
    form: str
    dialect: str

    @classmethod
    def of(cls, number: int, submission: Submission, query: ContinuousQuery) -> Registration:
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


def usual_semantics(dialect: Dialect) -> Semantics:
    """Return the dialect's default for equal triples of a window."""
    return "set" if dialect is Dialect.RSP_QL else "bag"


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
