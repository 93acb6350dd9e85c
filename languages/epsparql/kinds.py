"""Finds the kinds of variables (SPEC §8).

A variable has one kind. The range of a feature says which; without a range another place of the
variable or the other side of a comparison decides, else it is a number. Of a variable that only
static triples have, the other side of a comparison decides.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from pyoxigraph import Literal, NamedNode, Variable

from ...sparql import ast as sparql
from ...sparql.ast import variables_of
from ..errors import LanguageError, Span
from ..mtl.checked import Kind
from . import ast
from .ast import DURATION as GET_DURATION
from .ast import END_TIME, START_TIME
from .checked import kind_of
from .expressions import ExpressionChecker
from .groups import parts_in
from .triples import BLANK, Read, Reading, StaticTriple, Term


def find_kinds(
    query: ast.EpSparqlQuery, reads: Iterable[Read]
) -> tuple[dict[str, Kind], dict[str, Kind]]:
    """Return the kind of each variable of samples and of BIND, and of each parameter; and that of
    each variable that only static triples have. Raises `LanguageError` at the second place of a
    variable that has two."""
    return _Finder(query).find(tuple(reads))


class _Finder:
    def __init__(self, query: ast.EpSparqlQuery) -> None:
        self._query = query
        self._kinds: dict[str, Kind] = {}
        self._static: dict[str, Kind] = {}
        """The kinds of variables that only static triples have, as far as they are known."""
        self._expressions = ExpressionChecker(query.source, {})

    def find(self, reads: Iterable[Read]) -> tuple[dict[str, Kind], dict[str, Kind]]:
        unknown: dict[str, None] = {}
        for read in reads:
            if isinstance(read, Reading):
                for term in read.arguments:
                    self._set_kind(term, Kind.OBJECT, read.span)
                if read.kind is not None:
                    self._set_kind(read.value, read.kind, read.span)
                elif isinstance(read.value, Variable):
                    unknown[read.value.value] = None
        unknown.update((each.value, None) for each in self._query.parameters)
        if isinstance(self._query.within, Variable):
            self._set_kind(self._query.within, Kind.DURATION, self._query.head)
        parts = list(parts_in(self._query.where))
        binds = [part for part in parts if isinstance(part, ast.Bind)]
        conditions = [part.condition for part in parts if isinstance(part, ast.Filter)]
        bound = {bind.variable.value for bind in binds}
        static = {
            name: None
            for name in (*_static_names(reads), *_names_of_graphs(parts))
            if name not in self._kinds.keys() | unknown.keys() | bound
        }
        before = -1
        while before < len(self._kinds) + len(self._static):
            before = len(self._kinds) + len(self._static)
            for bind in binds:
                if (kind := self._guess(bind.expression)) is not None:
                    self._kinds.setdefault(bind.variable.value, kind)
            for condition in conditions:
                self._learn(condition, unknown, self._kinds)
                self._learn(condition, static, self._static)
        for name in (*unknown, *bound):
            self._kinds.setdefault(name, Kind.NUMBER)
        # What is compared with a number by default is a number, too.
        return self._kinds, {name: self._static.get(name, Kind.NUMBER) for name in static}

    def _set_kind(self, term: Term, kind: Kind, span: Span) -> None:
        if not isinstance(term, Variable):
            return
        name = term.value
        before = self._kinds.setdefault(name, kind)
        if before != kind:
            raise LanguageError(
                f"{_shown(name)} is of kind {kind} here and of kind {before} before",
                self._query.source,
                span,
                "values of two kinds are never equal: use two variables",
            )

    def _learn(
        self, condition: sparql.Expression, unknown: Mapping[str, None], kinds: dict[str, Kind]
    ) -> None:
        """Take the kind of an ``unknown`` variable that is compared from the other side."""
        pairs: list[tuple[sparql.Expression, sparql.Expression]] = []
        for node in sparql.walk(condition):
            if isinstance(node, sparql.Comparison):
                pairs += [(node.left, node.right), (node.right, node.left)]
            elif isinstance(node, sparql.In):
                pairs += [(node.operand, option) for option in node.options]
                pairs += [(option, node.operand) for option in node.options]
        for side, other in pairs:
            if isinstance(side, Variable) and side.value in unknown:
                kind = self._guess(other)
                if kind is not None:
                    kinds.setdefault(side.value, kind)

    def _guess(self, node: sparql.Expression) -> Kind | None:
        """The kind of an expression as far as it is known."""
        match node:
            case Variable(value=name):
                return self._kinds.get(name, self._static.get(name))
            case NamedNode():
                return Kind.OBJECT
            case Literal():
                return _kind_of_literal(self._expressions, node)
            case sparql.Call(name) if name == GET_DURATION:
                return Kind.DURATION
            case sparql.Call(name) if name in (START_TIME, END_TIME):
                return Kind.TIME
            case sparql.Arithmetic(first, rest):
                kinds = [self._guess(first), *(self._guess(each) for _, each in rest)]
                found = {kind for kind in kinds if kind is not None}
                if Kind.TIME in found:
                    return Kind.DURATION if kinds.count(Kind.TIME) == 2 else Kind.TIME
                return Kind.DURATION if Kind.DURATION in found else Kind.NUMBER
            case _:
                return None


def _static_names(reads: Iterable[Read]) -> Iterator[str]:
    for read in reads:
        if isinstance(read, StaticTriple):
            yield from variables_of(read.triple)


def _names_of_graphs(parts: Iterable[ast.Part]) -> Iterator[str]:
    for part in parts:
        if isinstance(part, ast.Graph):
            yield from variables_of(part.triples)


def _kind_of_literal(expressions: ExpressionChecker, literal: Literal) -> Kind | None:
    """The kind of a literal; None for one that is wrong, which its condition reports."""
    try:
        return kind_of(expressions.constant(literal, Span(0, 0)))
    except LanguageError:
        return None


def _shown(name: str) -> str:
    return "a blank node" if name.startswith(BLANK) else f"`?{name}`"
