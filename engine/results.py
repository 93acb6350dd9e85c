"""The form of a query's results: fields, types and meaning of its output stream
([Events14 §V.A], SPEC §4-5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rdflib import URIRef
from rdflib import Variable as RdflibVariable

from ..converters.to_samples import ID, ResultConverter, field_names, result_schema
from ..languages.csparql import algebra
from ..languages.csparql.ast import ContinuousQuery, Form
from ..languages.ssl.annotation import Content, Role, StreamAnnotation
from ..matching.plan import local_name
from ..matching.want import THING
from ..ontology.units import Unit
from ..ontology.vocabulary import Vocabulary
from ..rdf.timed import Kind
from ..streams.sample import Schema
from ..streams.strings import StringPool

_AGGREGATE_KINDS = {"AVG": Kind.DOUBLE, "SUM": Kind.DOUBLE, "COUNT": Kind.INTEGER}


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
    """The form of ``query``'s results: types by the head's predicates and aggregates."""
    tree = algebra(query)
    kinds_of = {
        aggregation.alias.value: _AGGREGATE_KINDS[aggregation.function]
        for aggregation in query.aggregations
        if aggregation.function in _AGGREGATE_KINDS
    }
    if query.form is Form.ASK:
        return ResultForm(result_schema(ask=True), (), {})
    if query.form is not Form.CONSTRUCT:
        variables = [str(variable) for variable in tree.algebra.PV]
        kinds = {name: kinds_of[name] for name in variables if name in kinds_of}
        return ResultForm(result_schema(variables=variables, kinds=kinds), (), {})
    predicates: dict[str, Kind | None] = {}
    for _, predicate, object in tree.algebra.template:
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


def _subject(roles: Sequence[Role]) -> Role:
    """The subject of results: an object of the sort that the inputs speak of, named by ``id``."""
    sorts = {role.sort for role in roles if role.sort is not None}
    return Role(sorts.pop() if len(sorts) == 1 else THING, None, ID)
