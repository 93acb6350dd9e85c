"""Continuous queries over matched streams: the C-SPARQL units behind events ([Events14 §V.B])."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from ..continuous.evaluator import ContinuousEvaluator
from ..converters.to_samples import ResultConverter
from ..converters.to_triples import SampleConverter
from ..languages.csparql import format_query, with_streams
from ..languages.csparql.ast import ContinuousQuery
from ..languages.ssl.annotation import Content, StreamAnnotation
from ..matching.plan import Node, Supply, wanted_annotation
from ..ontology.ontology import Ontology
from ..ontology.units import Unit
from ..rdf.dictionary import TermDictionary
from ..streams.generator import StreamGenerator
from . import explain as explanations
from .configuration import Configuration
from .results import ResultForm, result_form
from .unit import QueryUnit
from .views import Since


@dataclass(frozen=True, slots=True, eq=False)
class BuiltQuery:
    """A C-SPARQL unit at work. ``annotation`` says what its stream means (None of a table),
    ``rdf`` how its samples are written as triples."""

    unit: QueryUnit
    annotation: StreamAnnotation | None
    rdf: StreamAnnotation | None


class Queries:
    """Starts queries over the streams of plan nodes, which ``obtain`` gives."""

    def __init__(
        self,
        ontology: Ontology,
        dictionary: TermDictionary,
        configuration: Configuration,
        obtain: Callable[[Node, Since], StreamGenerator],
    ) -> None:
        self._ontology = ontology
        self._dictionary = dictionary
        self._configuration = configuration
        self._obtain = obtain

    def form(self, query: ContinuousQuery) -> ResultForm:
        """What the results of a query look like."""
        return result_form(query, self._ontology.vocabulary)

    def start(self, query: ContinuousQuery, supplies: Sequence[Supply], since: Since) -> BuiltQuery:
        """Start what the supplies ask for, inputs first, then the query unit over them."""
        inputs: dict[str, StreamGenerator] = {}
        converters: dict[str, list[SampleConverter]] = defaultdict(list)
        # Two patterns may want the same of one stream: its samples are still elements once.
        read: set[tuple[str, tuple[Content, ...], Unit]] = set()
        for supply in supplies:
            for source in supply.sources:
                generator = self._obtain(source.node, since)
                inputs[generator.name] = generator
                annotation = wanted_annotation(supply, source, generator.name)
                element = (generator.name, annotation.contents, source.port.target)
                if element in read:
                    continue
                read.add(element)
                units: dict[str, Unit] = {supply.want.feature: source.port.target}
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
        form = self.form(query)
        unit = self._start(with_streams(query, list(inputs)), inputs, converters, form, since)
        roles = [role for s in supplies for source in s.sources for role in source.roles]
        name = unit.output.name
        return BuiltQuery(
            unit,
            form.event_annotation(name, query.name, roles),
            form.rdf_annotation(name, roles),
        )

    def _start(
        self,
        query: ContinuousQuery,
        inputs: dict[str, StreamGenerator],
        converters: dict[str, list[SampleConverter]],
        form: ResultForm,
        since: Since,
    ) -> QueryUnit:
        def make(output: StreamGenerator) -> tuple[ContinuousEvaluator, ResultConverter, str]:
            named = replace(query, name=output.name)
            evaluator = ContinuousEvaluator(
                named, self._dictionary, explanations.closed_ontology(self._ontology), list(inputs)
            )
            return evaluator, form.converter(output.stream.pools), format_query(named)

        return self._configuration.start_query(
            list(inputs.values()), form.schema, make, converters, since
        )
