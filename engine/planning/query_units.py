"""Starts the units of continuous queries: C-SPARQL units, shared templates and their instances
([Events14 §V.B])."""

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
from ...converters.to_triples import SampleConverter, ToTriples
from ...languages.csparql import format_query, with_streams
from ...languages.csparql.ast import ContinuousQuery
from ...languages.ssl.annotation import Content, StreamAnnotation
from ...matching.plan import (
    Node,
    SelectObjects,
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
from ..units.selection import SelectionUnit
from ..units.sharing.instances import TALLY
from ..units.sharing.shared_query import QueryInstance, TemplateUnit
from .query_sharing import FormInstance
from .static_side import closed_ontology


@dataclass(frozen=True, slots=True, eq=False)
class QuerySettings:
    """The settings of a query beside its text: the name of its stream (None: a reserved one), the
    options that the text leaves open, and a callback for the result of each window."""

    name: str | None = None
    options: Options = field(default_factory=Options)
    on_result: Callable[[WindowResult], None] | None = None


Read: TypeAlias = Mapping[StreamGenerator, ToTriples]
"""Streams that a query names, each with the converter of its whole annotation."""
_SHARED_NOTE = "# and queries that differ from this one in constants\n"

EVENT_SETTINGS = QuerySettings()
"""The settings of the query of an event."""


@dataclass(frozen=True, slots=True, eq=False)
class StartedUnit(Generic[AnyUnit]):
    """A running C-SPARQL unit. ``annotation`` is that of its stream (None for a table); ``rdf`` is
    the annotation by which its samples convert to triples."""

    unit: AnyUnit
    annotation: StreamAnnotation | None
    rdf: StreamAnnotation | None


class Queries:
    """Starts queries over the streams of plan nodes, which ``obtain`` returns."""

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
        """Return the form of a query's results."""
        return result_form(query, self._ontology.vocabulary)

    def start(
        self,
        query: ContinuousQuery,
        supplies: Sequence[Supply],
        since: Beginning,
        settings: QuerySettings = EVENT_SETTINGS,
    ) -> StartedUnit[QueryUnit]:
        """Start the units of the supplies, then the query unit over them."""
        inputs, converters = self._start_inputs(supplies, since)
        form = self.form(query)
        query = with_streams(query, list(inputs))
        unit = self._start(query, inputs, converters, form, since, settings)
        return _started(unit, query, form, supplies)

    def selection(self, node: SelectObjects) -> SelectionUnit | None:
        """Return the running unit of ``node``, if there is one."""
        unit = self._configuration.find_shared((node, Since.NOW))
        assert unit is None or isinstance(unit, SelectionUnit)
        return unit

    def start_template(
        self,
        query: ContinuousQuery,
        supplies: Sequence[Supply],
        selections: Sequence[SelectObjects] = (),
    ) -> TemplateUnit:
        """Start the query of a template, its parameters free, over the streams of the supplies,
        which rest on the ``selections``."""
        names = [self._obtain(node, Since.NOW).name for node in selections]
        units = [self._configuration.units[name] for name in names]
        selecting = [unit for unit in units if isinstance(unit, SelectionUnit)]
        inputs, converters = self._start_inputs(supplies, Since.NOW)
        query = with_streams(query, list(inputs))
        evaluator = self._evaluator(query, list(inputs))
        return self._start_shared(query, inputs, converters, evaluator, selections=selecting)

    def start_instance(
        self,
        template: TemplateUnit,
        query: ContinuousQuery,
        supplies: Sequence[Supply],
        request: str,
        objects: Sequence[str] = (),
    ) -> StartedUnit[QueryInstance]:
        """Start ``query`` as an instance of the template, with the arguments of ``request`` (its
        text). ``supplies`` are those that it would have alone; its annotation needs their roles.
        ``objects`` (IRIs) are those of the template's selections."""
        evaluator = template.evaluator
        assert isinstance(evaluator, TemplateEvaluator)
        form = self.form(query)
        query = with_streams(query, [source.name for source in template.inputs])

        def make(output: StreamGenerator) -> QueryInstance:
            text = format_query(replace(query, name=output.name))
            parameters = {"request": request, "query": text}
            return QueryInstance(
                *self._configuration.identity(
                    SELECT_INSTANCE, [template.output], output, parameters
                ),
                template=template,
                enter=partial(evaluator.add, query.bindings),
                evaluation=evaluator.explain,
                form=form,
                objects=objects,
            )

        unit = self._configuration.start_query(form.schema, make)
        return _started(unit, query, form, supplies)

    def break_even(
        self, instance: FormInstance, flows: Mapping[str, Flow], pattern: Pattern
    ) -> int:
        """Estimate the number of queries of ``pattern`` from which on sharing is cheaper.
        ``flows``: the rates of their streams."""
        background = closed_ontology(self._ontology, instance.form.static_named)
        static = StaticSide(background, TermValues(self._dictionary))
        return break_even_count(instance.form, pattern, instance.constants, static, flows)

    def start_alike(
        self,
        query: ContinuousQuery,
        instance: FormInstance,
        pattern: Pattern,
        read: Read | Sequence[Supply],
    ) -> TemplateUnit:
        """Start the shared computation of the queries of ``pattern``. ``query`` is one of them,
        with the streams ``read``."""
        inputs, converters = self._inputs_of(read)
        query = with_streams(query, list(inputs)) if not query.streams else query
        background = closed_ontology(self._ontology, query.static_named)
        evaluator = SimilarQueriesEvaluator(
            query, instance.form, pattern, self._dictionary, background, list(inputs), self._budget
        )
        return self._start_shared(query, inputs, converters, evaluator, _SHARED_NOTE)

    def start_member(
        self,
        shared: TemplateUnit,
        query: ContinuousQuery,
        instance: FormInstance,
        settings: QuerySettings,
    ) -> QueryInstance:
        """Start ``query`` as a member of a shared computation."""
        evaluator = shared.evaluator
        assert isinstance(evaluator, SimilarQueriesEvaluator)
        form = self.form(query)
        text = query.source.strip() if query.streams else None
        if text is None:
            query = with_streams(query, [source.name for source in shared.inputs])

        def make(output: StreamGenerator) -> QueryInstance:
            parameters = {"query": text or format_query(replace(query, name=output.name))}
            return QueryInstance(
                *self._configuration.identity(SELECT_INSTANCE, [shared.output], output, parameters),
                template=shared,
                enter=partial(evaluator.add, query, instance.constants),
                evaluation=lambda: evaluator.explain_of(instance.constants, shared.flows()),
                form=form,
                on_result=settings.on_result,
            )

        return self._configuration.start_query(form.schema, make, Since.NOW, settings.name)

    def agreement(
        self,
        query: ContinuousQuery,
        arguments: Mapping[Variable, Term],
        streamed: Collection[str],
        selected: Collection[str],
    ) -> frozenset[str] | None:
        """Return the parameters on which requests of a template have to agree to share a query;
        None if they cannot share. ``streamed``: the features of the streams; ``selected``: the
        parameters whose objects each request selects."""
        # The names of the streams do not matter here, but the evaluator needs one.
        evaluator = self._evaluator(with_streams(query, ["any"]), ["any"])
        return evaluator.agreement(arguments, selected, streamed)

    def _evaluator(self, query: ContinuousQuery, inputs: Sequence[str]) -> TemplateEvaluator:
        background = closed_ontology(self._ontology, query.static_named)
        return TemplateEvaluator(query, self._dictionary, background, inputs, budget=self._budget)

    def _start_shared(
        self,
        query: ContinuousQuery,
        inputs: Mapping[str, StreamGenerator],
        converters: Mapping[str, Sequence[ToTriples]],
        evaluator: SharedWindows,
        parameters: str = "",
        selections: Sequence[SelectionUnit] = (),
    ) -> TemplateUnit:
        def make(output: StreamGenerator) -> TemplateUnit:
            text = parameters + format_query(replace(query, name=output.name))
            sources = list(inputs.values())
            return TemplateUnit(
                *self._configuration.identity(C_SPARQL, sources, output, {"query": text}),
                evaluator=evaluator,
                converters=converters,
                selections=selections,
            )

        return self._configuration.start_query(TALLY, make)

    def _inputs_of(
        self, read: Read | Sequence[Supply]
    ) -> tuple[dict[str, StreamGenerator], Mapping[str, Sequence[ToTriples]]]:
        if not isinstance(read, Mapping):
            return self._start_inputs(read, Since.NOW)
        converters = {generator.name: [converter] for generator, converter in read.items()}
        return {generator.name: generator for generator in read}, converters

    def _start_inputs(
        self, supplies: Sequence[Supply], since: Beginning
    ) -> tuple[dict[str, StreamGenerator], dict[str, list[ToTriples]]]:
        """Start the streams of the supplies; return them with the converters of the wanted
        features."""
        inputs: dict[str, StreamGenerator] = {}
        converters: dict[str, list[ToTriples]] = defaultdict(list)
        wanted = [(supply, source) for supply in supplies for source in supply.sources]
        features_of: dict[tuple[object, ...], set[str]] = defaultdict(set)
        for supply, source in wanted:
            features_of[_element(source)].add(supply.want.feature)
        # Two patterns may want one feature of one stream: convert its samples once.
        read: set[tuple[str, tuple[Content, ...], Unit | None]] = set()
        for supply, source in wanted:
            generator = self._obtain(source.node, since)
            inputs[generator.name] = generator
            annotation = wanted_annotation(supply, source, generator.name)
            target: Unit | None = source.port.target
            if len(features_of[_element(source)]) > 1:
                # Wanted as several features: convert it as its own one, which entails the wider.
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
        settings: QuerySettings,
    ) -> QueryUnit:
        """Start a query over the streams ``read`` that its clauses name."""
        inputs, converters = self._inputs_of(read)
        for generator in inputs.values():
            check_retained(since, generator.stream)
        form = self.form(query)
        return self._start(query, inputs, converters, form, since, settings, query.source.strip())

    def _start(
        self,
        query: ContinuousQuery,
        inputs: Mapping[str, StreamGenerator],
        converters: Mapping[str, Sequence[ToTriples]],
        form: ResultForm,
        since: Beginning,
        settings: QuerySettings,
        text: str | None = None,
    ) -> QueryUnit:
        def make(output: StreamGenerator) -> QueryUnit:
            named = replace(query, name=output.name)
            background = closed_ontology(self._ontology, named.static_named)
            sources, parameters = list(inputs.values()), {"query": text or format_query(named)}
            return QueryUnit(
                *self._configuration.identity(C_SPARQL, sources, output, parameters),
                evaluator=ContinuousEvaluator(
                    named,
                    self._dictionary,
                    background,
                    list(inputs),
                    settings.options,
                    self._budget,
                ),
                converters=converters,
                results=form.converter(output.stream.pools),
                on_result=settings.on_result,
            )

        return self._configuration.start_query(form.schema, make, since, settings.name)


def _element(source: SupplySource) -> tuple[object, ...]:
    """The part of a node's samples that makes one element of a window."""
    return source.node, source.port.source_field, source.roles


def _started(
    unit: AnyUnit, query: ContinuousQuery, form: ResultForm, supplies: Sequence[Supply]
) -> StartedUnit[AnyUnit]:
    roles = [role for s in supplies for source in s.sources for role in source.roles]
    name = unit.output.name
    return StartedUnit(
        unit,
        form.event_annotation(name, query.name, roles),
        form.rdf_annotation(name, roles),
    )
