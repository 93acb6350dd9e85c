"""An adaptive subscription from one plan to another ([Introspection15 §4.4])."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ...converters.values import field_type
from ...matching.plan import Node, Supply
from ...ontology.ontology import Ontology
from ...rdf.dictionary import TermDictionary
from ...streams.generator import StreamGenerator
from ...streams.past_queries import Forgotten
from ...streams.sample import Field, FieldType, Schema
from ...streams.string_pool import StringPool
from ..configuration.configuration import MERGE, Configuration
from ..model.beginning import Beginning
from ..model.errors import DyknowError
from ..model.views import Since
from ..planning.plan_execution import Plans
from ..units.merge import MergeUnit, object_fields
from .adaptive_subscription import (
    AdaptiveSubscription,
    Rematch,
    Wish,
    merge_inputs,
    value_field,
)


class Switching:
    """Carries out the plans of subscriptions. ``clock`` gives the time (ns)."""

    def __init__(
        self,
        ontology: Ontology,
        dictionary: TermDictionary,
        configuration: Configuration,
        plans: Plans,
        clock: Callable[[], int],
    ) -> None:
        self._ontology = ontology
        self._dictionary = dictionary
        self._configuration = configuration
        self._plans = plans
        self._clock = clock

    def make(self, wish: Wish) -> MergeUnit:
        """The unit that merges what a subscription reads; it reads nothing yet."""
        want = wish.want
        info = self._ontology.vocabulary.feature(want.feature)
        objects = object_fields(1 + len(want.others))
        value = value_field(want)
        type = field_type(None if info is None else info.range)
        fields = (*(Field(n, FieldType.STRING) for n in objects), Field(value, type))
        pools = {each.name: StringPool() for each in fields if each.type is FieldType.STRING}
        name = self._configuration.reserved_name()
        output = self._configuration.add_stream(name, Schema(fields), pools=pools)
        parameters = {"feature": str(want), "strategy": wish.strategy}
        return MergeUnit(
            *self._configuration.identity(MERGE, (), output, parameters),
            dictionary=self._dictionary,
            value=value,
            clock=self._clock,
        )

    def streams_of(
        self, found: AdaptiveSubscription, supply: Supply | None, since: Beginning
    ) -> tuple[StreamGenerator, ...]:
        """The streams of the sources of a plan that begins ``since``, found or built. Raises
        `DyknowError` and `Forgotten`, and then nothing is built."""
        read = self._working_streams(found)
        sources = () if supply is None else supply.sources
        try:
            return tuple(
                read.get(source.node) or self._plans.obtain(source.node, since)
                for source in sources
            )
        except (DyknowError, Forgotten):
            self._configuration.release_unused()
            raise

    def _working_streams(self, found: AdaptiveSubscription) -> dict[Node, StreamGenerator]:
        """What is read already goes on, as it began."""
        if found.supply is None:
            return {}
        configuration = self._configuration
        streams: dict[Node, StreamGenerator] = {}
        for source, stream in zip(found.supply.sources, found.streams, strict=True):
            maker = configuration.units.get(stream.name)
            if configuration.streams.get(stream.name) is stream and (
                maker is None
                or (configuration.reads_what_is_there(maker) and not configuration.is_broken(maker))
            ):
                streams[source.node] = stream
        return streams

    def switch(
        self,
        found: AdaptiveSubscription,
        supply: Supply | None,
        streams: Sequence[StreamGenerator],
        why: str,
    ) -> tuple[StreamGenerator, ...]:
        """Read ``streams`` from now on, which are those of ``supply``. Returns what is new."""
        unit = found.unit
        before, names = unit.inputs, found.leaves
        has_history = found.has_begun or found.wish.since is not Since.NOW
        if not found.has_begun:
            unit.begin_at(found.wish.since)
        position = found.output.stream.last_number
        found.supply, found.streams = supply, tuple(streams)
        found.misled = False
        found.has_begun = found.has_begun or supply is not None
        inputs = (
            []
            if supply is None
            else merge_inputs(
                supply, streams, self._configuration, lambda: self._ontology.vocabulary
            )
        )
        has_forgotten = unit.switch(inputs, history=has_history)
        gained = tuple(stream for stream in unit.inputs if stream not in before)
        lost = [stream for stream in before if stream not in unit.inputs]
        self._configuration.change_inputs(unit, gained, lost, f"{found.wish.want}: {why}")
        after = found.leaves
        found.rematches.append(Rematch(self._clock(), position, why, names, after, has_forgotten))
        return gained
