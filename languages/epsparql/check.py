"""Checks EP-SPARQL queries against the ontology: features, sorts, kinds, scopes (SPEC §8).

A variable has one kind. The range of a feature says which; without a range another place of the
variable or the other side of a comparison decides, else it is a number. A condition sees the
variables of its own group, as in SPARQL.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Final, assert_never

from pyoxigraph import BlankNode, Literal, NamedNode, Variable

from ...ontology.vocabulary import Vocabulary
from ...rdf.namespaces import local_name, shorten
from ...sparql import ast as sparql
from ...sparql.ast import variables_of
from ...streams.sample import LONGEST_NAME, TIME_FIELDS
from ..errors import LanguageError, Span
from ..hints import did_you_mean
from ..mtl.checked import Constant, Kind, ObjectConstant, ObjectSlot, Parameter
from . import ast, checked
from .checked import DURATION, CheckedPattern, Item, ValueKind, kind_of
from .expressions import ExpressionChecker, bounds_of_duration
from .triples import (
    Classes,
    Read,
    Reading,
    Sorts,
    StaticTriple,
    Term,
    TripleReader,
    classes_of,
    triples_in,
    union,
)

ID: Final = "id"
"""The field of a result of CONSTRUCT that names the subject."""
_RESERVED: Final = ("start", "end", *TIME_FIELDS)


def check_epsparql(
    query: ast.EpSparqlQuery,
    vocabulary: Vocabulary,
    is_static: Callable[[str], bool] | None = None,
) -> CheckedPattern:
    """Return the meaning of a query or template.

    ``is_static`` tells whether static graphs may contain a ``dyknow:`` predicate that is no feature
    (default: never). Raises `LanguageError` with the place of the first term, kind or variable that
    is wrong. Cost: linear, but for the nesting of groups.
    """
    return _Checker(query, vocabulary, is_static).pattern()


class _Checker:
    def __init__(
        self,
        query: ast.EpSparqlQuery,
        vocabulary: Vocabulary,
        is_static: Callable[[str], bool] | None,
    ) -> None:
        self._query = query
        self._reader = TripleReader(query.source, vocabulary, is_static)
        self._read: dict[int, tuple[Read, ...]] = {}
        self._kinds: dict[str, ValueKind] = {}
        self._static: set[str] = set()
        """Variables that static triples have, and no sample."""
        self._parameters = {each.value for each in query.parameters}
        self._arguments: set[Term] = set()
        self._expressions = ExpressionChecker(query.source, self._kinds)

    def pattern(self) -> CheckedPattern:
        """Return the checked query."""
        query = self._query
        for triples in triples_in(query.where):
            self._read[id(triples)] = self._reader.read(triples)
        self._find_kinds()
        where = self._group(query.where, {})
        if not any(isinstance(read, Reading) for reads in self._read.values() for read in reads):
            raise self._error(
                "the pattern reads no feature, so nothing ever happens",
                query.where.span,
                "write a triple of a feature: `?c dyknow:price ?p`",
            )
        items = self._items(set(_names(where)))
        return CheckedPattern(
            query.name,
            query.form,
            tuple(map(self._slot, query.parameters)),
            items,
            where,
            self._within(where),
            query.graphs,
            query.source,
        )

    # -- kinds -------------------------------------------------------------------------------

    def _find_kinds(self) -> None:
        """Find the kind of each variable of samples, of BIND, and of each parameter."""
        unknown: dict[str, None] = {}
        for reads in self._read.values():
            for read in reads:
                if isinstance(read, Reading):
                    self._arguments.update(read.arguments)
                    for term in read.arguments:
                        self._set_kind(term, Kind.OBJECT, read.span)
                    if read.kind is not None:
                        self._set_kind(read.value, read.kind, read.span)
                    elif _is_variable(read.value):
                        unknown[_name(read.value)] = None
        unknown.update(dict.fromkeys(sorted(self._parameters)))
        parts = list(_parts_in(self._query.where))
        binds = [part for part in parts if isinstance(part, ast.Bind)]
        conditions = [part.condition for part in parts if isinstance(part, ast.Filter)]
        while True:
            before = len(self._kinds)
            for bind in binds:
                if (kind := self._guess(bind.expression)) is not None:
                    self._kinds.setdefault(bind.variable.value, kind)
            for condition in conditions:
                self._learn(condition, unknown)
            if len(self._kinds) == before:
                break
        for name in (*unknown, *(bind.variable.value for bind in binds)):
            self._kinds.setdefault(name, Kind.NUMBER)
        for reads in self._read.values():
            for read in reads:
                if isinstance(read, StaticTriple):
                    self._static |= variables_of(read.triple).keys() - self._kinds.keys()

    def _set_kind(self, term: Term, kind: Kind, span: Span) -> None:
        if not _is_variable(term):
            return
        name = _name(term)
        before = self._kinds.setdefault(name, kind)
        if before != kind:
            raise self._error(
                f"`{_shown(name)}` is of kind {kind} here and of kind {before} before",
                span,
                "values of two kinds are never equal: use two variables",
            )

    def _learn(self, condition: sparql.Expression, unknown: Mapping[str, None]) -> None:
        """Take the kind of a variable that is compared from the other side."""
        pairs: list[tuple[sparql.Expression, sparql.Expression]] = []
        for node in sparql.walk(condition):
            if isinstance(node, sparql.Comparison):
                pairs += [(node.left, node.right), (node.right, node.left)]
            elif isinstance(node, sparql.In):
                pairs += [(node.operand, option) for option in node.options]
        for side, other in pairs:
            if isinstance(side, Variable) and side.value in unknown:
                kind = self._guess(other)
                if kind is not None:
                    self._kinds.setdefault(side.value, kind)

    def _guess(self, node: sparql.Expression) -> ValueKind | None:
        """The kind of an expression as far as it is known."""
        match node:
            case Variable(value=name):
                return self._kinds.get(name)
            case NamedNode():
                return Kind.OBJECT
            case Literal():
                return _kind_of_literal(self._expressions, node)
            case sparql.Call("getDURATION"):
                return DURATION
            case sparql.Call("getSTARTTIME" | "getENDTIME"):
                return Kind.TIME
            case sparql.Arithmetic(first, rest):
                kinds = [self._guess(first), *(self._guess(each) for _, each in rest)]
                found = {kind for kind in kinds if kind is not None}
                if Kind.TIME in found:
                    return DURATION if kinds.count(Kind.TIME) == 2 else Kind.TIME
                return DURATION if DURATION in found else Kind.NUMBER
            case _:
                return None

    # -- groups ------------------------------------------------------------------------------

    def _group(self, group: ast.Group, outer: Classes) -> checked.Group:
        classes = union(outer, classes_of(group, self._reads))
        parts: list[checked.Part] = []
        conditions: list[ast.Filter] = []
        for part in group.parts:
            match part:
                case sparql.Triples():
                    parts += self._triples(part, classes)
                case ast.Group() | ast.Operation():
                    parts.append(self._operand(part, classes))
                case ast.Graph(name, triples):
                    parts += [checked.Static(each, name.value, each.span) for each in triples]
                case ast.Bind():
                    parts.append(self._bind(part, set(_names_of(parts))))
                case ast.Filter():
                    conditions.append(part)
                case _:
                    assert_never(part)
        names = set(_names_of(parts))
        for each in conditions:
            condition = self._expressions.condition(
                each.condition, each.span, self._known(names, each.span)
            )
            parts.append(checked.Filter(condition, each.span))
        return checked.Group(tuple(parts), group.span)

    def _operand(
        self, part: ast.Group | ast.Operation, outer: Classes
    ) -> checked.Group | checked.Operation:
        if isinstance(part, ast.Group):
            return self._group(part, outer)
        inside = union(outer, classes_of(part, self._reads))
        left_classes = right_classes = inside
        match part.operator:
            case ast.Operator.UNION:
                left_classes = union(outer, classes_of(part.left, self._reads))
                right_classes = union(outer, classes_of(part.right, self._reads))
            case ast.Operator.OPTIONALSEQ:
                left_classes = union(inside, classes_of(part.left, self._reads))
            case ast.Operator.EQUALSOPTIONAL:
                right_classes = union(inside, classes_of(part.right, self._reads))
        return checked.Operation(
            part.operator,
            self._operand(part.left, left_classes),
            self._group(part.right, right_classes),
            part.span,
        )

    def _reads(self, triples: sparql.Triples) -> tuple[Read, ...]:
        return self._read[id(triples)]

    def _triples(self, triples: sparql.Triples, classes: Classes) -> Iterator[checked.Part]:
        for read in self._read[id(triples)]:
            match read:
                case Reading():
                    yield self._sample(read, classes)
                case Sorts(subject, sort):
                    if subject not in self._arguments:
                        raise self._error(
                            f"no sample of {subject} is in the pattern, so its sort is not known",
                            triples.triples[0].span,
                            f"read a feature of {subject}, or leave `a {shorten(sort)}` out",
                        )
                case StaticTriple(triple):
                    yield checked.Static(triple, None, triple.span)
                case _:
                    assert_never(read)

    def _sample(self, read: Reading, classes: Classes) -> checked.Sample:
        arguments = tuple(
            (self._place(term, Kind.OBJECT, read.span), self._reader.narrowest(sorts))
            for term in read.arguments
            for sorts in [classes.get(term, frozenset())]
        )
        kind = read.kind
        if _is_variable(read.value):
            name = _name(read.value)
            known = self._kinds.setdefault(name, Kind.NUMBER)
            assert known != DURATION
            kind = Kind(known)
        elif kind is None:
            kind = Kind.OBJECT
            if isinstance(read.value, Literal):
                constant = self._expressions.constant(read.value, read.span)
                kind = constant.kind if isinstance(constant, Constant) else Kind.NUMBER
        value = self._place(read.value, kind, read.span)
        return checked.Sample(
            read.feature, arguments, value, kind, is_event=read.is_event, span=read.span
        )

    def _place(self, term: Term, kind: Kind, span: Span) -> checked.Place:
        if _is_variable(term):
            return checked.Variable(_name(term), kind)
        if isinstance(term, NamedNode):
            found: checked.Value = ObjectConstant(term.value)
        else:
            assert isinstance(term, Literal)
            found = self._expressions.constant(term, span)
        if not isinstance(found, Constant | ObjectConstant) or kind_of(found) is not kind:
            raise self._error(
                f"the value is of kind {kind}, and {term} is of kind {kind_of(found)}",
                span,
                "no sample has such a value",
            )
        return found

    def _bind(self, bind: ast.Bind, names: set[str]) -> checked.Bind:
        name = bind.variable.value
        if name in names or name in self._parameters:
            raise self._error(
                f"`?{name}` is bound already", bind.span, "give the value another name"
            )
        value = self._expressions.value(bind.expression, bind.span, self._known(names, bind.span))
        return checked.Bind(checked.Variable(name, kind_of(value)), value, bind.span)

    def _known(self, names: set[str], span: Span) -> Callable[[str], None]:
        """Return a function that raises `LanguageError` for a variable without a value."""

        def check(name: str) -> None:
            if name in names or name in self._parameters:
                return
            message = f"`?{name}` is not bound in this group"
            if name in self._static:
                message = f"`?{name}` has its value from static graphs"
                hint = "a condition on it is a triple: `GRAPH <g> {…}`, or a static triple"
            elif name in self._kinds:
                hint = "a condition sees its own group: write it after the `}` of a larger one"
            else:
                shown = [f"?{each}" for each in sorted(names) if not each.startswith("_:")]
                hint = did_you_mean(f"?{name}", shown) or f"the group has {', '.join(shown)}"
            raise self._error(message, span, hint)

        return check

    # -- the head ----------------------------------------------------------------------------

    def _items(self, names: set[str]) -> tuple[Item, ...]:
        query = self._query
        if query.template is not None:
            items = tuple(self._constructed(query.template, names))
        elif query.projection is None:
            shown = [] if query.form == sparql.Form.ASK else list(self._all_names(names))
            items = tuple(self._item(name, Variable(name), query.head, names) for name in shown)
        else:
            items = tuple(
                self._item(each.variable.value, each.expression or each.variable, each.span, names)
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

    def _item(self, name: str, node: sparql.Expression, span: Span, names: set[str]) -> Item:
        if isinstance(node, Variable) is False and name in names:
            raise self._error(f"`?{name}` is bound already", span, "give the value another name")
        value = self._expressions.value(node, span, self._known(names, span))
        return Item(name, value, kind_of(value), span)

    def _all_names(self, names: set[str]) -> Iterator[str]:
        """The variables of ``*``, in reading order."""
        written: dict[str, None] = {}
        for part in _parts_in(self._query.where):
            if isinstance(part, sparql.Triples):
                written.update(variables_of(part))
            elif isinstance(part, ast.Bind):
                written[part.variable.value] = None
        return (name for name in written if name in names or name in self._parameters)

    def _constructed(self, template: tuple[sparql.Triple, ...], names: set[str]) -> Iterator[Item]:
        """The fields of CONSTRUCT: `ID` for the subject, and one for each predicate."""
        query = self._query
        if not template:
            raise self._error("CONSTRUCT has no triple", query.head, "write `{ ?c :rose ?by }`")
        features = {
            read.feature
            for reads in self._read.values()
            for read in reads
            if isinstance(read, Reading)
        }
        for triple in template:
            predicate = triple.predicate
            if isinstance(predicate, NamedNode) and predicate.value in features:
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
        item = self._expressions.value(subject, first, self._known(names, first))
        if kind_of(item) is not Kind.OBJECT:
            raise self._error(f"the subject {subject} is no object", first, "write an object first")
        yield Item(ID, item, Kind.OBJECT, first)
        for triple in template:
            assert isinstance(triple.predicate, NamedNode)
            if isinstance(triple.object, BlankNode):
                raise self._error("a blank node has no value", triple.span, "write a variable")
            name = local_name(triple.predicate.value)
            value = self._expressions.value(
                triple.object, triple.span, self._known(names, triple.span)
            )
            yield Item(name, value, kind_of(value), triple.span)

    def _slot(self, parameter: Variable) -> ObjectSlot | Parameter:
        name = parameter.value
        if parameter in self._arguments:
            sorts = {
                read.sort
                for reads in self._read.values()
                for read in reads
                if isinstance(read, Sorts) and read.subject == parameter
            }
            return ObjectSlot(name, self._reader.narrowest(frozenset(sorts)))
        used = {each for part in _parts_in(self._query.where) for each in _variables(part)}
        if name not in used:
            raise self._error(
                f"the pattern does not use `?{name}`",
                self._query.head,
                "use it, as in `FILTER (?price > ?limit)`, or leave it out",
            )
        kind = self._kinds[name]
        if kind == DURATION:
            raise self._error(
                f"the parameter `?{name}` is compared with a duration",
                self._query.head,
                "write the duration: requests give objects, numbers, texts, truths and times",
            )
        return Parameter(name, Kind(kind))

    def _within(self, where: checked.Group) -> int | None:
        """The longest that a solution may last, by WITHIN and the conditions of the whole."""
        bounds = [] if self._query.within is None else [self._query.within]
        for part in where.parts:
            if isinstance(part, checked.Filter):
                bounds += bounds_of_duration(part.condition)
                if min(bounds, default=0) < 0:
                    raise self._error("nothing lasts less than no time", part.span, "write `<=`")
        return min(bounds, default=None)

    def _error(self, message: str, span: Span, hint: str = "") -> LanguageError:
        return LanguageError(message, self._query.source, span, hint)


def _kind_of_literal(expressions: ExpressionChecker, literal: Literal) -> ValueKind | None:
    """The kind of a literal; None for one that is wrong, which its condition reports."""
    try:
        return kind_of(expressions.constant(literal, Span(0, 0)))
    except LanguageError:
        return None


# -- variables -----------------------------------------------------------------------------------


def _is_variable(term: Term) -> bool:
    return isinstance(term, Variable | BlankNode)


def _name(term: Term) -> str:
    assert isinstance(term, Variable | BlankNode)
    return term.value if isinstance(term, Variable) else f"_:{term.value}"


def _shown(name: str) -> str:
    return name if name.startswith("_:") else f"?{name}"


def _parts_in(part: ast.Part) -> Iterator[ast.Part]:
    """Yield a part and all within it, in reading order."""
    yield part
    match part:
        case ast.Group(parts):
            for each in parts:
                yield from _parts_in(each)
        case ast.Operation(_, left, right):
            yield from _parts_in(left)
            yield from _parts_in(right)


def _variables(part: ast.Part) -> dict[str, None]:
    match part:
        case sparql.Triples():
            return variables_of(part)
        case ast.Filter(condition):
            return variables_of(condition)
        case ast.Bind(expression):
            return variables_of(expression)
        case ast.Graph(_, triples):
            return variables_of(triples)
        case _:
            return {}


def _names(part: checked.Part) -> Iterator[str]:
    """The variables that a part gives a value."""
    match part:
        case checked.Sample(_, arguments, value):
            for place in (*(each for each, _ in arguments), value):
                if isinstance(place, checked.Variable):
                    yield place.name
        case checked.Bind(variable):
            yield variable.name
        case checked.Group(parts):
            yield from _names_of(parts)
        case checked.Operation(_, left, right):
            yield from _names(left)
            yield from _names(right)


def _names_of(parts: list[checked.Part] | tuple[checked.Part, ...]) -> Iterator[str]:
    for part in parts:
        yield from _names(part)
