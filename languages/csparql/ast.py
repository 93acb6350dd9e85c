"""The AST of continuous queries and event templates ([Events14 §III-IV], SPEC §5).

The header (REGISTER, streams, windows, AGGREGATE) is ours; `ContinuousQuery.body` is the SPARQL in
it, as `dyknow.sparql` reads it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TypeAlias

from pyoxigraph import Variable

from ...rdf.dictionary import Term
from ...sparql.ast import Expression, Query
from ...sparql.ast import Form as Form
from ..errors import Span


class Dialect(StrEnum):
    """Whose rules hold where the text says nothing: RSP-QL has sets, C-SPARQL bags."""

    C_SPARQL = "C-SPARQL"
    RSP_QL = "RSP-QL"


class StreamOperator(StrEnum):
    """What of the present result goes on: all of it, what is new in it, or what has left it."""

    RSTREAM = "RSTREAM"
    ISTREAM = "ISTREAM"
    DSTREAM = "DSTREAM"


@dataclass(frozen=True, slots=True)
class TimeWindow:
    """``[RANGE 5s STEP 1s]``: content ``(t - range, t]`` at each multiple of ``step``. In ns."""

    range: int
    step: int


@dataclass(frozen=True, slots=True)
class CountWindow:
    """``[TRIPLES 10 STEP 2]``: the last ``size`` triples, each time ``step`` more have come."""

    size: int
    step: int


@dataclass(frozen=True, slots=True)
class LandmarkWindow:
    """``[LANDMARK STEP 1s]``: content ``[start, t]`` at each multiple of ``step``, in ns; all that
    has come by ``t`` where ``start`` is None."""

    start: int | None
    step: int


Window: TypeAlias = TimeWindow | CountWindow | LandmarkWindow


@dataclass(frozen=True, slots=True)
class StreamClause:
    """``FROM STREAM <iri> [RANGE … STEP …]``; RSP-QL's ``FROM NAMED WINDOW <name> ON <iri> […]``.

    ``name`` is the IRI of the window, whose triples only ``WINDOW <name> {…}`` sees; without one
    they are part of the default graph.
    """

    iri: str
    window: Window
    span: Span
    name: str | None = None


@dataclass(frozen=True, slots=True)
class Aggregation:
    """``(?alias, FUNCTION, {?argument})`` of an AGGREGATE clause.

    It is grouped by the other head variables.
    ``function`` is upper case: AVG, SUM, COUNT, MIN, MAX.
    """

    alias: Variable
    function: str
    argument: Variable
    span: Span


@dataclass(frozen=True, slots=True)
class ContinuousQuery:
    """A continuous query, or the body of a template (then with `Template.parameters` free).

    ``name`` is as registered (a plain name or an IRI; "" without REGISTER), ``every`` the COMPUTE
    EVERY period in ns (None where absent), ``static`` the FROM graphs, ``static_named`` the FROM
    NAMED graphs, ``streams`` the FROM STREAM and FROM NAMED WINDOW clauses (empty where they are to
    be inferred), ``window`` the WINDOW clause (templates) which holds for every stream that is
    inferred. ``aggregations`` and ``aggregate_filters`` (the conditions of its FILTERs, with their
    spans) are the paper's AGGREGATE clause; SPARQL 1.1 aggregates stand in ``body``, where RSP-QL's
    ``WINDOW <name> {…}`` is a graph; ``window_variables`` are the names of those of
    ``WINDOW ?w {…}``. ``bindings`` are the template arguments that were given as terms.
    """

    name: str
    produces_stream: bool
    every: int | None
    form: Form
    prefixes: Mapping[str, str]
    static: tuple[str, ...]
    streams: tuple[StreamClause, ...]
    window: Window | None
    aggregations: tuple[Aggregation, ...]
    aggregate_filters: tuple[tuple[Expression, Span], ...]
    body: Query
    source: str
    bindings: Mapping[Variable, Term] = field(default_factory=dict)
    dialect: Dialect = Dialect.C_SPARQL
    operator: StreamOperator = StreamOperator.RSTREAM
    static_named: tuple[str, ...] = ()
    window_variables: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Template:
    """``REGISTER TEMPLATE name(?parameters) …``: an abstract event ([Events14 §IV.B]).

    ``name`` is the IRI of the event concept.
    """

    name: str
    parameters: tuple[Variable, ...]
    query: ContinuousQuery
    source: str


@dataclass(frozen=True, slots=True)
class EventRequest:
    """``dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)``: an argument is a term or stays a variable."""

    event: str
    arguments: tuple[Term | Variable, ...]
    source: str
