"""The tree of a SPARQL 1.1 query ([SPARQL 1.1 §19.8]; rule numbers in brackets).

Terms are pyoxigraph's. The parser expands collections and ``[]`` to triples with fresh blank nodes.
A chain of one operator (``a + b + c``, ``||``, ``&&``) is one node, so the depth of a tree follows
from its brackets. Spans are offsets into the source and take no part in comparisons.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from typing import Any, Final, TypeAlias, TypeVar

from pyoxigraph import BlankNode, Literal, NamedNode, Variable

from .errors import Span

T = TypeVar("T")
NO_SPAN: Final = Span(0, 0)
"""The span of a node that was not parsed from a text."""


class Form(StrEnum):
    """The query form of the body."""

    SELECT = "SELECT"
    CONSTRUCT = "CONSTRUCT"
    ASK = "ASK"
    DESCRIBE = "DESCRIBE"


# -- paths ([88]-[96]): an IRI, or one of these --------------------------------------------------


@dataclass(frozen=True, slots=True)
class Inverse:
    """``^path``."""

    path: Path


@dataclass(frozen=True, slots=True)
class Sequence:
    """``path/path``."""

    parts: tuple[Path, ...]


@dataclass(frozen=True, slots=True)
class Alternative:
    """``path|path``."""

    parts: tuple[Path, ...]


@dataclass(frozen=True, slots=True)
class Repetition:
    """``path*``, ``path+``, ``path?``; ``sign`` says which."""

    path: Path
    sign: str


@dataclass(frozen=True, slots=True)
class NegatedSet:
    """``!(iri|^iri)``: any step except these, forward and backward."""

    forward: tuple[NamedNode, ...]
    backward: tuple[NamedNode, ...]


Path: TypeAlias = NamedNode | Inverse | Sequence | Alternative | Repetition | NegatedSet
PATHS: Final = (Inverse, Sequence, Alternative, Repetition, NegatedSet)
Place: TypeAlias = NamedNode | Literal | BlankNode | Variable


@dataclass(frozen=True, slots=True)
class Triple:
    """A triple pattern, or a triple of a CONSTRUCT template."""

    subject: Place
    predicate: Path | Variable
    object: Place
    span: Span = field(default=NO_SPAN, compare=False)
    """The place of predicate and object."""


# -- expressions ([110]-[128]): a variable, an IRI, a literal, or one of these -------------------


@dataclass(frozen=True, slots=True)
class Logical:
    """``a || b || …`` or ``a && b && …``."""

    operator: str
    operands: tuple[Expression, ...]


@dataclass(frozen=True, slots=True)
class Comparison:
    """``a = b``, ``!=``, ``<``, ``<=``, ``>``, ``>=``."""

    operator: str
    left: Expression
    right: Expression


@dataclass(frozen=True, slots=True)
class In:
    """``a IN (b, …)``, ``a NOT IN (…)``."""

    operand: Expression
    options: tuple[Expression, ...]
    negated: bool


@dataclass(frozen=True, slots=True)
class Arithmetic:
    """``a + b - c …`` or ``a * b / c …``, evaluated from left to right."""

    first: Expression
    rest: tuple[tuple[str, Expression], ...]


@dataclass(frozen=True, slots=True)
class Unary:
    """``!a``, ``-a``, ``+a``."""

    operator: str
    operand: Expression


@dataclass(frozen=True, slots=True)
class Call:
    """A built-in function, by its name in upper case."""

    name: str
    arguments: tuple[Expression, ...]


@dataclass(frozen=True, slots=True)
class FunctionCall:
    """A function by its IRI."""

    iri: NamedNode
    arguments: tuple[Expression, ...]
    span: Span = field(default=NO_SPAN, compare=False)


@dataclass(frozen=True, slots=True)
class Exists:
    """``EXISTS {…}``, ``NOT EXISTS {…}``."""

    group: Group
    negated: bool


@dataclass(frozen=True, slots=True)
class Aggregate:
    """``AVG(DISTINCT ?x)``; ``argument`` is None for ``COUNT(*)``."""

    function: str
    argument: Expression | None
    distinct: bool = False
    separator: str | None = None


Expression: TypeAlias = (
    Variable
    | NamedNode
    | Literal
    | Logical
    | Comparison
    | In
    | Arithmetic
    | Unary
    | Call
    | FunctionCall
    | Exists
    | Aggregate
)


# -- patterns ([53]-[67]): the elements of a group, in reading order -----------------------------


@dataclass(frozen=True, slots=True)
class Group:
    """``{…}``. A sub-query is the only element of its group."""

    elements: tuple[Element, ...]
    span: Span = field(default=NO_SPAN, compare=False)


@dataclass(frozen=True, slots=True)
class Triples:
    """Consecutive triple patterns of a group."""

    triples: tuple[Triple, ...]


@dataclass(frozen=True, slots=True)
class Filter:
    condition: Expression


@dataclass(frozen=True, slots=True)
class Optional:
    group: Group


@dataclass(frozen=True, slots=True)
class Union:
    groups: tuple[Group, ...]


@dataclass(frozen=True, slots=True)
class Minus:
    group: Group


@dataclass(frozen=True, slots=True)
class Graph:
    """``GRAPH name {…}``; ``is_window``: RSP-QL's ``WINDOW name {…}``."""

    name: NamedNode | Variable
    group: Group
    is_window: bool = False


@dataclass(frozen=True, slots=True)
class Bind:
    expression: Expression
    variable: Variable


@dataclass(frozen=True, slots=True)
class Values:
    """A VALUES table; None stands for UNDEF."""

    variables: tuple[Variable, ...]
    rows: tuple[tuple[NamedNode | Literal | None, ...], ...]


@dataclass(frozen=True, slots=True)
class SubSelect:
    query: Query


Element: TypeAlias = (
    Group | Triples | Filter | Optional | Union | Minus | Graph | Bind | Values | SubSelect
)


# -- queries ([1]-[28]) --------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class SelectItem:
    """``?v`` or ``(expression AS ?v)`` in the head of a query."""

    variable: Variable
    expression: Expression | None = None
    span: Span = field(default=NO_SPAN, compare=False)


@dataclass(frozen=True, slots=True)
class Key:
    """A key of GROUP BY; ``alias`` is that of ``(expression AS ?alias)``."""

    expression: Expression
    alias: Variable | None = None


@dataclass(frozen=True, slots=True)
class Order:
    expression: Expression
    descending: bool = False


@dataclass(frozen=True, slots=True, weakref_slot=True)
class Query:
    """A query or sub-query without its FROM clauses.

    ``modifier`` is DISTINCT, REDUCED or "". ``projection`` is None for ``*`` and for forms without
    one, ``template`` is None for all forms but CONSTRUCT. ``is_short`` marks ``CONSTRUCT WHERE
    {…}``. ``where`` is None only in a DESCRIBE.
    """

    form: Form
    where: Group | None
    modifier: str = ""
    projection: tuple[SelectItem, ...] | None = None
    template: tuple[Triple, ...] | None = None
    is_short: bool = False
    described: tuple[NamedNode | Variable, ...] = ()
    keys: tuple[Key, ...] = ()
    having: tuple[Expression, ...] = ()
    order: tuple[Order, ...] = ()
    limit: int | None = None
    offset: int | None = None
    values: Values | None = None
    base: str = ""
    """The base IRI that IRI() resolves against; "" in sub-queries."""
    span: Span = field(default=NO_SPAN, compare=False)
    grouped: Span | None = field(default=None, compare=False)
    """The span of GROUP BY and its keys."""

    @property
    def selects_all(self) -> bool:
        """True for ``SELECT *`` and ``DESCRIBE *``."""
        if self.form is Form.DESCRIBE:
            return not self.described
        return self.form is Form.SELECT and self.projection is None

    @property
    def is_aggregated(self) -> bool:
        """True if the query groups its solutions: by GROUP BY, HAVING or an aggregate."""
        if self.keys or self.having:
            return True
        expressions = [p.expression for p in self.projection or () if p.expression is not None]
        expressions += [order.expression for order in self.order]
        return any(map(has_aggregate, expressions))


NODES: Final = (
    *(*PATHS, Triple, Logical, Comparison, In, Arithmetic, Unary, Call, FunctionCall, Exists),
    *(Aggregate, Group, Triples, Filter, Optional, Union, Minus, Graph, Bind, Values, SubSelect),
    *(SelectItem, Key, Order, Query),
)


_FIELDS: Final[dict[type, tuple[str, ...]]] = {
    kind: tuple(one.name for one in fields(kind) if one.compare) for kind in NODES
}
"""The fields of each node class without spans."""


def children(node: Any) -> Iterator[Any]:
    """Yield the nodes and terms directly in a node or tuple, in reading order."""
    parts = node
    if not isinstance(node, tuple):
        parts = [getattr(node, name) for name in _FIELDS.get(type(node), ())]
    for part in parts:
        if isinstance(part, tuple):
            yield from children(part)
        elif isinstance(part, (*NODES, *_TERMS)):
            yield part


_TERMS: Final = (NamedNode, Literal, BlankNode, Variable)


def walk(node: Any, *opaque: type) -> Iterator[Any]:
    """Yield ``node`` and all nodes and terms below it, in reading order, but nothing within nodes
    of the types ``opaque``."""
    waiting = [node]
    while waiting:
        one = waiting.pop()
        yield one
        if not isinstance(one, opaque):
            waiting.extend(reversed(list(children(one))))


def variables_of(node: Any) -> dict[str, None]:
    """Return the names of all variables in a node, each once, in reading order."""
    return dict.fromkeys(one.value for one in walk(node) if isinstance(one, Variable))


def has_aggregate(expression: Expression) -> bool:
    """Return whether an expression contains an aggregate outside of EXISTS."""
    return any(isinstance(one, Aggregate) for one in walk(expression, Exists))


def rewrite(node: T, change: Callable[[Any], Any]) -> T:
    """Replace each node and term for which ``change`` returns a value by that value. Where
    ``change`` returns None, descend into the parts. Unchanged parts are shared."""
    made = change(node)
    if made is not None:
        return made  # type: ignore[no-any-return]
    if isinstance(node, tuple):
        parts = tuple(rewrite(part, change) for part in node)
        same = all(new is old for new, old in zip(parts, node, strict=True))
        return node if same else parts  # type: ignore[return-value]
    if not isinstance(node, NODES):
        return node
    changed = {}
    for name in _FIELDS[type(node)]:
        old = getattr(node, name)
        new = rewrite(old, change)
        if new is not old:
            changed[name] = new
    return replace(node, **changed) if changed else node
