"""Continuous queries over matched streams: the C-SPARQL units behind events ([Events14 §V.B])."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from ..continuous.evaluator import ContinuousEvaluator
from ..continuous.options import Options
from ..continuous.results import WindowResult
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
class Manner:
    """How a query runs beside what it says: the name of its stream (None: one of the system's),
    how it is read where the text leaves that open, who hears of each window's result."""

    name: str | None = None
    options: Options = field(default_factory=Options)
    hear: Callable[[WindowResult], None] | None = None


EVENT = Manner()
"""How the query of an event runs."""


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

    def start(
        self,
        query: ContinuousQuery,
        supplies: Sequence[Supply],
        since: Since,
        manner: Manner = EVENT,
    ) -> BuiltQuery:
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
        query = with_streams(query, list(inputs))
        unit = self._start(query, inputs, converters, form, since, manner)
        roles = [role for s in supplies for source in s.sources for role in source.roles]
        name = unit.output.name
        return BuiltQuery(
            unit,
            form.event_annotation(name, query.name, roles),
            form.rdf_annotation(name, roles),
        )

    def start_over(
        self,
        query: ContinuousQuery,
        read: Mapping[StreamGenerator, SampleConverter],
        since: Since,
        manner: Manner,
    ) -> QueryUnit:
        """Start a query over the streams that its clauses name, by their own names; ``read`` gives
        each with the converter of all that it says."""
        inputs = {generator.name: generator for generator in read}
        converters = {generator.name: [converter] for generator, converter in read.items()}
        form = self.form(query)
        return self._start(query, inputs, converters, form, since, manner, query.source.strip())

    def _start(
        self,
        query: ContinuousQuery,
        inputs: Mapping[str, StreamGenerator],
        converters: Mapping[str, Sequence[SampleConverter]],
        form: ResultForm,
        since: Since,
        manner: Manner,
        text: str | None = None,
    ) -> QueryUnit:
        def make(output: StreamGenerator) -> tuple[ContinuousEvaluator, ResultConverter, str]:
            named = replace(query, name=output.name)
            background = explanations.closed_ontology(self._ontology, named.static_named)
            evaluator = ContinuousEvaluator(
                named, self._dictionary, background, list(inputs), manner.options
            )
            return evaluator, form.converter(output.stream.pools), text or format_query(named)

        return self._configuration.start_query(
            list(inputs.values()), form.schema, make, converters, since, manner.name, manner.hear
        )
