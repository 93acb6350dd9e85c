"""Translates a continuous query to plain SPARQL 1.1, which is planned or runs on Oxigraph for each
window ([Events14 §III.A]).

It transforms the tree of the parser:

- AGGREGATE becomes a sub-select with GROUP BY and HAVING (`SPEC §5`);
- an alias in HAVING or in a later expression of the head becomes the expression that it names.
  SPARQL 1.1 defines no alias there (§18.2.4.4), but texts in C-SPARQL use them;
- a bound parameter becomes a VALUES row inside each group that uses it, since a group does not see
  the bindings around it. It also becomes a group key, so that HAVING sees it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from pyoxigraph import BlankNode, Literal, NamedNode, Variable

from ...rdf.dictionary import Term
from ...rdf.namespaces import PREFIXES
from ...sparql.ast import (
    Aggregate,
    Bind,
    Element,
    Exists,
    Expression,
    Form,
    Graph,
    Group,
    Key,
    Minus,
    Optional,
    Query,
    SelectItem,
    SubSelect,
    Union,
    Values,
    children,
    rewrite,
    variables_of,
    walk,
)
from ...sparql.printer import print_query
from ...sparql.scope import head_variables
from ..errors import Span
from ..object_cache import ObjectCache
from .ast import Aggregation, ContinuousQuery, StreamClause

_LARGEST: Final = 4096
"""The greatest number of nodes of an expression after alias substitution."""
_HIGHEST: Final = 256
_CACHED_TREES: Final = 8
"""The number of ways to bind a query's parameters whose trees are cached."""


def bind(query: ContinuousQuery, arguments: Mapping[Variable, Term]) -> ContinuousQuery:
    """Bind template arguments: it records terms and never pastes text.

    Meaning: a join with a row of the parameters. Raises `ValueError` for a variable that the query
    does not use or assigns itself, and for a blank node, which names nothing outside its own text.
    """
    used, assigned = _used_variables(query.body), _assigned_variables(query.body)
    for variable, term in arguments.items():
        if variable.value not in used and not _is_filtered(query, variable.value):
            raise ValueError(f"the query does not use {variable}")
        if variable.value in assigned:
            raise ValueError(f"the query assigns {variable} itself")
        if isinstance(term, BlankNode):
            raise ValueError(f"{variable} is given a blank node, which names nothing here")
    return replace(query, bindings={**query.bindings, **arguments})


@ObjectCache
def _used_variables(body: Query) -> frozenset[str]:
    return frozenset(variables_of(body))


@ObjectCache
def _assigned_variables(body: Query) -> frozenset[str]:
    """Return the names of the variables that ``AS`` assigns in WHERE."""
    found: set[str] = set()
    for node in walk(body.where):
        if isinstance(node, Bind | SelectItem) and node.expression is not None:
            found.add(node.variable.value)
        elif isinstance(node, Key) and node.alias is not None:
            found.add(node.alias.value)
    return frozenset(found)


def _is_filtered(query: ContinuousQuery, name: str) -> bool:
    return any(name in variables_of(condition) for condition, _ in query.aggregate_filters)


def with_streams(query: ContinuousQuery, streams: Sequence[str]) -> ContinuousQuery:
    """Replace the query's streams by these (IRIs or names), with its window ([Events14 §V.C]).

    A name becomes ``http://www.ida.liu.se/dyknow/NAME.trdf``. Raises `ValueError` if neither a
    WINDOW clause nor a FROM STREAM clause gives a window, and if the query names windows: then each
    pattern states its stream.
    """
    named = next((clause.name for clause in query.streams if clause.name is not None), None)
    if named is not None:
        raise ValueError(f"the query's streams cannot be replaced: it names the window <{named}>")
    window = query.window or (query.streams[0].window if query.streams else None)
    if window is None:
        raise ValueError(f"{query.name or 'the query'} has no window")
    span = query.streams[0].span if query.streams else Span(0, 0)
    clauses = tuple(StreamClause(stream_iri(name), window, span) for name in streams)
    return replace(query, streams=clauses)


def stream_iri(name: str) -> str:
    """Return the IRI of a stream in FROM STREAM; an IRI stays unchanged."""
    return name if ":" in name else f"{PREFIXES['dyknow']}{name}.trdf"


def group_keys(query: ContinuousQuery) -> tuple[Variable, ...]:
    """Return the group keys of an AGGREGATE query: the other head variables and every bound
    parameter.

    Empty for a query without AGGREGATE, where SPARQL's GROUP BY states them (`body_tree`).
    """
    if not query.aggregations:
        return ()
    return tuple(map(Variable, _keys(query, [v.value for v in query.bindings])))


def body_sparql(query: ContinuousQuery) -> str:
    """Return the equivalent SPARQL 1.1 text: bindings as VALUES rows, no FROM clauses."""
    return print_query(body_with_rows(query), query.prefixes)


def body_with_rows(query: ContinuousQuery) -> Query:
    """Return the tree of `body_sparql`."""
    rows = {variable.value: term for variable, term in query.bindings.items()}
    return _translate(query, rows, list(rows))


def body_tree(query: ContinuousQuery) -> Query:
    """Return the equivalent SPARQL 1.1 query without the values of its bindings.

    Bound parameters are free variables in it, and group keys where the query groups, so all
    instances of a template share one tree. Raises `ValueError` if alias substitution makes an
    expression too large.
    """
    names = tuple(variable.value for variable in query.bindings)
    trees = _trees(query.body)
    key = (names, query.aggregations, query.aggregate_filters)
    found = trees.get(key)
    if found is None:
        found = _translate(query, {}, names)
        while len(trees) >= _CACHED_TREES:
            trees.pop(next(iter(trees), key), None)
        found = trees.setdefault(key, found)
    return found


@ObjectCache
def _trees(_body: Query) -> dict[Any, Query]:
    return {}


# -- groups and the rows of parameters in them ---------------------------------------------------


@dataclass(frozen=True, slots=True)
class Part:
    """A group with the variables of its own; ``select`` is its sub-query, if it is the WHERE of
    one.

    Nested groups own their variables. EXISTS does not, since it sees the solutions of the group
    around it. ``outer`` are the variables that a sub-query names outside its WHERE.
    """

    group: Group
    names: frozenset[str]
    outer: frozenset[str] = frozenset()
    is_optional: bool = False
    select: Query | None = None

    def parameters(self, names: Sequence[str]) -> list[str]:
        """Return the parameters that need a row in the group."""
        # A filter directly in OPTIONAL sees the bindings around it, as no other filter does.
        own = frozenset() if self.is_optional else self.names
        return [name for name in names if name in own or name in self.outer]


def parts_of(query: Query) -> Iterator[Part]:
    """Yield the groups of WHERE, outermost first, in reading order, without those of EXISTS."""
    if query.where is not None:
        yield from _parts(query.where)


def _parts(
    group: Group,
    *,
    is_optional: bool = False,
    outer: frozenset[str] = frozenset(),
    select: Query | None = None,
) -> Iterator[Part]:
    match group.elements:
        case (SubSelect(query),) if query.where is not None:
            yield from _parts(query.where, outer=_variables_outside(query), select=query)
            return
    names: set[str] = set()
    nested: list[tuple[Group, bool]] = []
    for element in group.elements:
        inner = list(_groups_in(element))
        if not inner:
            names.update(variables_of(element))
        elif isinstance(element, Graph):
            names.update(variables_of(element.name))
        nested += inner
    yield Part(group, frozenset(names), outer, is_optional, select)
    for one, optional in nested:
        yield from _parts(one, is_optional=optional)


def _groups_in(element: Element) -> Iterator[tuple[Group, bool]]:
    match element:
        case Group():
            yield element, False
        case Optional(group):
            yield group, True
        case Minus(group) | Graph(_, group):
            yield group, False
        case Union(groups):
            yield from ((group, False) for group in groups)


def _variables_outside(select: Query) -> frozenset[str]:
    """Return the names of the variables of a sub-query outside its WHERE."""
    return frozenset(variables_of(replace(select, where=None)))


# -- rewriting -----------------------------------------------------------------------------------


def _translate(
    query: ContinuousQuery, rows: Mapping[str, Term], parameters: Sequence[str]
) -> Query:
    body = query.body
    assert body.where is not None, "parse_query refuses a text without WHERE"
    own = {id(part.group): part for part in parts_of(body)}
    top = body.where

    def change(node: Any) -> Any:
        if isinstance(node, Exists):
            return node
        if isinstance(node, Query) and node is not body:
            return _substitute_aliases(
                _with_group_keys(translate_where(node), _used_parameters(node, parameters))
            )
        if isinstance(node, Group) and id(node) in own:
            names = list(rows) if node is top else own[id(node)].parameters(list(rows))
            elements = rewrite(node.elements, change)
            if names:
                return Group((_row(names, rows), *elements), node.span)
            return replace(node, elements=elements)
        return None

    def translate_where(node: Query) -> Query:
        return replace(node, where=rewrite(node.where, change))

    made = translate_where(body)
    if query.aggregations:
        assert made.where is not None
        made = replace(made, where=_aggregate_sub_select(query, made.where, parameters))
    else:
        made = _substitute_aliases(_with_group_keys(made, parameters))
    return replace(made, is_short=body.is_short and not rows)


def _row(names: Sequence[str], rows: Mapping[str, Term]) -> Values:
    terms = tuple(rows[name] for name in names)
    assert all(isinstance(term, NamedNode | Literal) for term in terms)
    return Values(tuple(map(Variable, names)), (terms,))  # type: ignore[arg-type]


def _used_parameters(query: Query, parameters: Sequence[str]) -> list[str]:
    used = variables_of(query)
    return [name for name in parameters if name in used]


def _with_group_keys(query: Query, parameters: Sequence[str]) -> Query:
    """Add the parameters to the group keys, if the query groups."""
    if not parameters or not query.is_aggregated:
        return query
    present = variables_of(query.keys)
    missing = [Key(Variable(name)) for name in parameters if name not in present]
    return replace(query, keys=(*query.keys, *missing)) if missing else query


def _substitute_aliases(query: Query) -> Query:
    """Substitute aliases: HAVING (?avg > 100) becomes HAVING (AVG(?spd) > 100), likewise later in
    the head.

    An alias may use earlier aliases. Raises `ValueError` if an expression becomes too large.
    """
    if not query.is_aggregated:
        return query
    aliases: dict[str, Expression] = {}
    sizes: dict[str, tuple[int, int]] = {}

    def put_in(expression: Expression) -> Expression:
        size, height = _measure(expression, sizes)
        if size > _LARGEST or height > _HIGHEST:
            raise ValueError("aliases in the head expand to too large an expression")
        return rewrite(expression, _by_name(aliases)) if aliases else expression

    projection = []
    for one in query.projection or ():
        if one.expression is not None:
            name = one.variable.value
            size = _measure(one.expression, sizes)
            aliases[name] = expression = put_in(one.expression)
            sizes[name] = size
            one = replace(one, expression=expression)
        projection.append(one)
    if not aliases:
        return query
    having = tuple(map(put_in, query.having))
    return replace(query, projection=tuple(projection), having=having)


def _measure(node: Any, sizes: Mapping[str, tuple[int, int]]) -> tuple[int, int]:
    """Return the number of nodes and the height of a tree after substitution."""
    if isinstance(node, Variable):
        return sizes.get(node.value, (1, 1))
    size, height = 1, 0
    for child in children(node):
        inner, level = _measure(child, sizes)
        size, height = size + inner, max(height, level)
    return size, height + 1


def _by_name(terms: Mapping[str, Expression]) -> Any:
    def change(node: Any) -> Any:
        if isinstance(node, Aggregate | Exists):
            return node
        return terms.get(node.value) if isinstance(node, Variable) else None

    return change


def _aggregate_sub_select(query: ContinuousQuery, where: Group, parameters: Sequence[str]) -> Group:
    """Wrap the pattern: {P} becomes {{SELECT keys (F(?x) AS ?a) WHERE {P} GROUP BY … HAVING …}}."""
    names = _keys(query, parameters)
    calls: dict[str, Expression] = {a.alias.value: _call(a) for a in query.aggregations}
    projection = [SelectItem(Variable(name)) for name in names]
    projection += [SelectItem(Variable(alias), call) for alias, call in calls.items()]
    having = tuple(rewrite(c, _by_name(calls)) for c, _ in query.aggregate_filters)
    select = Query(
        Form.SELECT,
        where,
        projection=tuple(projection),
        keys=tuple(Key(Variable(name)) for name in names),
        having=having,
    )
    return Group((Group((SubSelect(select),)),))


def _call(aggregation: Aggregation) -> Aggregate:
    return Aggregate(aggregation.function, aggregation.argument)


def _keys(query: ContinuousQuery, parameters: Sequence[str]) -> list[str]:
    aliases = {aggregation.alias.value for aggregation in query.aggregations}
    head = [name for name in head_variables(query.body) if name not in aliases]
    return head + [name for name in parameters if name not in head]
