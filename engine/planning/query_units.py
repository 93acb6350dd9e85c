"""Continuous queries over matched streams: the C-SPARQL units behind events ([Events14 §V.B])."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Generic, TypeAlias

from pyoxigraph import Variable

from ...continuous.algebra.constant_lifting import Pattern
from ...continuous.algebra.options import Options
from ...continuous.columns.budget import UNLIMITED, Budget
from ...continuous.columns.relation import TermValues
from ...continuous.estimation.input_rates import Flow
from ...continuous.evaluation.evaluator import ContinuousEvaluator
from ...continuous.operators.results import WindowResult
from ...continuous.operators.sources import StaticSide
from ...continuous.sharing.shared_windows import SharedWindows
from ...continuous.sharing.similar_queries import SimilarQueriesEvaluator, break_even_count
from ...continuous.sharing.template_instances import TemplateEvaluator
from ...converters.to_triples import SampleConverter
from ...languages.csparql import format_query, with_streams
from ...languages.csparql.ast import ContinuousQuery
from ...languages.ssl.annotation import Content, StreamAnnotation
from ...matching.plan import (
    Node,
    Supply,
    SupplySource,
    own_annotation,
    wanted_annotation,
)
from ...ontology.ontology import Ontology
from ...ontology.units import Unit
from ...rdf.dictionary import Term, TermDictionary
from ...streams.generator import StreamGenerator
from ..configuration.configuration import (
    C_SPARQL,
    SELECT_INSTANCE,
    AnyUnit,
    Configuration,
)
from ..model.beginning import Beginning, check_retained
from ..model.result_schema import ResultForm, result_form
from ..model.views import Since
from ..units.query import QueryUnit
from ..units.shared_query import TALLY, InstanceUnit, TemplateUnit
from . import explain as explanations
from .query_sharing import Kin


@dataclass(frozen=True, slots=True, eq=False)
class Manner:
    """How a query runs beside what it says: the name of its stream (None: one of the system's),
    how it is read where the text leaves that open, who hears of each window's result."""

    name: str | None = None
    options: Options = field(default_factory=Options)
    hear: Callable[[WindowResult], None] | None = None


Read: TypeAlias = Mapping[StreamGenerator, SampleConverter]
"""Streams that a query names, each with the converter of all that it says."""
_OTHERS = "# and queries that differ from this one in constants\n"

EVENT = Manner()
"""How the query of an event runs."""


@dataclass(frozen=True, slots=True, eq=False)
class BuiltQuery(Generic[AnyUnit]):
    """A C-SPARQL unit at work. ``annotation`` says what its stream means (None of a table),
    ``rdf`` how its samples are written as triples."""

    unit: AnyUnit
    annotation: StreamAnnotation | None
    rdf: StreamAnnotation | None


class Queries:
    """Starts queries over the streams of plan nodes, which ``obtain`` gives."""

    def __init__(
        self,
        ontology: Ontology,
        dictionary: TermDictionary,
        configuration: Configuration,
        obtain: Callable[[Node, Beginning], StreamGenerator],
        budget: Budget = UNLIMITED,
    ) -> None:
        self._ontology = ontology
        self._dictionary = dictionary
        self._configuration = configuration
        self._obtain = obtain
        self._budget = budget

    def form(self, query: ContinuousQuery) -> ResultForm:
        """What the results of a query look like."""
        return result_form(query, self._ontology.vocabulary)

    def start(
        self,
        query: ContinuousQuery,
        supplies: Sequence[Supply],
        since: Beginning,
        manner: Manner = EVENT,
    ) -> BuiltQuery[QueryUnit]:
        """Start what the supplies ask for, inputs first, then the query unit over them."""
        inputs, converters = self._read(supplies, since)
        form = self.form(query)
        query = with_streams(query, list(inputs))
        unit = self._start(query, inputs, converters, form, since, manner)
        return _built(unit, query, form, supplies)

    def start_template(self, query: ContinuousQuery, supplies: Sequence[Supply]) -> TemplateUnit:
        """Start the query of a template, its parameters free, over what the supplies ask for."""
        inputs, converters = self._read(supplies, Since.NOW)
        query = with_streams(query, list(inputs))
        evaluator = self._evaluator(query, list(inputs))
        return self._start_shared(query, inputs, converters, evaluator)

    def start_instance(
        self,
        template: TemplateUnit,
        query: ContinuousQuery,
        supplies: Sequence[Supply],
        request: str,
    ) -> BuiltQuery[InstanceUnit]:
        """Start the part of ``query``, which is the template's with the arguments of ``request``
        (its text); ``supplies`` are those it would have by itself."""
        evaluator = template.evaluator
        assert isinstance(evaluator, TemplateEvaluator)
        form = self.form(query)
        query = with_streams(query, [source.name for source in template.inputs])

        def make(output: StreamGenerator) -> InstanceUnit:
            text = format_query(replace(query, name=output.name))
            given = {"request": request, "query": text}
            return InstanceUnit(
                *self._configuration.identity(SELECT_INSTANCE, [template.output], output, given),
                template=template,
                enter=partial(evaluator.add, query.bindings),
                evaluation=evaluator.explain,
                results=form.converter(output.stream.pools),
            )

        unit = self._configuration.start_query(form.schema, make)
        return _built(unit, query, form, supplies)

    def break_even_count(self, kin: Kin, flows: Mapping[str, Flow], pattern: Pattern) -> int:
        """From how many queries on that fit ``pattern`` it is likely to be cheaper to compute them
        together; ``flows`` is what is known of their streams."""
        background = explanations.closed_ontology(self._ontology, kin.form.static_named)
        static = StaticSide(background, TermValues(self._dictionary))
        return break_even_count(kin.form, pattern, kin.constants, static, flows)

    def start_alike(
        self, query: ContinuousQuery, kin: Kin, pattern: Pattern, read: Read | Sequence[Supply]
    ) -> TemplateUnit:
        """Start what the queries have in common whose constants fit ``pattern``; ``query`` is one
        of them, which reads ``read``."""
        inputs, converters = self._of(read)
        query = with_streams(query, list(inputs)) if not query.streams else query
        background = explanations.closed_ontology(self._ontology, query.static_named)
        evaluator = SimilarQueriesEvaluator(
            query, kin.form, pattern, self._dictionary, background, list(inputs), self._budget
        )
        return self._start_shared(query, inputs, converters, evaluator, _OTHERS)

    def start_member(
        self, shared: TemplateUnit, query: ContinuousQuery, kin: Kin, manner: Manner
    ) -> InstanceUnit:
        """Start the part of ``query`` in what it has in common with others."""
        evaluator = shared.evaluator
        assert isinstance(evaluator, SimilarQueriesEvaluator)
        form = self.form(query)
        text = query.source.strip() if query.streams else None
        if text is None:
            query = with_streams(query, [source.name for source in shared.inputs])

        def make(output: StreamGenerator) -> InstanceUnit:
            given = {"query": text or format_query(replace(query, name=output.name))}
            return InstanceUnit(
                *self._configuration.identity(SELECT_INSTANCE, [shared.output], output, given),
                template=shared,
                enter=partial(evaluator.add, query, kin.constants),
                evaluation=lambda: evaluator.explain_of(kin.constants, shared.flows()),
                results=form.converter(output.stream.pools),
                on_result=manner.hear,
            )

        return self._configuration.start_query(form.schema, make, Since.NOW, manner.name)

    def agreement(
        self,
        query: ContinuousQuery,
        arguments: Mapping[Variable, Term],
        streamed: Collection[str],
        selected: Collection[str],
    ) -> frozenset[str] | None:
        """The parameters on which requests of a template with such arguments have to agree to share
        a query over streams of the features ``streamed``, where each selects the objects that
        ``selected`` parameters name; None if they cannot."""
        # Any name of a stream does: only what the query says decides.
        evaluator = self._evaluator(with_streams(query, ["any"]), ["any"])
        return evaluator.agreement(arguments, selected, streamed)

    def _evaluator(self, query: ContinuousQuery, inputs: Sequence[str]) -> TemplateEvaluator:
        background = explanations.closed_ontology(self._ontology, query.static_named)
        return TemplateEvaluator(query, self._dictionary, background, inputs, budget=self._budget)

    def _start_shared(
        self,
        query: ContinuousQuery,
        inputs: Mapping[str, StreamGenerator],
        converters: Mapping[str, Sequence[SampleConverter]],
        evaluator: SharedWindows,
        told: str = "",
    ) -> TemplateUnit:
        def make(output: StreamGenerator) -> TemplateUnit:
            text = told + format_query(replace(query, name=output.name))
            sources = list(inputs.values())
            return TemplateUnit(
                *self._configuration.identity(C_SPARQL, sources, output, {"query": text}),
                evaluator=evaluator,
                converters=converters,
            )

        return self._configuration.start_query(TALLY, make)

    def _of(
        self, read: Read | Sequence[Supply]
    ) -> tuple[dict[str, StreamGenerator], Mapping[str, Sequence[SampleConverter]]]:
        if not isinstance(read, Mapping):
            return self._read(read, Since.NOW)
        converters = {generator.name: [converter] for generator, converter in read.items()}
        return {generator.name: generator for generator in read}, converters

    def _read(
        self, supplies: Sequence[Supply], since: Beginning
    ) -> tuple[dict[str, StreamGenerator], dict[str, list[SampleConverter]]]:
        """The streams that the supplies ask for, started, with the converters of what is wanted of
        each."""
        inputs: dict[str, StreamGenerator] = {}
        converters: dict[str, list[SampleConverter]] = defaultdict(list)
        wanted = [(supply, source) for supply in supplies for source in supply.sources]
        asked: dict[tuple[object, ...], set[str]] = defaultdict(set)
        for supply, source in wanted:
            asked[_element(source)].add(supply.want.feature)
        # Two patterns may want the same of one stream: its samples are still elements once.
        read: set[tuple[str, tuple[Content, ...], Unit | None]] = set()
        for supply, source in wanted:
            generator = self._obtain(source.node, since)
            inputs[generator.name] = generator
            annotation = wanted_annotation(supply, source, generator.name)
            target: Unit | None = source.port.target
            if len(asked[_element(source)]) > 1:
                # Under its own name: that it is of the wider features as well is entailed.
                annotation = own_annotation(source, generator.name)
                target = None
            element = (generator.name, annotation.contents, target)
            if element in read:
                continue
            read.add(element)
            units: dict[str, Unit] = {} if target is None else {supply.want.feature: target}
            converters[generator.name].append(
                SampleConverter(
                    annotation,
                    generator.schema,
                    self._ontology.vocabulary,
                    self._dictionary,
                    namespace=self._configuration.namespaces[generator.name],
                    units=units,
                )
            )
        return inputs, converters

    def start_over(
        self,
        query: ContinuousQuery,
        read: Read,
        since: Beginning,
        manner: Manner,
    ) -> QueryUnit:
        """Start a query over the streams that its clauses name, by their own names; ``read`` gives
        each with the converter of all that it says."""
        inputs, converters = self._of(read)
        for generator in inputs.values():
            check_retained(since, generator.stream)
        form = self.form(query)
        return self._start(query, inputs, converters, form, since, manner, query.source.strip())

    def _start(
        self,
        query: ContinuousQuery,
        inputs: Mapping[str, StreamGenerator],
        converters: Mapping[str, Sequence[SampleConverter]],
        form: ResultForm,
        since: Beginning,
        manner: Manner,
        text: str | None = None,
    ) -> QueryUnit:
        def make(output: StreamGenerator) -> QueryUnit:
            named = replace(query, name=output.name)
            background = explanations.closed_ontology(self._ontology, named.static_named)
            sources, told = list(inputs.values()), {"query": text or format_query(named)}
            return QueryUnit(
                *self._configuration.identity(C_SPARQL, sources, output, told),
                evaluator=ContinuousEvaluator(
                    named,
                    self._dictionary,
                    background,
                    list(inputs),
                    manner.options,
                    self._budget,
                ),
                converters=converters,
                results=form.converter(output.stream.pools),
                on_result=manner.hear,
            )

        return self._configuration.start_query(form.schema, make, since, manner.name)


def _element(source: SupplySource) -> tuple[object, ...]:
    """What of a node's samples an element is made of."""
    return source.node, source.port.source_field, source.roles


def _built(
    unit: AnyUnit, query: ContinuousQuery, form: ResultForm, supplies: Sequence[Supply]
) -> BuiltQuery[AnyUnit]:
    roles = [role for s in supplies for source in s.sources for role in source.roles]
    name = unit.output.name
    return BuiltQuery(
        unit,
        form.event_annotation(name, query.name, roles),
        form.rdf_annotation(name, roles),
    )
