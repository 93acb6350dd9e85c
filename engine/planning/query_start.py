"""Starts a registered query: finds its streams, starts its unit, and makes the converter of its
samples to triples ([Events14 §V.B, Fig. 2]).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

from ...continuous.algebra.constant_lifting import Pattern
from ...continuous.estimation.input_rates import Flow
from ...continuous.sharing.similar_queries import Unshared, form_of
from ...converters.to_triples import SampleConverter, ToTriples
from ...languages.csparql import with_streams
from ...languages.csparql.ast import ContinuousQuery
from ...languages.ssl.annotation import Content, Role, StreamAnnotation
from ...matching.match import Match
from ...matching.plan import annotation_of
from ...matching.space import StreamSpace
from ...matching.want import THING
from ...ontology.ontology import Ontology
from ...rdf.dictionary import TermDictionary
from ...streams.generator import StreamGenerator
from ...templates.library import TemplateLibrary
from ...templates.needs import Needs, NeedsError
from ...templates.reasoning import Reasoned
from ..configuration.configuration import Configuration
from ..model.beginning import resolve_duration
from ..model.errors import BadArguments, NoPlan
from ..model.result_schema import ResultForm, check_head, head_role, result_form
from ..model.result_windows import KeptWindows
from ..model.stream_statistics import flow_of
from ..model.views import Since
from ..units.query import QueryUnit
from ..units.reasoning.pattern import PatternUnit
from ..units.sharing.shared_query import QueryInstance, TemplateUnit
from .pattern_start import head_form
from .plan_execution import Plans
from .query_sharing import FormInstance, QuerySharing, shared_key
from .query_units import QuerySettings
from .reasoning_start import ReasoningUnit, bound_of
from .registrations import AnyQuery, Submission
from .static_side import check_graphs
from .stream_binding import find_streams, mean_the_same, supplies_of
from .stream_reading import ReadStream, find_stream, read_streams

RegisteredUnit: TypeAlias = QueryUnit | QueryInstance | ReasoningUnit


@dataclass(frozen=True, slots=True, eq=False)
class StartedQuery:
    """A running query, monitor or pattern. ``matches`` found its streams, or ``reads`` are the
    streams that it names; the other is empty. ``converter`` converts its samples to the triples of
    its head; None for a table. ``instance`` identifies queries that could share with it; None: it
    cannot. ``unshared``: why it shares no computation; empty if it does.
    """

    unit: RegisteredUnit
    kept: KeptWindows
    matches: tuple[Match, ...]
    reads: tuple[ReadStream, ...]
    converter: ToTriples | None
    instance: FormInstance | None
    unshared: str


class QueryStarter:
    """Starts queries under a name, and checks whether running ones are still valid.

    ``converter_of`` returns the converter of a stream's samples to triples; None for a stream
    without an annotation.
    """

    def __init__(
        self,
        ontology: Ontology,
        dictionary: TermDictionary,
        templates: TemplateLibrary,
        configuration: Configuration,
        plans: Plans,
        space: StreamSpace,
        converter_of: Callable[[str], ToTriples | None],
    ) -> None:
        self._ontology = ontology
        self._dictionary = dictionary
        self._templates = templates
        self._configuration = configuration
        self._plans = plans
        self._space = space
        self._converter_of = converter_of
        self._sharing = QuerySharing(configuration.find_shared)

    def start(self, name: str, query: AnyQuery, submission: Submission) -> StartedQuery:
        """Start ``query`` with the output stream ``name``. Raises the errors of
        `RegisteredQueries.register`, and starts nothing then."""
        if not isinstance(query, ContinuousQuery):
            return self._start_reasoning(name, query, submission)
        check_head(query, self._ontology.vocabulary)
        check_graphs(self._ontology, query.static, query.static_named)
        matches: tuple[Match, ...] = ()
        reads: tuple[ReadStream, ...] = ()
        if query.streams:
            query, reads = read_streams(self._configuration, self._converter_of, query)
        else:
            wanted, description = self.needs(query), f"query {name}"
            matches = find_streams(
                self._plans, wanted, submission.strategy, submission.since, description
            )
        since = (
            resolve_duration(submission.since, (each.generator.stream for each in reads))
            if reads
            else self._plans.resolve_duration(submission.since, supplies_of(matches))
        )
        vocabulary = self._ontology.vocabulary
        role = head_role(query, vocabulary, _contents(matches, reads))
        converter = self._output_converter(name, result_form(query, vocabulary), [role])
        kept = KeptWindows()
        settings = QuerySettings(name, submission.options, kept.keep)
        instance, pattern, unshared = self._find_sharing(query, reads, matches, submission)
        try:
            with bad_arguments_for_unsupported():
                unit: QueryUnit | QueryInstance
                if instance is not None and pattern is not None:
                    unit = self._join(query, instance, pattern, reads, matches, settings)
                elif reads:
                    unit = self._plans.queries.start_over(
                        query, _converters_of(reads), since, settings
                    )
                else:
                    supplies = supplies_of(matches)
                    unit = self._plans.queries.start(query, supplies, since, settings).unit
        except Exception:
            # Units of its plan may have started before the error.
            self._configuration.release_unused()
            raise
        if instance is not None and pattern is None:
            self._sharing.add_alone(name, instance)
        return StartedQuery(unit, kept, matches, reads, converter, instance, unshared)

    def _start_reasoning(
        self, name: str, reasoned: Reasoned, submission: Submission
    ) -> StartedQuery:
        bound = bound_of(reasoned, submission.source, self._ontology)
        matches = find_streams(
            self._plans, bound.needs, submission.strategy, submission.since, name
        )
        supplies = supplies_of(matches)
        since = self._plans.resolve_duration(submission.since, supplies)
        try:
            unit = self._plans.reasoning.start(bound, supplies, since, name=name)
        except Exception:
            # Units of its plan may have started before the error.
            self._configuration.release_unused()
            raise
        converter = None
        if isinstance(unit, PatternUnit):
            form, roles = head_form(unit.query, self._ontology.vocabulary)
            converter = self._output_converter(name, form, roles)
        return StartedQuery(unit, KeptWindows(), matches, (), converter, None, "")

    def stop(self, name: str, started: StartedQuery) -> None:
        """Stop a query, unless another one has its name now."""
        if self._configuration.units.get(name) is started.unit:
            self._configuration.remove_unit(started.unit)
        if started.instance is not None:
            self._sharing.remove(name, started.instance)

    def _find_sharing(
        self,
        query: ContinuousQuery,
        reads: Sequence[ReadStream],
        matches: Sequence[Match],
        submission: Submission,
    ) -> tuple[FormInstance | None, Pattern | None, str]:
        """Return the query as an instance of its form, the pattern of the computation that it
        shares, and the reason if it shares none."""
        try:
            if submission.since is not Since.NOW:
                raise Unshared("it begins with the history of its streams")
            streams: Hashable = tuple((each.generator, each.annotation) for each in reads)
            inputs = list(dict.fromkeys(each.name for each in reads))
            if not reads:
                # Names of matched streams must not make two queries differ.
                streams, inputs = self._plans.expand_supplies(matches), ["any"]
                query = with_streams(query, inputs)
            form, constants = form_of(query, inputs, submission.options)
        except (Unshared, ValueError) as reason:
            return None, None, str(reason)
        instance = FormInstance(streams, form, constants)
        rates = ((one.name, flow_of(one.generator, [one.annotation])) for one in reads)
        flows = {name: flow for name, flow in rates if flow is not None}
        try:
            break_even = partial(self._plans.queries.break_even, instance, flows)
            return instance, self._sharing.pattern(instance, break_even), ""
        except Unshared as reason:
            # The query runs alone and counts: sharing begins when enough queries of its form run.
            return instance, None, str(reason)

    def _join(
        self,
        query: ContinuousQuery,
        instance: FormInstance,
        pattern: Pattern,
        reads: Sequence[ReadStream],
        matches: Sequence[Match],
        settings: QuerySettings,
    ) -> QueryInstance:
        """Start a query as a member of a shared computation, and that computation if it does not
        run yet."""
        queries = self._plans.queries
        read = _converters_of(reads) if reads else supplies_of(matches)
        shared = self._configuration.share(
            shared_key(instance, pattern),
            lambda: queries.start_alike(query, instance, pattern, read),
        )
        assert isinstance(shared, TemplateUnit)
        return queries.start_member(shared, query, instance, settings)

    def needs(self, query: ContinuousQuery) -> Needs:
        """Return the features that a query without streams needs. Raises `NoPlan`."""
        try:
            return self._templates.needs(query)
        except NeedsError as error:
            raise NoPlan(error.message, (), error.hint) from error

    def flows(self, query: ContinuousQuery) -> dict[str, Flow]:
        """Return the expected rates of the streams that a query names and that exist."""
        flows = {}
        for clause in query.streams:
            generator = find_stream(self._configuration, clause.iri)
            if generator is None:
                continue
            converter = self._converter_of(generator.name)
            flow = flow_of(generator, [] if converter is None else [converter.annotation])
            if flow is not None:
                flows[clause.iri] = flow
        return flows

    def is_valid(self, started: StartedQuery) -> bool:
        """Whether the query works, and its streams still exist with the meaning that they had."""
        configuration, unit = self._configuration, started.unit
        return (
            configuration.units.get(unit.output.name) is unit
            and not configuration.is_broken(unit)
            and configuration.has_current_inputs(unit)
            and mean_the_same(started.matches, self._space)
            and all(map(self._means_the_same, started.reads))
        )

    def _means_the_same(self, read: ReadStream) -> bool:
        now = self._converter_of(read.name)
        return now is not None and now.annotation == read.annotation

    def _output_converter(
        self, name: str, form: ResultForm, roles: Sequence[Role]
    ) -> SampleConverter | None:
        annotation = form.rdf_annotation(name, roles)
        if annotation is None:
            return None
        return SampleConverter(
            annotation,
            form.schema,
            self._ontology.vocabulary,
            self._dictionary,
            ranges=dict.fromkeys(form.iri_predicates, THING),
        )


@contextmanager
def bad_arguments_for_unsupported() -> Iterator[None]:
    """Raise `BadArguments` for a ``ValueError`` of the evaluator about an unsupported query."""
    try:
        yield
    except ValueError as error:
        if type(error) is not ValueError:  # a subclass such as `LanguageError` has its own place
            raise
        raise BadArguments(str(error)) from error


def _converters_of(reads: Sequence[ReadStream]) -> dict[StreamGenerator, ToTriples]:
    return {each.generator: each.converter for each in reads}


def _contents(matches: Sequence[Match], reads: Sequence[ReadStream]) -> Sequence[Content]:
    """Return the contents of the streams that a query reads."""
    annotations: list[StreamAnnotation] = [each.annotation for each in reads]
    for match in matches:
        if match.supply is not None:
            annotations += [annotation_of(source.node) for source in match.supply.sources]
    return [content for annotation in annotations for content in annotation.contents]
