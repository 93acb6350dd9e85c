"""Parameters of a query: terms in the place of variables, as RDF4J's protocol has them (``$name``).

A term replaces every occurrence of its variable, that in sub-queries, too, as if the text had it
there. A projected parameter keeps its column; ``*`` does not yield it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

from pyoxigraph import Literal, NamedNode, Variable

from ..rdf.namespaces import XSD
from .ast import (
    Bind,
    Call,
    Graph,
    Key,
    Query,
    SelectItem,
    Triple,
    Values,
    rewrite,
    variables_of,
    walk,
)

Terms: TypeAlias = Mapping[str, NamedNode | Literal]
"""The term of each parameter, by its name without ``?`` or ``$``."""

_TRUE = Literal("true", datatype=NamedNode(XSD + "boolean"))


def with_terms(query: Query, terms: Terms) -> Query:
    """Return the query with the term of each parameter in the place of its variable.

    Raises `ValueError` for a parameter that the query does not use or assigns itself, and for a
    literal where only an IRI may stand.
    """
    used = variables_of(query)
    for name in terms:
        if name not in used:
            raise ValueError(f"the query does not use ${name}")
    for node in walk(query):
        for variable in _assigned(node):
            if variable.value in terms:
                raise ValueError(f"the query assigns ?{variable.value} itself")
        for variable in _named(node):
            if isinstance(terms.get(variable.value), Literal):
                raise ValueError(f"${variable.value} needs an IRI: a literal cannot stand there")

    def change(node: Any) -> Any:
        match node:
            case SelectItem(Variable(value=name) as variable, None) if name in terms:
                return SelectItem(variable, terms[name], node.span)
            case Call("BOUND", (Variable(value=name),)) if name in terms:
                return _TRUE
            case Variable(value=name):
                return terms.get(name)
        return None

    return rewrite(query, change)


def _assigned(node: Any) -> tuple[Variable, ...]:
    """Return the variables to which a node itself gives a value."""
    match node:
        case Values():
            return node.variables
        case Bind() | SelectItem() if node.expression is not None:
            return (node.variable,)
        case Key() if node.alias is not None:
            return (node.alias,)
    return ()


def _named(node: Any) -> tuple[Variable, ...]:
    """Return the variables of a node in whose place no literal may stand."""
    match node:
        case Triple():
            places: tuple[Any, ...] = (node.subject, node.predicate)
        case Graph():
            places = (node.name,)
        case Query():
            places = node.described
        case _:
            return ()
    return tuple(place for place in places if isinstance(place, Variable))
