"""Starts patterns: what their events need is matched with streams, as for a query (SPEC §8)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NoReturn

from ...converters.results_to_samples import ID
from ...languages.mtl.checked import Kind
from ...languages.ssl.annotation import Content, Role, StreamAnnotation
from ...languages.ssl.annotation_text import with_ssl_source
from ...matching.plan import Node, Supply
from ...ontology.ontology import Ontology
from ...ontology.vocabulary import Vocabulary
from ...rdf.dictionary import TermDictionary
from ...reasoning.patterns.plans.by_object import PatternByObject
from ...reasoning.patterns.plans.plan import PlanError
from ...reasoning.patterns.plans.query import END, START, Keys, Kinds, Part, PatternQuery, Source
from ...reasoning.patterns.recognition.recognition import Recognition
from ...streams.generator import StreamGenerator
from ...streams.sample import FieldType
from ...templates.event_patterns import BoundPattern
from ...templates.needs import NeedsError
from ..configuration.configuration import PATTERN, SELECT_INSTANCE, Configuration
from ..model.beginning import Beginning
from ..model.errors import BadArguments
from ..model.result_schema import ResultForm
from ..model.status_changes import ChangeKind
from ..model.views import Since
from ..units.merge import MergeInput
from ..units.reasoning.match_samples import match_schema
from ..units.reasoning.pattern import PatternUnit
from ..units.reasoning.row_readers import SourceInput, kind_of
from ..units.sharing.instances import TALLY
from ..units.sharing.shared_pattern import PatternInstance, SharedPatternUnit
from .static_side import check_graphs, closed_ontology
from .supply_inputs import merge_inputs


class PatternStarter:
    """Starts the units of patterns. ``obtain`` returns the stream of a plan node."""

    def __init__(
        self,
        ontology: Ontology,
        dictionary: TermDictionary,
        configuration: Configuration,
        obtain: Callable[[Node, Beginning], StreamGenerator],
    ) -> None:
        self._ontology = ontology
        self._dictionary = dictionary
        self._configuration = configuration
        self._obtain = obtain
        self._report_limit = partial(configuration.report_unit, ChangeKind.LIMIT_REACHED)

    def start(
        self,
        pattern: BoundPattern,
        supplies: Sequence[Supply],
        since: Beginning,
        *,
        name: str | None = None,
        request: str | None = None,
    ) -> PatternUnit:
        """Start the units of the ``supplies``, one for each source, and the pattern over them. Its
        stream gets ``name``, or the next reserved one. ``request``: the text of the request that
        has the arguments of a template. Raises `BadArguments`, `LanguageError`."""
        read = [
            (pattern.sources[supply.want], each)
            for supply in supplies
            for each in self._inputs(supply, since)
        ]
        query = compiled(pattern, _kinds(read))
        check_graphs(self._ontology, *query.graphs)
        has_intervals = any(plan.has_intervals for plan in query.plans)
        # The kinds of fields decide which columns the rows have.
        known = {source.kind: source for source in query.sources}
        inputs = [
            SourceInput(known[source.kind], input, has_intervals and _lasts(input))
            for source, input in read
        ]
        streams = dict.fromkeys(input.source for _, input in read)

        def make(output: StreamGenerator) -> PatternUnit:
            parameters = {"query": pattern.source}
            if request is not None:
                parameters = {"request": request, **parameters}
            try:
                return PatternUnit(
                    *self._configuration.identity(PATTERN, list(streams), output, parameters),
                    query=query,
                    inputs_of_sources=inputs,
                    dictionary=self._dictionary,
                    lateness=self._configuration.lateness,
                    newest=self._configuration.newest_sample,
                    background=closed_ontology(self._ontology, query.graphs[1]),
                    report_limit=self._report_limit,
                )
            except PlanError as error:
                raise BadArguments(error.message, error.hint) from error

        return self._configuration.start_query(match_schema(query), make, since, name)

    def start_shared(
        self, pattern: PatternByObject, free: BoundPattern, supplies: Sequence[Supply]
    ) -> SharedPatternUnit:
        """Start the evaluation of a pattern for each object that an instance asks for, over the
        streams of all objects. ``free``: the pattern of all objects."""
        read = [
            (free.sources[supply.want], each)
            for supply in supplies
            for each in self._inputs(supply, Since.NOW)
        ]
        has_intervals = any(plan.has_intervals for plan in pattern.query.plans)
        known = {source.kind: source for source in pattern.query.sources}
        inputs = [
            SourceInput(known[source.kind], input, has_intervals and _lasts(input))
            for source, input in read
        ]
        objects = {
            input.source: input.objects[argument_of(source, pattern.column)]
            for source, input in read
        }

        def make(output: StreamGenerator) -> SharedPatternUnit:
            parameters = {"query": free.source}
            return SharedPatternUnit(
                *self._configuration.identity(PATTERN, list(objects), output, parameters),
                pattern=pattern,
                inputs_of_sources=inputs,
                objects=objects,
                dictionary=self._dictionary,
                lateness=self._configuration.lateness,
                newest=self._configuration.newest_sample,
                report_limit=self._report_limit,
            )

        return self._configuration.start_query(TALLY, make)

    def start_instance(
        self, shared: SharedPatternUnit, own: BoundPattern, object: str, request: str
    ) -> PatternInstance:
        """Start an instance of a shared pattern for an ``object`` (an IRI), with the arguments of
        ``request`` (its text). ``own``: the pattern of this object."""
        query = own.query({})

        def make(output: StreamGenerator) -> PatternInstance:
            parameters = {"request": request, "query": own.source}
            return PatternInstance(
                *self._configuration.identity(SELECT_INSTANCE, [shared.output], output, parameters),
                template=shared,
                object=object,
                query=query,
            )

        return self._configuration.start_query(match_schema(query), make)

    def _inputs(self, supply: Supply, since: Beginning) -> list[MergeInput]:
        streams = [self._obtain(source.node, since) for source in supply.sources]
        return merge_inputs(supply, streams, self._configuration, lambda: self._ontology.vocabulary)


def argument_of(source: Source, column: str) -> int:
    """Return which object of a source is in a column."""
    return next(each.argument for each in source.columns if each.column == column)


def compiled(pattern: BoundPattern, kinds: Kinds) -> PatternQuery:
    """Compile a pattern. Raises `BadArguments` and `LanguageError`."""
    try:
        return pattern.query(kinds)
    except (NeedsError, PlanError) as error:
        raise BadArguments(error.message, error.hint) from error


def explain_pattern(pattern: BoundPattern) -> str:
    """Describe the evaluation of a pattern before it starts. Raises `BadArguments` and
    `LanguageError`."""
    query = compiled(pattern, {})
    try:
        return Recognition(query, 1, Keys(), static=_unanswered).explain()
    except PlanError as error:
        raise BadArguments(error.message, error.hint) from error


def _unanswered(*_: object) -> NoReturn:
    raise AssertionError("a pattern that is only explained reads no static triples")


def match_annotation(stream: str, event: str, query: PatternQuery) -> StreamAnnotation | None:
    """Return the annotation of a stream of matches that are the ``event`` (an IRI) of the objects
    in them, and whose value is the time of their start; None without objects."""
    roles = tuple(
        Role(each.argument.object, each.argument.sort, each.name)
        if each.argument.object is not None
        else Role(each.argument.sort, None, each.name)
        for each in query.results
        if each.argument is not None
    )
    if not roles:
        return None
    return with_ssl_source(StreamAnnotation(stream, (Content(event, START, (), roles),), ""))


def head_form(query: PatternQuery, vocabulary: Vocabulary) -> tuple[ResultForm, Sequence[Role]]:
    """Return the form of the matches, and the role of the subject of CONSTRUCT; another head has no
    predicates."""
    triples = {each.predicate: each.kind for each in query.results if each.predicate is not None}
    infos = {predicate: vocabulary.feature(predicate) for predicate in triples}
    units = {iri: info.unit for iri, info in infos.items() if info is not None and info.unit}
    objects = frozenset(iri for iri, kind in triples.items() if kind is Kind.OBJECT)
    form = ResultForm(match_schema(query), tuple(triples), units, objects)
    sorts = (each.argument.sort for each in query.results[:1] if each.argument is not None)
    return form, [Role(sort, None, ID) for sort in sorts if sort is not None]


def _kinds(read: Sequence[tuple[Source, MergeInput]]) -> Kinds:
    """The kinds of the fields that the sources read. Raises `BadArguments`."""
    found: dict[tuple[str, str], Kind] = {}
    for source, input in read:
        schema = input.source.schema
        for column in source.columns:
            if column.part is not Part.FIELD:
                continue
            field = schema.get(column.field)
            if field is None:
                raise BadArguments(
                    f"stream {input.source.name}, which gives {source.kind}, has no field "
                    f"{column.field!r}",
                    f"it has {', '.join(each.name for each in schema.fields)}; `FROM NAME` reads "
                    "one stream only",
                )
            kind = kind_of(field.type)
            if found.setdefault((source.kind, column.field), kind) is not kind:
                raise BadArguments(
                    f"the streams that give {source.kind} have fields {column.field!r} of "
                    f"different types: {found[source.kind, column.field]} and {kind}",
                    "declare them with one type",
                )
    return found


def _lasts(input: MergeInput) -> bool:
    """Whether the samples of a stream have an interval, as the results of patterns have."""
    fields = [input.source.schema.get(name) for name in (START, END)]
    return all(field is not None and field.type is FieldType.STRING for field in fields)
