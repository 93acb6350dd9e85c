"""The form of a query's results: fields, types and meaning of its output stream
([Events14 §V.A], SPEC §4-5)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from pyoxigraph import BlankNode, Literal, NamedNode, Variable

from ...continuous.algebra.expressions import Const, Expression, Var
from ...continuous.algebra.expressions_from_sparql import ExpressionTranslation
from ...continuous.algebra.unsupported import Unsupported
from ...converters.to_samples import (
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
from ...rdf.timed import DATATYPES, Kind
from ...sparql import ast
from ...sparql.scope import projected_variables
from ...streams.sample import LONGEST_NAME, TIME_FIELDS, Schema
from ...streams.string_pool import StringPool
from ...templates.patterns import patterns
from .computed_kinds import kind_of, one_kind

_AGGREGATE_KINDS = {"AVG": Kind.DOUBLE, "SUM": Kind.DOUBLE, "COUNT": Kind.INTEGER}
_KIND_OF_RANGE = {datatype.value: kind for kind, datatype in DATATYPES.items()}


@dataclass(frozen=True, slots=True)
class ResultForm:
    """What a query's output stream looks like. ``predicates`` are those of a CONSTRUCT head,
    ``naming`` the ones among them whose objects are names and no literals, as the query has it;
    ``ordered``: solutions keep the order that ORDER BY gives them."""

    schema: Schema
    predicates: tuple[str, ...]
    units: Mapping[str, Unit]
    naming: frozenset[str] = frozenset()
    ordered: bool = False

    def converter(self, pools: dict[str, StringPool]) -> ResultConverter:
        """Converts the query's results to samples of this form."""
        return ResultConverter(
            self.schema, pools, predicates=self.predicates, keep_order=self.ordered
        )

    def event_annotation(
        self, stream: str, event: str, roles: Sequence[Role]
    ) -> StreamAnnotation | None:
        """What the stream contains: its *event* over the sorts of its objects, not the head's
        predicates, for speeds above 100 are no stream of speed (SPEC §5). None for a table.

        The event's value is the object of the head's first predicate.
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
        """How samples of the stream are written as the triples that the head constructed."""
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
    """The form of ``query``'s results: types by features' ranges and by aggregates. Cost: found
    once for all instances of a template."""
    return _form(body_tree(query), vocabulary)


@ObjectCache
def _form(tree: ast.Query, vocabulary: Vocabulary) -> ResultForm:
    if tree.form is Form.ASK:
        return ResultForm(result_schema(ask=True), (), {})
    kinds_of = _kinds(tree, vocabulary)
    if tree.form is not Form.CONSTRUCT:
        schema = result_schema(variables=list(projected_variables(tree)), kinds=kinds_of)
        return ResultForm(schema, (), {}, ordered=bool(tree.order))
    predicates: dict[str, Kind | None] = {}
    for triple in tree.template or ():
        if isinstance(triple.predicate, NamedNode):
            object = triple.object
            kind = kinds_of.get(object.value) if isinstance(object, Variable) else None
            predicates.setdefault(triple.predicate.value, kind)
    units: dict[str, Unit] = {}
    for predicate in predicates:
        info = vocabulary.feature(predicate)
        if info is not None and info.unit is not None:
            units[predicate] = info.unit
    schema = result_schema(
        predicates=list(predicates),
        kinds={name: kind for name, kind in predicates.items() if kind is not None},
        vocabulary=vocabulary,
    )
    return ResultForm(schema, tuple(predicates), units, _naming(tree, vocabulary))


def template_of(query: ContinuousQuery) -> Sequence[ast.Triple]:
    """The triples of a CONSTRUCT head."""
    return query.body.template or ()


def check_head(query: ContinuousQuery, vocabulary: Vocabulary) -> None:
    """The results of ``query`` make samples, whose fields are known before the first; raises
    `LanguageError`, which says what to write instead."""
    told = ""
    match query.form:
        case Form.ASK:
            return
        case Form.DESCRIBE:
            told = "what DESCRIBE gives has no fields that are known beforehand"
            hint = "write CONSTRUCT { ?o <feature> ?value } with the features that are wanted"
        case Form.CONSTRUCT:
            predicates = [triple.predicate for triple in template_of(query)]
            hint = "write the features that are wanted: CONSTRUCT { ?o <feature> ?value }"
            if not predicates:
                told = "the head says nothing"
            elif not all(isinstance(predicate, NamedNode) for predicate in predicates):
                told = "a predicate that is a variable gives no fields that are known beforehand"
            else:
                told = _no_number(query, vocabulary)
                hint = "write another predicate for it" if told else hint
        case Form.SELECT:
            names = list(projected_variables(query.body))
            taken = [name for name in names if name in TIME_FIELDS]
            if not names:
                told, hint = "the head has no variable", "write ASK to know whether there is any"
            elif taken:
                told = f"a field cannot be called {taken[0]!r}: that is a sample's time"
                hint = f"rename it: (?{taken[0]} AS ?{taken[0]}Time)"
    names = (
        [field.name for field in result_form(query, vocabulary).schema.fields] if not told else []
    )
    if any(len(name) > LONGEST_NAME for name in names):
        told, hint = f"a field's name has at most {LONGEST_NAME} characters", "shorten it"
    if told:
        start = query.body.span.start
        raise LanguageError(told, query.source, Span(start, start + len(query.form)), hint)


def _no_number(query: ContinuousQuery, vocabulary: Vocabulary) -> str:
    """What a head says of a feature whose values are numbers, and that can be none."""
    names = _names(body_tree(query), vocabulary)
    for triple in template_of(query):
        assert isinstance(triple.predicate, NamedNode)
        predicate, object = triple.predicate.value, triple.object
        info = vocabulary.feature(predicate)
        if info is None or info.range not in NUMBERS:
            continue
        is_text = isinstance(object, Literal) and object.datatype.value not in NUMBERS
        if is_text or isinstance(object, NamedNode | BlankNode) or object in names:
            return f"the values of {shorten(predicate)} are numbers, {object} is none"
    return ""


def head_role(query: ContinuousQuery, vocabulary: Vocabulary, read: Iterable[Content]) -> Role:
    """What the subjects of a head are, by what the query itself requires of them: one sort, if it
    names one for all of them, or if all that it reads of them speaks of one; else any thing.

    ``read`` is what the streams contain.
    """
    contents = list(read)
    body = patterns(body_tree(query))
    sorts = set()
    for subject in dict.fromkeys(triple.subject for triple in template_of(query)):
        own = [pattern for pattern in body if pattern.subject == subject]
        classes = {c.value for pattern in own for c in pattern.classes}
        named = {name for name in classes if vocabulary.is_sort(name)}
        features = {pattern.predicate.value for pattern in own}
        told = {
            role.sort
            for content in contents
            if content.feature in features
            for role in content.roles[:1]
        }
        # The narrower a sort, the more sorts contain it.
        narrow = max(sorted(named), key=lambda sort: len(vocabulary.supersorts(sort)), default=None)
        sorts.add(narrow or (told.pop() if len(told) == 1 else None) or THING)
    return Role(sorts.pop() if len(sorts) == 1 else THING, None, ID)


def _naming(tree: ast.Query, vocabulary: Vocabulary) -> frozenset[str]:
    """The predicates of a head whose objects are always IRIs: written so, or stand in the body
    where nothing else can."""
    names = _names(tree, vocabulary)
    objects: dict[str, set[ast.Place]] = defaultdict(set)
    for triple in tree.template or ():
        if isinstance(triple.predicate, NamedNode):
            objects[triple.predicate.value].add(triple.object)
    return frozenset(
        predicate
        for predicate, found in objects.items()
        if all(isinstance(each, NamedNode) or each in names for each in found)
    )


def _names(tree: ast.Query, vocabulary: Vocabulary) -> set[ast.Place | None]:
    """What can only be a name, and no literal, by where it stands in the body."""
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
    """Kinds of the variables that are numbers or booleans: by the range of the feature whose
    value they are, and by the expression or aggregate that computes them."""
    nodes = list(ast.walk(replace(tree, template=None)))
    said, others = _ranges(nodes, vocabulary)
    kinds = {name: kind for name, kind in said.items() if kind is not None}
    aggregates: dict[ast.Aggregate, Variable] = {}
    named = [(name, _translated(one, aggregates)) for name, one in _computed(nodes)]
    made: dict[str, dict[int, Kind | None]] = defaultdict(dict)
    # An alias is known when what it stands for is: once more until nothing new is learnt.
    before = -1
    while before < len(kinds):
        before = len(kinds)
        for aggregate, variable in aggregates.items():
            known = _kind_of_aggregate(aggregate, kinds)
            if known is not None:
                kinds[variable.value] = known
        for number, (name, expression) in enumerate(named):
            found = None if expression is None else kind_of(expression, kinds, others)
            made[name][number] = found
            known = one_kind([*made[name].values()])
            if known is not None:
                kinds[name] = known
    for name, kinds_of in made.items():
        known = one_kind([*kinds_of.values(), *([said[name]] if name in said else [])])
        if known is None:
            # In a UNION the one may hold or the other: text fits both.
            kinds.pop(name, None)
        else:
            kinds[name] = known
    for place in _names(tree, vocabulary):
        # A number in one branch of a UNION, a name in another.
        if isinstance(place, Variable):
            kinds.pop(place.value, None)
    return kinds


def _ranges(
    nodes: Iterable[object], vocabulary: Vocabulary
) -> tuple[dict[str, Kind | None], set[str]]:
    """The kinds of objects by the ranges of features, and the objects that are something else."""
    said: dict[str, Kind | None] = {}
    others: set[str] = set()
    for node in nodes:
        if not isinstance(node, ast.Triple) or not isinstance(node.object, Variable):
            continue
        name, predicate = node.object.value, node.predicate
        info = vocabulary.feature(predicate.value) if isinstance(predicate, NamedNode) else None
        kind = _KIND_OF_RANGE.get((info.range if info else None) or "")
        if info is not None and info.range is not None and kind is None:
            others.add(name)
        # In a UNION the one may hold or the other: text fits both.
        if said.setdefault(name, kind) is not kind:
            said[name] = None
    return said, others


def _computed(nodes: Iterable[object]) -> Iterable[tuple[str, ast.Expression]]:
    for node in nodes:
        if isinstance(node, ast.Bind | ast.SelectItem) and node.expression is not None:
            yield node.variable.value, node.expression
        elif isinstance(node, ast.Key) and node.alias is not None:
            yield node.alias.value, node.expression


def _translated(
    expression: ast.Expression, aggregates: dict[ast.Aggregate, Variable]
) -> Expression | None:
    """An expression with a variable for each aggregate; None for what plans do not have."""

    def change(node: object) -> Variable | None:
        if not isinstance(node, ast.Aggregate):
            return None
        return aggregates.setdefault(node, Variable(f"__agg_{len(aggregates) + 1}__"))

    try:
        return _EXPRESSIONS.of(ast.rewrite(expression, change))
    except Unsupported:
        return None


def _kind_of_aggregate(one: ast.Aggregate, kinds: Mapping[str, Kind]) -> Kind | None:
    known = kinds.get(one.argument.value) if isinstance(one.argument, Variable) else None
    if one.function == "SUM" and known is Kind.INTEGER:
        return Kind.INTEGER
    return _AGGREGATE_KINDS.get(one.function, known)


def _term(term: Variable | NamedNode | Literal) -> Expression:
    return Var(term.value) if isinstance(term, Variable) else Const(term)


_EXPRESSIONS: Final = ExpressionTranslation(_term, lambda _: Const(Literal(True)))


def _subject(roles: Sequence[Role]) -> Role:
    """The subject of results: an object of the sort that the inputs speak of, named by ``id``."""
    sorts = {role.sort for role in roles if role.sort is not None}
    return Role(sorts.pop() if len(sorts) == 1 else THING, None, ID)
