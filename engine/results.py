"""The form of a query's results: fields, types and meaning of its output stream
([Events14 §V.A], SPEC §4-5)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rdflib import URIRef
from rdflib import Variable as RdflibVariable
from rdflib.plugins.sparql.parserutils import CompValue

from ..converters.to_samples import ID, ResultConverter, field_names, result_schema
from ..languages.csparql import algebra
from ..languages.csparql.ast import ContinuousQuery, Form
from ..languages.ssl.annotation import Content, Role, StreamAnnotation
from ..matching.want import THING
from ..ontology.units import Unit
from ..ontology.vocabulary import Vocabulary
from ..rdf.namespaces import local_name
from ..rdf.timed import DATATYPES, Kind
from ..streams.sample import Schema
from ..streams.strings import StringPool

_AGGREGATE_KINDS = {
    "Aggregate_Avg": Kind.DOUBLE,
    "Aggregate_Sum": Kind.DOUBLE,
    "Aggregate_Count": Kind.INTEGER,
}
_KIND_OF_RANGE = {datatype.value: kind for kind, datatype in DATATYPES.items()}


@dataclass(frozen=True, slots=True)
class ResultForm:
    """What a query's output stream looks like. ``predicates`` are those of a CONSTRUCT head."""

    schema: Schema
    predicates: tuple[str, ...]
    units: Mapping[str, Unit]

    def converter(self, pools: dict[str, StringPool]) -> ResultConverter:
        """Converts the query's results to samples of this form."""
        return ResultConverter(self.schema, pools, predicates=self.predicates)

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
    """The form of ``query``'s results: types by features' ranges and by aggregates."""
    tree = algebra(query).algebra
    if query.form is Form.ASK:
        return ResultForm(result_schema(ask=True), (), {})
    kinds_of = _kinds(tree, vocabulary)
    if query.form is not Form.CONSTRUCT:
        variables = [str(variable) for variable in tree.PV]
        return ResultForm(result_schema(variables=variables, kinds=kinds_of), (), {})
    predicates: dict[str, Kind | None] = {}
    for _, predicate, object in tree.template:
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
    return ResultForm(schema, tuple(predicates), units)


def _kinds(tree: CompValue, vocabulary: Vocabulary) -> dict[str, Kind]:
    """Kinds of the variables that are numbers or booleans: by the range of the feature whose
    value they are, and by the aggregate that computes them."""
    kinds: dict[str, Kind] = {}

    def learn(node: Any) -> None:
        if not isinstance(node, CompValue):
            return
        if node.name == "BGP":
            for _, predicate, object in node.triples:
                info = vocabulary.feature(str(predicate))
                kind = _KIND_OF_RANGE.get((info.range if info else None) or "")
                if kind is not None and isinstance(object, RdflibVariable):
                    kinds.setdefault(str(object), kind)
        elif node.name.startswith("Aggregate_"):
            argument = kinds.get(str(node.vars))
            kind = _AGGREGATE_KINDS.get(node.name, argument)
            if node.name == "Aggregate_Sum" and argument is Kind.INTEGER:
                kind = Kind.INTEGER
            if kind is not None:
                kinds[str(node.res)] = kind
        elif node.name == "Extend" and isinstance(node.expr, RdflibVariable):
            kind = kinds.get(str(node.expr))
            if kind is not None:
                kinds[str(node.var)] = kind

    # An alias is known when what it stands for is: once more until nothing new is learnt.
    before = -1
    while before < len(kinds):
        before = len(kinds)
        _walk(tree, learn)
    return kinds


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
