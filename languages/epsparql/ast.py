"""The AST of EP-SPARQL queries (Anicic et al., WWW 2011; SPEC §8): the text as written.

Triples and expressions are those of `dyknow.sparql`; a function of time is a `Call` without
arguments. Spans take no part in comparisons.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field as attribute
from enum import StrEnum
from typing import Final, TypeAlias

from pyoxigraph import NamedNode, Variable

from ...sparql.ast import Expression, Form, SelectItem, Triple, Triples
from ..arguments import Defaults
from ..errors import Span

DURATION: Final = "getDURATION"
START_TIME: Final = "getSTARTTIME"
END_TIME: Final = "getENDTIME"
TIME_FUNCTIONS: Final = (DURATION, START_TIME, END_TIME)
"""The functions of the interval of the enclosing group."""


class Operator(StrEnum):
    """An operator between two groups."""

    SEQ = "SEQ"
    EQUALS = "EQUALS"
    OPTIONALSEQ = "OPTIONALSEQ"
    EQUALSOPTIONAL = "EQUALSOPTIONAL"
    UNION = "UNION"


@dataclass(frozen=True, slots=True)
class Filter:
    """``FILTER (condition)``."""

    condition: Expression
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Bind:
    """``BIND (expression AS ?variable)``."""

    expression: Expression
    variable: Variable
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Graph:
    """``GRAPH name {…}``: triples of a static graph."""

    name: NamedNode
    triples: tuple[Triple, ...]


@dataclass(frozen=True, slots=True)
class Operation:
    """``left SEQ right``. A chain of operators is read from the left."""

    operator: Operator
    left: Operation | Group
    right: Group
    span: Span = attribute(compare=False)


@dataclass(frozen=True, slots=True)
class Group:
    """``{…}``: all parts together, in any order of time."""

    parts: tuple[Part, ...]
    span: Span = attribute(compare=False)


Part: TypeAlias = Triples | Filter | Bind | Graph | Operation | Group


@dataclass(frozen=True)
class EpSparqlQuery:
    """An EP-SPARQL query, or the body of a template.

    | field | content |
    |---|---|
    | ``name`` | as registered, a plain name or an IRI; "" without REGISTER |
    | ``kind`` | STREAM, QUERY or TEMPLATE; "" without REGISTER |
    | ``parameters``, ``defaults`` | those of a template |
    | ``projection`` | the items of SELECT; None for ``*`` and for other forms |
    | ``template`` | the triples of CONSTRUCT; None for other forms |
    | ``graphs`` | the IRIs of FROM and of FROM NAMED: static graphs |
    | ``max_delay`` | how long after its time a sample comes at the latest, in ns, or None |
    | ``within`` | the longest that a solution may last, in ns, or a parameter; None: no WITHIN |
    """

    name: str
    kind: str
    parameters: tuple[Variable, ...]
    defaults: Defaults
    form: Form
    projection: tuple[SelectItem, ...] | None
    template: tuple[Triple, ...] | None
    graphs: tuple[tuple[str, ...], tuple[str, ...]]
    where: Group
    within: int | Variable | None
    max_delay: int | None
    prefixes: Mapping[str, str]
    head: Span = attribute(compare=False)
    source: str = attribute(compare=False)

    @property
    def is_template(self) -> bool:
        """Whether a request gives the parameters."""
        return self.kind == "TEMPLATE"
