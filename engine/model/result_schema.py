"""The form of a query's results: the fields, types and annotation of its output stream
([Events14 §V.A], SPEC §4-5)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from typing import Final

from pyoxigraph import BlankNode, Literal, NamedNode, Variable

from ...continuous.algebra.expressions import Const, Expression, Var
from ...continuous.algebra.expressions_from_sparql import ExpressionTranslation
from ...continuous.algebra.unsupported import Unsupported
from ...converters.results_to_samples import (
    ID,
    ResultConverter,
    field_names,
    result_schema,
)
from ...languages.csparql import body_tree
from ...languages.csparql.ast import ContinuousQuery, Form
from ...languages.errors import LanguageError, Span
from ...languages.object_cache import ObjectCache
from ...languages.ssl.annotation import Content, Role, StreamAnnotation
from ...matching.want import THING
from ...ontology.units import Unit
from ...ontology.vocabulary import Vocabulary
from ...rdf.datatypes import NUMBERS
from ...rdf.namespaces import RDF, RDF_TYPE, RDFS, XSD, local_name, shorten
from ...rdf.timed import Kind
from ...sparql import ast
from ...sparql.scope import projected_variables
from ...streams.sample import LONGEST_NAME, TIME_FIELDS, Schema
from ...streams.string_pool import StringPool
from ...templates.patterns import patterns
from .computed_kinds import common_kind, kind_of, kind_of_datatype

_AGGREGATE_KINDS = {"AVG": Kind.DOUBLE, "SUM": Kind.DOUBLE, "COUNT": Kind.INTEGER}
_AMONG: Final = ("MIN", "MAX", "SAMPLE")
"""Aggregates that give one of the values."""


@dataclass(frozen=True, slots=True)
class ResultForm:
    """The form of a query's output stream. ``predicates`` are those of a CONSTRUCT head,
    ``iri_predicates`` those among them whose objects are always IRIs by the query. ``ordered``:
    solutions keep the order of ORDER BY."""

    schema: Schema
    predicates: tuple[str, ...]
    units: Mapping[str, Unit]
    iri_predicates: frozenset[str] = frozenset()
    ordered: bool = False

    def converter(self, pools: dict[str, StringPool]) -> ResultConverter:
        """Make the converter from the query's results to samples of this form."""
        return ResultConverter(
            self.schema, pools, predicates=self.predicates, keep_order=self.ordered
        )

    def event_annotation(
        self, stream: str, event: str, roles: Sequence[Role]
    ) -> StreamAnnotation | None:
        """Return the annotation for matching: the *event* over the sort of its objects, with the
        object of the head's first predicate as value. None for a table.

        It does not name the head's predicates: a stream of speeds above 100 is not a stream of
        speed (SPEC §5).
        """
        if not self.predicates:
            return None
        predicate = self.predicates[0]
        field = field_names(self.predicates)[predicate]
        role = _subject(roles)
        content = Content(event, field, self.units.get(predicate, ()), (role,))
        sort = local_name(role.sort or THING)
        source = (
            f"stream {stream} contains {local_name(event)}({sort}) = {field} for every {sort} = id"
        )
        return StreamAnnotation(stream, (content,), source)

    def rdf_annotation(self, stream: str, roles: Sequence[Role]) -> StreamAnnotation | None:
        """Return the annotation for writing samples as RDF: as the triples of the head."""
        if not self.predicates:
            return None
        names = field_names(self.predicates)
        role = _subject(roles)
        contents = tuple(
            Content(predicate, names[predicate], self.units.get(predicate, ()), (role,))
            for predicate in self.predicates
        )
        return StreamAnnotation(stream, contents, "")


def result_form(query: ContinuousQuery, vocabulary: Vocabulary) -> ResultForm:
    """Return the form of ``query``'s results; features' ranges and expressions decide the types.
    Cost: computed once for all instances of a template."""
    return _form(body_tree(query), vocabulary)


@ObjectCache
def _form(tree: ast.Query, vocabulary: Vocabulary) -> ResultForm:
    if tree.form is Form.ASK:
        return ResultForm(result_schema(ask=True), (), {})
    kinds_of = _kinds(tree, vocabulary)
    if tree.form is not Form.CONSTRUCT:
        schema = result_schema(variables=list(projected_variables(tree)), kinds=kinds_of)
        return ResultForm(schema, (), {}, ordered=bool(tree.order))
    predicates: dict[str, list[Kind | None]] = defaultdict(list)
    for triple in tree.template or ():
        if isinstance(triple.predicate, NamedNode):
            object = triple.object
            kind = None if isinstance(object, BlankNode) else kind_of(_term(object), kinds_of)
            predicates[triple.predicate.value].append(kind)
    units: dict[str, Unit] = {}
    for predicate in predicates:
        info = vocabulary.feature(predicate)
        if info is not None and info.unit is not None:
            units[predicate] = info.unit
    schema = result_schema(
        predicates=list(predicates),
        kinds={
            name: kind for name, of in predicates.items() if (kind := common_kind(of)) is not None
        },
        vocabulary=vocabulary,
    )
    return ResultForm(schema, tuple(predicates), units, _iri_predicates(tree, vocabulary))


def template_of(query: ContinuousQuery) -> Sequence[ast.Triple]:
    """Return the triples of a CONSTRUCT head."""
    return query.body.template or ()


def check_head(query: ContinuousQuery, vocabulary: Vocabulary) -> None:
    """Check that the head decides the fields of samples before the first result: a stream has fixed
    fields. Raises `LanguageError` with a hint."""
    problem = ""
    match query.form:
        case Form.ASK:
            return
        case Form.DESCRIBE:
            problem = "the results of DESCRIBE have no fixed fields, which a stream needs"
            hint = "write CONSTRUCT { ?o <feature> ?value } with the features that you want"
        case Form.CONSTRUCT:
            predicates = [triple.predicate for triple in template_of(query)]
            hint = "write the features that you want: CONSTRUCT { ?o <feature> ?value }"
            if not predicates:
                problem = "the head is empty"
            elif not all(isinstance(predicate, NamedNode) for predicate in predicates):
                problem = "a variable as predicate gives no fixed fields, which a stream needs"
            else:
                problem = _find_non_number(query, vocabulary)
                hint = "write another predicate for it" if problem else hint
        case Form.SELECT:
            names = list(projected_variables(query.body))
            time_names = [name for name in names if name in TIME_FIELDS]
            if not names:
                problem, hint = "the head has no variable", "write ASK to test for any solution"
            elif time_names:
                name = time_names[0]
                problem = f"a field cannot have the name {name!r}: that is a sample's time"
                hint = f"rename it: (?{name} AS ?{name}Time)"
    names = (
        [field.name for field in result_form(query, vocabulary).schema.fields]
        if not problem
        else []
    )
    if any(len(name) > LONGEST_NAME for name in names):
        problem, hint = f"a field's name has at most {LONGEST_NAME} characters", "shorten it"
    if problem:
        start = query.body.span.start
        raise LanguageError(problem, query.source, Span(start, start + len(query.form)), hint)


def _find_non_number(query: ContinuousQuery, vocabulary: Vocabulary) -> str:
    """Return the message for a head that gives a numeric feature an object that cannot be a number;
    else an empty text."""
    names = _iri_places(body_tree(query), vocabulary)
    for triple in template_of(query):
        assert isinstance(triple.predicate, NamedNode)
        predicate, object = triple.predicate.value, triple.object
        info = vocabulary.feature(predicate)
        if info is None or info.range not in NUMBERS:
            continue
        is_text = isinstance(object, Literal) and object.datatype.value not in NUMBERS
        if is_text or isinstance(object, NamedNode | BlankNode) or object in names:
            return f"the values of {shorten(predicate)} are numbers, but {object} is not"
    return ""


def head_role(query: ContinuousQuery, vocabulary: Vocabulary, read: Iterable[Content]) -> Role:
    """Return the role of a head's subjects, by the query's own patterns. Their sort is the one that
    the patterns name, else the only one that the features in ``read`` have, else any thing.

    ``read`` are the contents of the streams.
    """
    contents = list(read)
    body = patterns(body_tree(query))
    sorts = set()
    for subject in dict.fromkeys(triple.subject for triple in template_of(query)):
        own = [pattern for pattern in body if pattern.subject == subject]
        classes = {c.value for pattern in own for c in pattern.classes}
        sorts_named = {name for name in classes if vocabulary.is_sort(name)}
        features = {pattern.predicate.value for pattern in own}
        sorts_read = {
            role.sort
            for content in contents
            if content.feature in features
            for role in content.roles[:1]
        }
        # The narrower a sort, the more sorts contain it.
        narrowest = max(
            sorted(sorts_named), key=lambda sort: len(vocabulary.supersorts(sort)), default=None
        )
        sorts.add(narrowest or (sorts_read.pop() if len(sorts_read) == 1 else None) or THING)
    return Role(sorts.pop() if len(sorts) == 1 else THING, None, ID)


def _iri_predicates(tree: ast.Query, vocabulary: Vocabulary) -> frozenset[str]:
    """Return the predicates of a head whose objects are always IRIs: constants, or variables that
    the body binds to IRIs only."""
    names = _iri_places(tree, vocabulary)
    objects: dict[str, set[ast.Place]] = defaultdict(set)
    for triple in tree.template or ():
        if isinstance(triple.predicate, NamedNode):
            objects[triple.predicate.value].add(triple.object)
    return frozenset(
        predicate
        for predicate, found in objects.items()
        if all(isinstance(each, NamedNode) or each in names for each in found)
    )


def _iri_places(tree: ast.Query, vocabulary: Vocabulary) -> set[ast.Place | None]:
    """Return the terms and variables that cannot be literals, by their places in the body."""
    names: set[ast.Place | None] = set()
    for pattern in patterns(tree):
        names.add(pattern.subject)
        info = vocabulary.feature(pattern.predicate.value)
        if pattern.predicate == RDF_TYPE or (info is not None and _is_class(info.range)):
            names.add(pattern.object)
    return names


def _is_class(range: str | None) -> bool:
    return range is not None and not range.startswith((XSD, RDFS, RDF))


def _kinds(tree: ast.Query, vocabulary: Vocabulary) -> dict[str, Kind]:
    """Return the kinds of the variables that are numbers or booleans: by the ranges of the features
    whose values they are, by VALUES, and by the expressions or aggregates that compute them. Each
    may hold in one branch of a UNION: the kind is one that all of them fit."""
    nodes = list(ast.walk(replace(tree, template=None)))
    bound, others = _bound_kinds(nodes, vocabulary)
    for place in _iri_places(tree, vocabulary):
        if isinstance(place, Variable):
            bound[place.value].append(None)
    aggregates: dict[ast.Aggregate, Variable] = {}
    computed: dict[str, list[Expression | None]] = defaultdict(list)
    for name, one in _computed(nodes):
        computed[name].append(_translate(one, aggregates))
    arguments = {
        each: None if each.argument is None else _translate(each.argument, {})
        for each in aggregates
    }
    kinds: dict[str, Kind] = {}
    # An alias is known when what it stands for is: once more until nothing changes. Names of
    # different scopes may stand for each other, so not for ever.
    for _ in range(len(computed) + len(aggregates) + 2):
        known = {name: list(found) for name, found in bound.items()}
        for each, variable in aggregates.items():
            known[variable.value] = [_kind_of_aggregate(each, arguments[each], kinds, others)]
        for name, expressions in computed.items():
            known.setdefault(name, []).extend(
                None if each is None else kind_of(each, kinds, others) for each in expressions
            )
        before, kinds = kinds, {}
        for name, found in known.items():
            if (kind := common_kind(found)) is not None:
                kinds[name] = kind
        if kinds == before:
            break
    return kinds


def _bound_kinds(
    nodes: Iterable[object], vocabulary: Vocabulary
) -> tuple[dict[str, list[Kind | None]], set[str]]:
    """Return the kinds of variables by the ranges of features and by VALUES, and the variables that
    are something else."""
    bound: dict[str, list[Kind | None]] = defaultdict(list)
    others: set[str] = set()
    for node in nodes:
        if isinstance(node, ast.Triple) and isinstance(node.object, Variable):
            name = node.object.value
            for step in _last_steps(node.predicate):
                info = vocabulary.feature(step.value) if isinstance(step, NamedNode) else None
                range = None if info is None else info.range
                bound[name].append(kind_of_datatype(range))
                if range is not None and bound[name][-1] is None:
                    others.add(name)
        elif isinstance(node, ast.Values):
            for row in node.rows:
                for variable, term in zip(node.variables, row, strict=True):
                    if term is not None:
                        kind = kind_of(Const(term), {})
                        bound[variable.value].append(kind)
                        if kind is None:
                            others.add(variable.value)
    return bound, others


def _last_steps(path: ast.Path | Variable) -> Iterable[ast.Path | Variable]:
    """The steps that a path may end with."""
    match path:
        case ast.Alternative(parts):
            for part in parts:
                yield from _last_steps(part)
        case ast.Sequence(parts):
            yield from _last_steps(parts[-1])
        case _:
            yield path


def _computed(nodes: Iterable[object]) -> Iterable[tuple[str, ast.Expression]]:
    for node in nodes:
        if isinstance(node, ast.Bind | ast.SelectItem) and node.expression is not None:
            yield node.variable.value, node.expression
        elif isinstance(node, ast.Key) and node.alias is not None:
            yield node.alias.value, node.expression


def _translate(
    expression: ast.Expression, aggregates: dict[ast.Aggregate, Variable]
) -> Expression | None:
    """Translate an expression, with a variable for each aggregate; None for an expression that
    plans do not support."""

    def change(node: object) -> Variable | None:
        if not isinstance(node, ast.Aggregate):
            return None
        return aggregates.setdefault(node, Variable(f"__agg_{len(aggregates) + 1}__"))

    try:
        return _EXPRESSIONS.of(ast.rewrite(expression, change))
    except Unsupported:
        return None


def _kind_of_aggregate(
    one: ast.Aggregate,
    argument: Expression | None,
    kinds: Mapping[str, Kind],
    others: Set[str],
) -> Kind | None:
    known = None if argument is None else kind_of(argument, kinds, others)
    if one.function in _AMONG or (one.function == "SUM" and known is Kind.INTEGER):
        return known
    return _AGGREGATE_KINDS.get(one.function)


def _term(term: Variable | NamedNode | Literal) -> Expression:
    return Var(term.value) if isinstance(term, Variable) else Const(term)


_EXPRESSIONS: Final = ExpressionTranslation(_term, lambda _: Const(Literal(True)))


def _subject(roles: Sequence[Role]) -> Role:
    """Return the role of the results' subject, which the field ``id`` names: of the inputs' sort if
    they have a single one."""
    sorts = {role.sort for role in roles if role.sort is not None}
    return Role(sorts.pop() if len(sorts) == 1 else THING, None, ID)
