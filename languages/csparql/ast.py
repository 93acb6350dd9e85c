"""The AST of continuous queries and event templates ([Events14 §III-IV], SPEC §5).

The header (REGISTER, streams, windows, AGGREGATE) is defined here; `ContinuousQuery.body` is the
SPARQL query in it, a tree of `dyknow.sparql`.
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
from ..arguments import Argument, Defaults
from ..errors import Span


class Dialect(StrEnum):
    """The dialect, which decides what the text leaves open: RSP-QL has sets, C-SPARQL has bags."""

    C_SPARQL = "C-SPARQL"
    RSP_QL = "RSP-QL"


class StreamOperator(StrEnum):
    """The part of a result that goes to the output: all of it, the new rows, or the rows that are
    gone."""

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
    """``[TRIPLES 10 STEP 2]``: the last ``size`` triples, after each ``step`` new ones."""

    size: int
    step: int


@dataclass(frozen=True, slots=True)
class LandmarkWindow:
    """``[LANDMARK STEP 1s]``: content ``[start, t]`` at each multiple of ``step``, in ns. Without
    ``start`` the content is everything up to ``t``."""

    start: int | None
    step: int


Window: TypeAlias = TimeWindow | CountWindow | LandmarkWindow


@dataclass(frozen=True, slots=True)
class StreamClause:
    """``FROM STREAM <iri> [RANGE … STEP …]``; RSP-QL's ``FROM NAMED WINDOW <name> ON <iri> […]``.

    ``name`` is the IRI of a named window, whose triples only ``WINDOW <name> {…}`` reads. The
    triples of a window without a name belong to the default graph.
    """

    iri: str
    window: Window
    span: Span
    name: str | None = None


@dataclass(frozen=True, slots=True)
class Aggregation:
    """``(?alias, FUNCTION, {?argument})`` of an AGGREGATE clause.

    The other variables of the head are the group keys. ``function`` is upper case: AVG, SUM, COUNT,
    MIN, MAX.
    """

    alias: Variable
    function: str
    argument: Variable
    span: Span


@dataclass(frozen=True, slots=True)
class ContinuousQuery:
    """A continuous query, or the body of a template (whose `Template.parameters` are free).

    | field | content |
    |---|---|
    | ``name`` | as registered, a plain name or an IRI; "" without REGISTER |
    | ``every`` | the period of COMPUTE EVERY in ns, or None |
    | ``static``, ``static_named`` | the graphs of FROM and FROM NAMED |
    | ``streams`` | the clauses that name streams; empty if matching finds the streams |
    | ``window`` | the WINDOW clause, for each stream that matching finds |
    | ``aggregations``, ``aggregate_filters`` | the AGGREGATE clause; conditions with spans |
    | ``body`` | the SPARQL query, with its own aggregates; ``WINDOW <name> {…}`` is a graph |
    | ``bindings`` | the template arguments that were given as terms |
    | ``window_variables`` | the names of the variables in ``WINDOW ?w {…}`` |
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
    defaults: Defaults


@dataclass(frozen=True, slots=True)
class EventRequest:
    """``dyknow:HighSpeedEvent(?o, dyknow:UAV, ?threshold = 100)``: each argument is a term or a
    free variable. ``named``: those after the ``arguments``, each with its parameter's name."""

    event: str
    arguments: tuple[Argument, ...]
    source: str
    named: tuple[tuple[str, Argument], ...] = ()
