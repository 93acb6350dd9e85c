"""Starting a registered query: its streams, its unit, the way back from its samples to triples
([Events14 §V.B, Fig. 2]).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

from ...continuous.algebra.constant_lifting import Pattern
from ...continuous.estimation.input_rates import Flow
from ...continuous.sharing.similar_queries import Unshared, form_of
from ...converters.to_triples import SampleConverter
from ...languages.csparql import with_streams
from ...languages.csparql.ast import ContinuousQuery
from ...languages.ssl.annotation import Content, StreamAnnotation
from ...matching.match import Match
from ...matching.plan import annotation_of
from ...matching.space import StreamSpace
from ...matching.want import THING
from ...ontology.ontology import Ontology
from ...rdf.dictionary import TermDictionary
from ...streams.generator import StreamGenerator
from ...templates.library import TemplateLibrary
from ...templates.needs import Needs, NeedsError
from ..configuration.configuration import Configuration
from ..model.beginning import resolve_duration
from ..model.errors import BadArguments, NoPlan
from ..model.result_schema import check_head, head_role, result_form
from ..model.result_windows import KeptWindows
from ..model.stream_statistics import flow_of
from ..model.views import Since
from ..units.query import QueryUnit
from ..units.shared_query import InstanceUnit, TemplateUnit
from .plan_execution import Plans
from .query_sharing import Alikes, Kin, shared_key
from .query_units import Manner
from .registrations import Asked
from .stream_binding import check_graphs, find_streams, mean_the_same, supplies_of
from .stream_reading import Reading, read_streams, stream_called


@dataclass(frozen=True, slots=True, eq=False)
class Started:
    """A query at work. ``matches`` say how its streams were found, ``reads`` which it names: one of
    the two is empty. ``converter`` makes the triples of its head of its samples; None of a table.
    ``kin`` says with whom it could share, None: with nobody; ``alone``, why it does not, if so.
    """

    unit: QueryUnit | InstanceUnit
    kept: KeptWindows
    matches: tuple[Match, ...]
    reads: tuple[Reading, ...]
    converter: SampleConverter | None
    kin: Kin | None
    alone: str


class Starter:
    """Starts queries under a name, and says whether they hold still.

    ``converter_of`` converts the samples of a stream to triples; None where nobody has said what
    it contains.
    """

    def __init__(
        self,
        ontology: Ontology,
        dictionary: TermDictionary,
        templates: TemplateLibrary,
        configuration: Configuration,
        plans: Plans,
        space: StreamSpace,
        converter_of: Callable[[str], SampleConverter | None],
    ) -> None:
        self._ontology = ontology
        self._dictionary = dictionary
        self._templates = templates
        self._configuration = configuration
        self._plans = plans
        self._space = space
        self._converter_of = converter_of
        self._alikes = Alikes(configuration.find_shared)

    def start(self, name: str, query: ContinuousQuery, asked: Asked) -> Started:
        """Start ``query`` with the stream ``name``; raises as `RegisteredQueries.register`, and
        then nothing has begun."""
        check_head(query, self._ontology.vocabulary)
        check_graphs(self._ontology, query)
        matches: tuple[Match, ...] = ()
        reads: tuple[Reading, ...] = ()
        if query.streams:
            query, reads = read_streams(self._configuration, self._converter_of, query)
        else:
            wanted, told = self.needs(query), f"query {name}"
            matches = find_streams(self._plans, wanted, asked.strategy, asked.since, told)
        since = (
            resolve_duration(asked.since, (each.generator.stream for each in reads))
            if reads
            else self._plans.resolve_duration(asked.since, supplies_of(matches))
        )
        converter = self._back(name, query, _contents(matches, reads))
        kept = KeptWindows()
        manner = Manner(name, asked.options, kept.keep)
        kin, pattern, alone = self._kin(query, reads, matches, asked)
        try:
            with told_as_arguments():
                unit: QueryUnit | InstanceUnit
                if kin is not None and pattern is not None:
                    unit = self._join(query, kin, pattern, reads, matches, manner)
                elif reads:
                    unit = self._plans.queries.start_over(query, _read(reads), since, manner)
                else:
                    supplies = supplies_of(matches)
                    unit = self._plans.queries.start(query, supplies, since, manner).unit
        except Exception:
            self._configuration.release_unused()
            raise
        if kin is not None and pattern is None:
            self._alikes.began_alone(name, kin)
        return Started(unit, kept, matches, reads, converter, kin, alone)

    def stop(self, name: str, started: Started) -> None:
        """Stop a query, if it is the one of this name still."""
        if self._configuration.units.get(name) is started.unit:
            self._configuration.remove_unit(started.unit)
        if started.kin is not None:
            self._alikes.ended(name, started.kin)

    def _kin(
        self,
        query: ContinuousQuery,
        reads: Sequence[Reading],
        matches: Sequence[Match],
        asked: Asked,
    ) -> tuple[Kin | None, Pattern | None, str]:
        """With whom the query could share, what it does share, and why it shares nothing."""
        try:
            if asked.since is not Since.NOW:
                raise Unshared("it begins with the past of its streams")
            streams: Hashable = tuple((each.generator, each.annotation) for each in reads)
            inputs = list(dict.fromkeys(each.name for each in reads))
            if not reads:
                # What streams are called makes no difference between queries.
                streams, inputs = self._plans.made_from(matches), ["any"]
                query = with_streams(query, inputs)
            form, constants = form_of(query, inputs, asked.options)
        except (Unshared, ValueError) as unshared:
            return None, None, str(unshared)
        kin = Kin(streams, form, constants)
        known = ((one.name, flow_of(one.generator, [one.annotation])) for one in reads)
        flows = {name: flow for name, flow in known if flow is not None}
        try:
            break_even_count = partial(self._plans.queries.break_even_count, kin, flows)
            return kin, self._alikes.pattern(kin, break_even_count), ""
        except Unshared as unshared:
            return kin, None, str(unshared)

    def _join(
        self,
        query: ContinuousQuery,
        kin: Kin,
        pattern: Pattern,
        reads: Sequence[Reading],
        matches: Sequence[Match],
        manner: Manner,
    ) -> InstanceUnit:
        """Start the part of a query in what it shares with others, and that, if it is not there."""
        queries = self._plans.queries
        read = _read(reads) if reads else supplies_of(matches)
        shared = self._configuration.share(
            shared_key(kin, pattern), lambda: queries.start_alike(query, kin, pattern, read)
        )
        assert isinstance(shared, TemplateUnit)
        return queries.start_member(shared, query, kin, manner)

    def needs(self, query: ContinuousQuery) -> Needs:
        """What a query needs that names no streams; raises `NoPlan`."""
        try:
            return self._templates.needs(query)
        except NeedsError as error:
            raise NoPlan(error.message, (), error.hint) from error

    def flows(self, query: ContinuousQuery) -> dict[str, Flow]:
        """What may be expected of the streams that a query names, as far as they are there."""
        found = {}
        for clause in query.streams:
            generator = stream_called(self._configuration, clause.iri)
            if generator is None:
                continue
            converter = self._converter_of(generator.name)
            flow = flow_of(generator, [] if converter is None else [converter.annotation])
            if flow is not None:
                found[clause.iri] = flow
        return found

    def is_sound(self, started: Started) -> bool:
        """It works, and what it reads is there still and means what it did."""
        configuration, unit = self._configuration, started.unit
        return (
            configuration.units.get(unit.output.name) is unit
            and not configuration.is_broken(unit)
            and configuration.has_current_inputs(unit)
            and mean_the_same(started.matches, self._space)
            and all(map(self._means_the_same, started.reads))
        )

    def _means_the_same(self, reading: Reading) -> bool:
        now = self._converter_of(reading.name)
        return now is not None and now.annotation == reading.annotation

    def _back(
        self, name: str, query: ContinuousQuery, read: Sequence[Content]
    ) -> SampleConverter | None:
        vocabulary = self._ontology.vocabulary
        form = result_form(query, vocabulary)
        annotation = form.rdf_annotation(name, [head_role(query, vocabulary, read)])
        if annotation is None:
            return None
        return SampleConverter(
            annotation,
            form.schema,
            vocabulary,
            self._dictionary,
            ranges=dict.fromkeys(form.iri_predicates, THING),
        )


@contextmanager
def told_as_arguments() -> Iterator[None]:
    """What the evaluator says of a query that it cannot evaluate becomes `BadArguments`."""
    try:
        yield
    except ValueError as error:
        if type(error) is not ValueError:  # an error of a language has a place of its own
            raise
        raise BadArguments(str(error)) from error


def _read(reads: Sequence[Reading]) -> dict[StreamGenerator, SampleConverter]:
    return {each.generator: each.converter for each in reads}


def _contents(matches: Sequence[Match], reads: Sequence[Reading]) -> Sequence[Content]:
    """What the streams contain that a query reads."""
    said: list[StreamAnnotation] = [each.annotation for each in reads]
    for match in matches:
        if match.supply is not None:
            said += [annotation_of(source.node) for source in match.supply.sources]
    return [content for annotation in said for content in annotation.contents]
