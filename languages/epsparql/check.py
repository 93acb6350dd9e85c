"""Checks EP-SPARQL queries against the ontology: features, sorts, kinds, scopes (SPEC §8).

A variable has one kind. The range of a feature says which; without a range another place of the
variable or the other side of a comparison decides, else it is a number. A condition sees the
variables of its own group, as in SPARQL.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import assert_never

from pyoxigraph import Literal, NamedNode, Variable

from ...ontology.vocabulary import THING, Vocabulary
from ...rdf.namespaces import shorten
from ...sparql import ast as sparql
from ...sparql.ast import variables_of
from ..errors import LanguageError, Span
from ..hints import did_you_mean, meant
from ..mtl.checked import Constant, Kind, ObjectConstant, ObjectSlot, Parameter
from . import ast, checked
from .binding import check_horizon
from .checked import CheckedPattern, kind_of
from .expressions import ExpressionChecker
from .groups import Classes, classes_of, parts_in, triples_in, union, variables_in
from .head import HeadChecker
from .kinds import find_kinds
from .triples import (
    BLANK,
    Read,
    Reading,
    Sorts,
    StaticTriple,
    Term,
    TripleReader,
)


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
        self._vocabulary = vocabulary
        self._reader = TripleReader(query.source, vocabulary, is_static)
        self._read: dict[int, tuple[Read, ...]] = {}
        self._kinds: dict[str, Kind] = {}
        self._static: dict[str, Kind] = {}
        """The variables that static triples have, and no sample, with their kinds in conditions."""
        self._parameters = {each.value for each in query.parameters}
        self._arguments: set[Term] = set()
        self._expressions = ExpressionChecker(query.source, self._kinds, self._static)

    def pattern(self) -> CheckedPattern:
        """Return the checked query."""
        query = self._query
        for triples in triples_in(query.where):
            self._read[id(triples)] = self._reader.read(triples)
        reads = [read for reads in self._read.values() for read in reads]
        readings = [read for read in reads if isinstance(read, Reading)]
        kinds, static = find_kinds(query, reads)
        self._kinds.update(kinds)
        self._static.update(static)
        self._arguments.update(term for read in readings for term in read.arguments)
        if not readings:
            raise self._error(
                "the pattern reads no feature, so nothing ever happens",
                query.where.span,
                self._meant(reads) or "write a triple of a feature: `?c dyknow:price ?p`",
            )
        where = self._group(query.where, {})
        within = self._within()
        check_horizon(where, query.source)
        names = set(_names(where))
        head = HeadChecker(
            query,
            self._expressions,
            names | self._parameters,
            {name for name in self._static if not name.startswith(BLANK)},
            {read.feature for read in readings},
            lambda span: self._known(names, span),
        )
        return CheckedPattern(
            query.name,
            query.form,
            tuple(map(self._slot, query.parameters)),
            head.items(),
            where,
            within,
            query.max_delay,
            query.graphs,
            query.source,
        )

    def _meant(self, reads: Iterable[Read]) -> str:
        """A hint at features whose names are similar to those of static triples."""
        for read in reads:
            if isinstance(read, StaticTriple) and isinstance(read.triple.predicate, NamedNode):
                name = read.triple.predicate.value
                hint = meant(self._vocabulary.suggest(name, "feature"))
                if hint:
                    return f"{shorten(name)} is no feature; {hint}"
        return ""

    # -- groups ------------------------------------------------------------------------------

    def _group(self, group: ast.Group, outer: Classes) -> checked.Group:
        own = classes_of(group, self._reads)
        classes = union(outer, own)
        parts: list[checked.Part] = []
        conditions: list[ast.Filter] = []
        for part in group.parts:
            match part:
                case sparql.Triples():
                    parts += self._triples(part, classes, own)
                case ast.Group() | ast.Operation():
                    parts.append(self._operand(part, classes))
                case ast.Graph(name, triples):
                    found = [self._reader.named(each) for each in triples]
                    parts += [checked.Static(each, name.value, each.span) for each in found]
                case ast.Bind():
                    parts.append(self._bind(part, set(_names_of(parts))))
                case ast.Filter():
                    conditions.append(part)
                case _:
                    assert_never(part)
        names = {*_names_of(parts), *self._static_names(parts)}
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

    def _triples(
        self, triples: sparql.Triples, classes: Classes, own: Classes
    ) -> Iterator[checked.Part]:
        """Check triples; ``own``: the sorts of the group itself. Its samples have the sort that it
        states of their objects; of any other object the sort is a static triple."""
        for read in self._read[id(triples)]:
            match read:
                case Reading():
                    yield self._sample(read, classes)
                case Sorts(subject, sort, triple):
                    if THING in own[subject]:
                        continue
                    if not (isinstance(subject, Variable) and subject.value in self._kinds):
                        raise self._error(
                            f"{subject} is in no sample of the pattern, so its sort says nothing",
                            triple.span,
                            f"read a feature of {subject}, or leave `a {shorten(sort)}` out",
                        )
                    yield checked.Static(triple, None, triple.span)
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
        if isinstance(read.value, Variable):
            name = read.value.value
            known = self._kinds.setdefault(name, Kind.NUMBER)
            assert known != Kind.DURATION
            kind = known
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
        if isinstance(term, Variable):
            return checked.Variable(term.value, kind)
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

    def _static_names(self, parts: Iterable[checked.Part]) -> Iterator[str]:
        """The variables that only static triples have, of these parts."""
        for part in parts:
            match part:
                case checked.Static(triple):
                    yield from (name for name in variables_of(triple) if name in self._static)
                case checked.Group(inner):
                    yield from self._static_names(inner)
                case checked.Operation(_, left, right):
                    yield from self._static_names((left, right))

    def _known(self, names: set[str], span: Span) -> Callable[[str], None]:
        """Return a function that raises `LanguageError` for a variable without a value."""

        def check(name: str) -> None:
            if name in names or name in self._parameters:
                return
            message = f"`?{name}` is not bound in this group"
            if name in self._static:
                message = f"`?{name}` has its value from static graphs"
                hint = "a condition in the group of its triple may read it, and the head"
            elif name in self._kinds:
                hint = "a condition sees its own group: write it after the `}` of a larger one"
            else:
                shown = [f"?{each}" for each in sorted(names) if not each.startswith(BLANK)]
                hint = did_you_mean(f"?{name}", shown) or f"the group has {', '.join(shown)}"
            raise self._error(message, span, hint)

        return check

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
        used = {each for part in parts_in(self._query.where) for each in variables_in(part)}
        if name not in used and parameter != self._query.within:
            raise self._error(
                f"the pattern does not use `?{name}`",
                self._query.head,
                "use it, as in `FILTER (?price > ?limit)`, or leave it out",
            )
        return Parameter(name, self._kinds[name])

    def _within(self) -> checked.Duration | checked.Variable | None:
        match self._query.within:
            case Variable(value=name):
                if name not in self._parameters:
                    raise self._error(
                        f"`?{name}` has no value",
                        self._query.head,
                        "only a template has parameters: `REGISTER TEMPLATE e(?x) AS …`",
                    )
                return checked.Variable(name, Kind.DURATION)
            case int(within):
                return checked.Duration(within)
            case _:
                return None

    def _error(self, message: str, span: Span, hint: str = "") -> LanguageError:
        return LanguageError(message, self._query.source, span, hint)


# -- variables -----------------------------------------------------------------------------------


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
