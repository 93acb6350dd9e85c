"""Registrations of continuous queries: what is compared, kept over a restart and shown."""

from __future__ import annotations

import json
from dataclasses import dataclass

from ...continuous.algebra.options import Options, Semantics
from ...languages.csparql.ast import ContinuousQuery, Dialect
from ..model.beginning import Beginning, parse_beginning
from ..model.errors import AlreadyExists
from ..model.views import QueryView


@dataclass(frozen=True, slots=True)
class Asked:
    """A text and how it is to run: who registers a name again must mean the same."""

    source: str
    options: Options
    strategy: str
    since: Beginning

    @property
    def how(self) -> str:
        """All but the text, for people."""
        options = self.options
        return (
            f"semantics={options.semantics}, bounds={options.bounds}, origin={options.origin}, "
            f"report={options.report}, strategy={self.strategy}, since={self.since}"
        )


@dataclass(frozen=True, slots=True)
class Registration:
    """What was asked as the ``number``-th, and which query it is: STREAM or QUERY, its form and
    dialect, which a text that is not understood any more does not tell."""

    number: int
    asked: Asked
    kind: str
    form: str
    dialect: str

    @classmethod
    def of(cls, number: int, asked: Asked, query: ContinuousQuery) -> Registration:
        kind = "STREAM" if query.produces_stream else "QUERY"
        return cls(number, asked, kind, str(query.form), str(query.dialect))

    def json(self) -> str:
        """As it is kept; the inverse of `registration_of`."""
        asked, options = self.asked, self.asked.options
        return json.dumps(
            {
                "number": self.number,
                "source": asked.source,
                "semantics": options.semantics,
                "bounds": options.bounds,
                "origin": options.origin,
                "report": options.report,
                "strategy": asked.strategy,
                "since": str(asked.since),
                "kind": self.kind,
                "form": self.form,
                "dialect": self.dialect,
            }
        )

    def view(self, name: str, state: str, failure: str | None, users: int) -> QueryView:
        """The query as the service shows it, but for what it has at work."""
        options = self.asked.options
        return QueryView(
            name=name,
            kind=self.kind,
            form=self.form,
            dialect=self.dialect,
            source=self.asked.source,
            semantics=options.semantics,
            bounds=options.bounds,
            origin=options.origin,
            report=options.report,
            strategy=self.asked.strategy,
            since=str(self.asked.since),
            state=state,
            failure=failure,
            users=users,
            created=self.number,
        )


def usual_semantics(dialect: Dialect) -> Semantics:
    """What equal triples of a window are where nobody says."""
    return "set" if dialect is Dialect.RSP_QL else "bag"


def registration_of(text: str) -> Registration:
    """A registration that was kept; raises ``ValueError``, ``KeyError``, ``TypeError`` or
    `BadArguments`."""
    kept = json.loads(text)
    options = Options(kept["semantics"], kept["bounds"], kept["origin"], kept["report"])
    asked = Asked(kept["source"], options, kept["strategy"], parse_beginning(kept["since"]))
    return Registration(kept["number"], asked, kept["kind"], kept["form"], kept["dialect"])


def check_same(name: str, known: Asked, asked: Asked) -> None:
    """Raises `AlreadyExists` for another text or other options under a name that is taken."""
    if known == asked:
        return
    told = "with another text" if known.source != asked.source else f"that runs with {known.how}"
    raise AlreadyExists(
        f"there is a query {name!r} {told}",
        f"remove it first (DELETE /queries/{name}), or give this one another name",
    )
