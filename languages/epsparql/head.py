"""Checks the head of a query: the fields of its results (SPEC §8)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from typing import Final

from pyoxigraph import BlankNode, NamedNode, Variable

from ...rdf.namespaces import local_name, shorten
from ...sparql import ast as sparql
from ...sparql.ast import variables_of
from ...streams.sample import LONGEST_NAME, TIME_FIELDS
from ..errors import LanguageError, Span
from ..mtl.checked import Kind
from . import ast
from .checked import Item, StaticVariable, Value, kind_of
from .expressions import ExpressionChecker
from .groups import parts_in

ID: Final = "id"
"""The field of a result of CONSTRUCT that names the subject."""
_RESERVED: Final = ("start", "end", *TIME_FIELDS)


@dataclass(frozen=True, slots=True)
class HeadChecker:
    """Checks the head of ``query``. ``names``: the variables that have a value; ``static``: those
    that only static triples have; ``features``: those that the pattern reads (IRIs). ``known``
    returns a function that raises `LanguageError` for a
    variable without a value."""

    query: ast.EpSparqlQuery
    expressions: ExpressionChecker
    names: AbstractSet[str]
    static: AbstractSet[str]
    features: AbstractSet[str]
    known: Callable[[Span], Callable[[str], None]]

    def items(self) -> tuple[Item, ...]:
        """Return the fields of the results. Raises `LanguageError`."""
        query = self.query
        if query.template is not None:
            items = tuple(self._constructed(query.template))
        elif query.projection is None:
            shown = [] if query.form == sparql.Form.ASK else list(self._all_names())
            items = tuple(self._item(name, Variable(name), query.head) for name in shown)
        else:
            items = tuple(
                self._item(each.variable.value, each.expression or each.variable, each.span)
                for each in query.projection
            )
        taken: set[str] = set()
        for item in items:
            if item.name in taken or item.name in _RESERVED or len(item.name) > LONGEST_NAME:
                raise self._error(
                    f"`{item.name}` cannot be the name of this field: it is too long"
                    if len(item.name) > LONGEST_NAME
                    else f"the results have a field `{item.name}` already",
                    item.span,
                    f"give the value another name: `(?{item.name} AS ?{item.name[:20]}_2)`",
                )
            taken.add(item.name)
        return items

    def _item(self, name: str, node: sparql.Expression, span: Span) -> Item:
        if not isinstance(node, Variable) and name in self.names:
            raise self._error(f"`?{name}` is bound already", span, "give the value another name")
        value = self._value(node, span)
        return Item(name, value, kind_of(value), span)

    def _value(self, node: sparql.Expression, span: Span) -> Value:
        if isinstance(node, Variable) and node.value in self.static:
            return StaticVariable(node.value)
        known = self.known(span)
        return self.expressions.value(
            node, span, lambda name: None if name in self.static else known(name)
        )

    def _all_names(self) -> Iterator[str]:
        """The variables of ``*``, in reading order."""
        written: dict[str, None] = {}
        for part in parts_in(self.query.where):
            if isinstance(part, sparql.Triples):
                written.update(variables_of(part))
            elif isinstance(part, ast.Graph):
                written.update(variables_of(part.triples))
            elif isinstance(part, ast.Bind):
                written[part.variable.value] = None
        return (name for name in written if name in self.names | self.static)

    def _constructed(self, template: tuple[sparql.Triple, ...]) -> Iterator[Item]:
        """The fields of CONSTRUCT: `ID` for the subject, and one for each predicate."""
        query = self.query
        if not template:
            raise self._error("CONSTRUCT has no triple", query.head, "write `{ ?c :rose ?by }`")
        for triple in template:
            predicate = triple.predicate
            if isinstance(predicate, NamedNode) and predicate.value in self.features:
                raise self._error(
                    f"the query feeds itself: it reads {shorten(predicate.value)}",
                    triple.span,
                    "give the result a predicate of its own",
                )
            if triple.subject != template[0].subject or not isinstance(predicate, NamedNode):
                raise self._error(
                    "the triples of a result have one subject, and written predicates",
                    triple.span,
                    "register a query for each subject",
                )
        subject = template[0].subject
        first = template[0].span
        if not isinstance(subject, Variable | NamedNode):
            raise self._error(
                f"the subject {subject} names no object", first, "write a variable or an IRI"
            )
        item = self.expressions.value(subject, first, self.known(first))
        if kind_of(item) is not Kind.OBJECT:
            raise self._error(f"the subject {subject} is no object", first, "write an object first")
        yield Item(ID, item, Kind.OBJECT, first)
        for triple in template:
            assert isinstance(triple.predicate, NamedNode)
            if isinstance(triple.object, BlankNode):
                raise self._error("a blank node has no value", triple.span, "write a variable")
            name = local_name(triple.predicate.value)
            value = self._value(triple.object, triple.span)
            yield Item(name, value, kind_of(value), triple.span, triple.predicate.value)

    def _error(self, message: str, span: Span, hint: str = "") -> LanguageError:
        return LanguageError(message, self.query.source, span, hint)
