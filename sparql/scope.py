"""The variables that a pattern binds and that are visible around it (SPARQL 1.1 §18.2.1)."""

from __future__ import annotations

from collections.abc import Iterable

from pyoxigraph import Variable

from .ast import (
    Aggregate,
    Bind,
    Element,
    Exists,
    Expression,
    Filter,
    Form,
    Graph,
    Group,
    Minus,
    Optional,
    Query,
    SubSelect,
    Triple,
    Triples,
    Union,
    Values,
    variables_of,
    walk,
)


def visible_variables(element: Element) -> dict[str, None]:
    """Return the names of the variables that an element of a group binds, in reading order."""
    found: dict[str, None] = {}
    match element:
        case Triples(triples):
            found.update(_of_triples(triples))
        case Group(elements):
            for one in elements:
                found.update(visible_variables(one))
        case Optional(group):
            return visible_variables(group)
        case Union(groups):
            for one in groups:
                found.update(visible_variables(one))
        case Graph(name, group):
            if isinstance(name, Variable):
                found[name.value] = None
            found.update(visible_variables(group))
        case Bind(_, variable):
            found[variable.value] = None
        case Values(variables, _):
            found.update((variable.value, None) for variable in variables)
        case SubSelect(query):
            return dict.fromkeys(projected_variables(query))
        case Filter() | Minus():
            pass
    return found


def _of_triples(triples: Iterable[Triple]) -> dict[str, None]:
    places = (place for t in triples for place in (t.subject, t.predicate, t.object))
    return {place.value: None for place in places if isinstance(place, Variable)}


def projected_variables(query: Query) -> tuple[str, ...]:
    """Return the names of the variables that a SELECT returns, each once; () for other forms."""
    if query.form is not Form.SELECT:
        return ()
    if query.projection is None:
        found = {} if query.where is None else visible_variables(query.where)
        if query.values is not None:
            found = found | visible_variables(query.values)
        return tuple(found)
    return tuple(dict.fromkeys(one.variable.value for one in query.projection))


def ungrouped_variables(expression: Expression) -> dict[str, None]:
    """Return the names of the variables of an expression outside of aggregates and EXISTS."""
    nodes = walk(expression, Aggregate, Exists)
    return {one.value: None for one in nodes if isinstance(one, Variable)}


def head_variables(query: Query) -> dict[str, None]:
    """Return the names of the variables that a head uses but does not define, in reading order."""
    projection = query.projection or ()
    defined = {one.variable.value for one in projection if one.expression is not None}
    used: dict[str, None] = {}
    for one in projection:
        used.update(variables_of(one.expression or one.variable))
    used.update(variables_of(query.template or ()))
    used.update(variables_of(query.described))
    return {name: None for name in used if name not in defined}
