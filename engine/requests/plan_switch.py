"""Switches an adaptive subscription from one plan to another ([Introspection15 §4.4])."""

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
from ..planning.supply_inputs import merge_inputs
from ..units.merge import MergeUnit, object_fields
from .adaptive_subscription import (
    AdaptiveSubscription,
    Rematch,
    Wish,
    value_field,
)


class PlanSwitch:
    """Executes the plans of subscriptions. ``clock`` returns the time (ns)."""

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
        """Make the merge unit of a subscription, without inputs."""
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
        self, subscription: AdaptiveSubscription, supply: Supply | None, since: Beginning
    ) -> tuple[StreamGenerator, ...]:
        """Return the source streams of a plan that begins ``since``, and start their units if
        needed. Raises `DyknowError` and `Forgotten`, and starts nothing then."""
        read = self._working_streams(subscription)
        sources = () if supply is None else supply.sources
        try:
            return tuple(
                read.get(source.node) or self._plans.obtain(source.node, since)
                for source in sources
            )
        except (DyknowError, Forgotten):
            self._configuration.release_unused()
            raise

    def _working_streams(self, subscription: AdaptiveSubscription) -> dict[Node, StreamGenerator]:
        """The working sources of the present plan; the next plan keeps them as they are, even if
        it has another beginning."""
        if subscription.supply is None:
            return {}
        configuration = self._configuration
        streams: dict[Node, StreamGenerator] = {}
        for source, stream in zip(subscription.supply.sources, subscription.streams, strict=True):
            maker = configuration.units.get(stream.name)
            if configuration.streams.get(stream.name) is stream and (
                maker is None
                or (configuration.has_current_inputs(maker) and not configuration.is_broken(maker))
            ):
                streams[source.node] = stream
        return streams

    def switch(
        self,
        subscription: AdaptiveSubscription,
        supply: Supply | None,
        streams: Sequence[StreamGenerator],
        why: str,
    ) -> tuple[StreamGenerator, ...]:
        """Replace the inputs by ``streams``, those of ``supply``; return the new ones."""
        unit = subscription.unit
        before, names = unit.inputs, subscription.source_names
        # A later plan reads the history of its sources, so that the merge goes on without a gap.
        has_history = subscription.has_begun or subscription.wish.since is not Since.NOW
        if not subscription.has_begun:
            unit.begin_at(subscription.wish.since)
        # The switch below may emit samples from the history, and these come after the position.
        position = subscription.output.stream.last_number
        subscription.supply, subscription.streams = supply, tuple(streams)
        subscription.has_new_meaning = False
        subscription.has_begun = subscription.has_begun or supply is not None
        # The merge looks the vocabulary up, since the ontology may change while it runs.
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
        self._configuration.change_inputs(unit, gained, lost, f"{subscription.wish.want}: {why}")
        after = subscription.source_names
        subscription.rematches.append(
            Rematch(self._clock(), position, why, names, after, has_forgotten)
        )
        return gained
