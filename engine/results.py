"""The form of a query's results: fields, types and meaning of its output stream
([Events14 §V.A], SPEC §4-5)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from pyoxigraph import Literal, NamedNode
from rdflib import BNode, URIRef
from rdflib import Literal as RdflibLiteral
from rdflib import Variable as RdflibVariable
from rdflib.namespace import RDF
from rdflib.plugins.sparql.parserutils import CompValue

from ..continuous.expressions import Const, Expression, Var
from ..continuous.translate_expressions import ExpressionTranslation
from ..continuous.unsupported import Unsupported
from ..converters.to_samples import ID, ResultConverter, field_names, result_schema
from ..languages.attached import attached
from ..languages.csparql import algebra
from ..languages.csparql.ast import ContinuousQuery, Form
from ..languages.csparql.shape import query_shape
from ..languages.errors import LanguageError
from ..languages.ssl.annotation import Content, Role, StreamAnnotation
from ..matching.want import THING
from ..ontology.units import Unit
from ..ontology.vocabulary import Vocabulary
from ..rdf.datatypes import NUMBERS
from ..rdf.namespaces import RDF as RDF_NAMESPACE
from ..rdf.namespaces import RDFS, XSD, local_name, shorten
from ..rdf.timed import DATATYPES, Kind
from ..streams.sample import LONGEST_NAME, TIME_FIELDS, Schema
from ..streams.strings import StringPool
from ..templates.patterns import patterns
from .computed_kinds import kind_of, one_kind

_AGGREGATE_KINDS = {
    "Aggregate_Avg": Kind.DOUBLE,
    "Aggregate_Sum": Kind.DOUBLE,
    "Aggregate_Count": Kind.INTEGER,
}
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
    return _form(algebra(query).algebra, query.form, query.sparql, vocabulary)


@attached
def _form(tree: CompValue, form: Form, sparql: str, vocabulary: Vocabulary) -> ResultForm:
    if form is Form.ASK:
        return ResultForm(result_schema(ask=True), (), {})
    kinds_of = _kinds(tree, vocabulary)
    if form is not Form.CONSTRUCT:
        variables = [str(variable) for variable in tree.PV]
        schema = result_schema(variables=variables, kinds=kinds_of)
        shape = query_shape(sparql)
        return ResultForm(
            schema, (), {}, ordered=shape is not None and bool(shape.modifier("ORDER"))
        )
    predicates: dict[str, Kind | None] = {}
    for _, predicate, object in tree.template or ():
        if isinstance(predicate, URIRef):
            kind = kinds_of.get(str(object)) if isinstance(object, RdflibVariable) else None
            predicates.setdefault(str(predicate), kind)
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


def template_of(query: ContinuousQuery) -> Sequence[tuple[Any, Any, Any]]:
    """The triples of a CONSTRUCT head."""
    return algebra(query).algebra.template or ()


def check_head(query: ContinuousQuery, vocabulary: Vocabulary) -> None:
    """The results of ``query`` make samples, whose fields are known before the first; raises
    `LanguageError`, which says what to write instead."""
    tree = algebra(query).algebra
    told = ""
    match query.form:
        case Form.ASK:
            return
        case Form.DESCRIBE:
            told = "what DESCRIBE gives has no fields that are known beforehand"
            hint = "write CONSTRUCT { ?o <feature> ?value } with the features that are wanted"
        case Form.CONSTRUCT:
            predicates = [predicate for _, predicate, _ in template_of(query)]
            hint = "write the features that are wanted: CONSTRUCT { ?o <feature> ?value }"
            if not predicates:
                told = "the head says nothing"
            elif not all(isinstance(predicate, URIRef) for predicate in predicates):
                told = "a predicate that is a variable gives no fields that are known beforehand"
            else:
                told = _no_number(query, vocabulary)
                hint = "write another predicate for it" if told else hint
        case Form.SELECT:
            names = [str(variable) for variable in tree.PV]
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
        shape = query_shape(query.sparql)
        assert shape is not None, "parse_query refuses a text without WHERE"
        raise LanguageError(told, query.source, shape.tokens[shape.start].span, hint)


def _no_number(query: ContinuousQuery, vocabulary: Vocabulary) -> str:
    """What a head says of a feature whose values are numbers, and that can be none."""
    names = _names(algebra(query).algebra, vocabulary)
    for _, predicate, object in template_of(query):
        info = vocabulary.feature(str(predicate))
        if info is None or info.range not in NUMBERS:
            continue
        is_text = isinstance(object, RdflibLiteral) and str(object.datatype) not in NUMBERS
        if is_text or isinstance(object, URIRef | BNode) or object in names:
            return f"the values of {shorten(str(predicate))} are numbers, {object.n3()} is none"
    return ""


def head_role(query: ContinuousQuery, vocabulary: Vocabulary, read: Iterable[Content]) -> Role:
    """What the subjects of a head are, by what the query itself requires of them: one sort, if it
    names one for all of them, or if all that it reads of them speaks of one; else any thing.

    ``read`` is what the streams contain.
    """
    tree = algebra(query).algebra
    contents = list(read)
    body = patterns(tree)
    sorts = set()
    for subject in dict.fromkeys(subject for subject, _, _ in template_of(query)):
        own = [pattern for pattern in body if pattern.subject == subject]
        named = {str(c) for pattern in own for c in pattern.classes if vocabulary.is_sort(str(c))}
        features = {str(pattern.predicate) for pattern in own}
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


def _naming(tree: CompValue, vocabulary: Vocabulary) -> frozenset[str]:
    """The predicates of a head whose objects are always IRIs: written so, or stand in the body
    where nothing else can."""
    names = _names(tree, vocabulary)
    objects: dict[str, set[Any]] = defaultdict(set)
    for _, predicate, object in tree.template or ():
        objects[str(predicate)].add(object)
    return frozenset(
        predicate
        for predicate, found in objects.items()
        if all(isinstance(each, URIRef) or each in names for each in found)
    )


def _names(tree: CompValue, vocabulary: Vocabulary) -> set[Any]:
    """What can only be a name, and no literal, by where it stands in the body."""
    names = set()
    for pattern in patterns(tree):
        names.add(pattern.subject)
        info = vocabulary.feature(str(pattern.predicate))
        if pattern.predicate == RDF.type or (info is not None and _is_class(info.range)):
            names.add(pattern.object)
    return names


def _is_class(range: str | None) -> bool:
    return range is not None and not range.startswith((XSD, RDFS, RDF_NAMESPACE))


def _kinds(tree: CompValue, vocabulary: Vocabulary) -> dict[str, Kind]:
    """Kinds of the variables that are numbers or booleans: by the range of the feature whose
    value they are, and by the aggregate that computes them."""
    kinds: dict[str, Kind] = {}
    said: dict[str, Kind | None] = {}
    others: set[str] = set()
    made: dict[str, dict[int, Kind | None]] = defaultdict(dict)

    def learn(node: Any) -> None:
        if not isinstance(node, CompValue):
            return
        if node.name == "BGP":
            for _, predicate, object in node.triples:
                info = vocabulary.feature(str(predicate))
                kind = _KIND_OF_RANGE.get((info.range if info else None) or "")
                if not isinstance(object, RdflibVariable):
                    continue
                if info is not None and info.range is not None and kind is None:
                    others.add(str(object))
                if said.setdefault(str(object), kind) is not kind:
                    # In a UNION the one may hold or the other: text fits both.
                    kind = said[str(object)] = None
                if kind is None:
                    kinds.pop(str(object), None)
                else:
                    kinds[str(object)] = kind
        elif node.name.startswith("Aggregate_"):
            argument = kinds.get(str(node.vars))
            kind = _AGGREGATE_KINDS.get(node.name, argument)
            if node.name == "Aggregate_Sum" and argument is Kind.INTEGER:
                kind = Kind.INTEGER
            if kind is not None:
                kinds[str(node.res)] = kind
        elif node.name == "Extend":
            try:
                kind = kind_of(_EXPRESSIONS.of(node.expr, {}), kinds, others)
            except Unsupported:
                kind = None
            made[str(node.var)][id(node)] = kind
            kind = one_kind([*made[str(node.var)].values()])
            if kind is not None:
                kinds[str(node.var)] = kind

    # An alias is known when what it stands for is: once more until nothing new is learnt.
    before = -1
    while before < len(kinds):
        before = len(kinds)
        _walk(tree, learn)
    for name, found in made.items():
        bound = [said[name]] if name in said else []
        known = one_kind([*found.values(), *bound])
        if known is None:
            # In a UNION the one may hold or the other: text fits both.
            kinds.pop(name, None)
        else:
            kinds[name] = known
    for name in _names(tree, vocabulary):
        # A number in one branch of a UNION, a name in another.
        kinds.pop(str(name), None)
    return kinds


def _term(node: Any) -> Expression:
    if isinstance(node, RdflibVariable):
        return Var(str(node))
    if isinstance(node, RdflibLiteral) and node.datatype is not None:
        return Const(Literal(str(node), datatype=NamedNode(str(node.datatype))))
    return Const(Literal(str(node)))


_EXPRESSIONS: Final = ExpressionTranslation(_term, lambda _: Const(Literal(True)))


def _walk(node: Any, visit: Callable[[Any], None]) -> None:
    if isinstance(node, CompValue):
        for key, part in node.items():
            if not key.startswith("_"):
                _walk(part, visit)
        visit(node)
    elif isinstance(node, list | tuple):
        for part in node:
            _walk(part, visit)


def _subject(roles: Sequence[Role]) -> Role:
    """The subject of results: an object of the sort that the inputs speak of, named by ``id``."""
    sorts = {role.sort for role in roles if role.sort is not None}
    return Role(sorts.pop() if len(sorts) == 1 else THING, None, ID)
