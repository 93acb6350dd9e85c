"""Starts monitors: what a formula needs is matched with streams, as for a query (SPEC §8)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ...languages.mtl import CheckedMonitor
from ...languages.mtl.checked import ObjectVariable
from ...languages.mtl.normal_form import normal_form
from ...languages.ssl.annotation import Content, Role, StreamAnnotation
from ...languages.ssl.annotation_text import with_ssl_source
from ...matching.plan import Node, Supply
from ...matching.subject import Sorts
from ...ontology.ontology import Ontology
from ...rdf.dictionary import TermDictionary
from ...reasoning.mtl.bits.evaluator import bits_of_state, is_sliced
from ...reasoning.mtl.evaluator import BYTES_OF_NODE, MOST_STATES
from ...reasoning.mtl.formulas import (
    count_of,
    objects_have_states,
    past_reach_of,
    reach_of,
    remembered_by,
    sorts_of,
)
from ...reasoning.mtl.monitoring import VERDICT
from ...reasoning.mtl.nodes import term_of
from ...reasoning.mtl.parts.evaluator import bytes_of_state
from ...streams.generator import StreamGenerator
from ...streams.policies.policy import Approximation
from ...streams.time import format_duration
from ...templates.formulas import BoundFormula
from ..configuration.configuration import MTL, SELECT_INSTANCE, Configuration
from ..model.beginning import Beginning
from ..model.views import Since
from ..units.reasoning.monitor import MonitorUnit
from ..units.reasoning.term_readers import TermInput
from ..units.reasoning.verdict_samples import verdict_schema
from ..units.sharing.instances import TALLY
from ..units.sharing.shared_monitor import MonitorInstance, SharedMonitorUnit
from .supply_inputs import merge_inputs


class MonitorStarter:
    """Starts the units of monitors. ``obtain`` returns the stream of a plan node."""

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

    def start(
        self,
        formula: BoundFormula,
        supplies: Sequence[Supply],
        since: Beginning,
        *,
        name: str | None = None,
        request: str | None = None,
    ) -> MonitorUnit:
        """Start the units of the ``supplies``, one for each want, and the monitor over them. Its
        stream gets ``name``, or the next reserved one. ``request``: the text of the request that
        has the arguments of a template."""
        terms = [each for supply in supplies for each in self._inputs(formula, supply, since)]
        sources = dict.fromkeys(each.input.source for each in terms)

        def make(output: StreamGenerator) -> MonitorUnit:
            parameters = {"query": formula.source}
            if request is not None:
                parameters = {"request": request, **parameters}
            return MonitorUnit(
                *self._configuration.identity(MTL, list(sources), output, parameters),
                monitor=formula.monitor,
                terms=terms,
                dictionary=self._dictionary,
                wider=self._wider(formula.monitor),
                text=formula.text,
                explanation=explain_monitor(formula.monitor),
                newest=self._configuration.newest_sample,
            )

        return self._configuration.start_query(verdict_schema(formula.monitor), make, since, name)

    def start_shared(
        self, monitor: CheckedMonitor, free: BoundFormula, supplies: Sequence[Supply]
    ) -> SharedMonitorUnit:
        """Start the evaluation of a formula for each object that an instance asks for, over the
        streams of all objects. ``monitor``: without values; ``free``: that of all objects."""
        terms = [each for supply in supplies for each in self._inputs(free, supply, Since.NOW)]
        objects = {each.input.source: each.input.objects[0] for each in terms}

        def make(output: StreamGenerator) -> SharedMonitorUnit:
            parameters = {"query": free.source}
            return SharedMonitorUnit(
                *self._configuration.identity(MTL, list(objects), output, parameters),
                monitor=monitor,
                terms=terms,
                objects=objects,
                dictionary=self._dictionary,
                text=free.text,
                explanation=explain_monitor(monitor, has_own_states=True),
                newest=self._configuration.newest_sample,
            )

        return self._configuration.start_query(TALLY, make)

    def start_instance(
        self,
        shared: SharedMonitorUnit,
        own: BoundFormula,
        free: BoundFormula,
        object: str,
        request: str,
    ) -> MonitorInstance:
        """Start an instance of a shared formula for an ``object`` (an IRI), with the arguments of
        ``request`` (its text). ``own``: the formula of this object; ``free``: that of all."""

        def make(output: StreamGenerator) -> MonitorInstance:
            parameters = {"request": request, "query": own.source}
            return MonitorInstance(
                *self._configuration.identity(SELECT_INSTANCE, [shared.output], output, parameters),
                template=shared,
                object=object,
                monitor=own.monitor,
                of_all=free.monitor,
                values=own.values,
            )

        return self._configuration.start_query(verdict_schema(own.monitor), make)

    def _inputs(self, formula: BoundFormula, supply: Supply, since: Beginning) -> list[TermInput]:
        streams = [self._obtain(source.node, since) for source in supply.sources]
        inputs = merge_inputs(
            supply, streams, self._configuration, lambda: self._ontology.vocabulary
        )
        sorts = sorts_of(formula.monitor)
        # Readings of one term share its values, under whatever variables.
        terms = {term_of(reading, sorts): reading for reading in formula.readings[supply.want]}
        return [
            TermInput(
                term,
                reading.kind,
                tuple(i for i, a in enumerate(reading.arguments) if isinstance(a, ObjectVariable)),
                input,
            )
            for term, reading in terms.items()
            for input in inputs
        ]

    def _wider(self, monitor: CheckedMonitor) -> dict[str, tuple[str, ...]]:
        known = Sorts(self._ontology.vocabulary)
        used = dict.fromkeys(sorts_of(monitor).values())
        return {
            sort: tuple(other for other in used if other != sort and known.within(sort, other))
            for sort in used
        }


def explain_monitor(monitor: CheckedMonitor, *, has_own_states: bool | None = None) -> str:
    """Describe the evaluation of a monitor before it starts. ``has_own_states``: as for
    `Monitoring`."""
    if has_own_states is None:
        has_own_states = objects_have_states(monitor)
    policy = monitor.policy
    delay = 0 if policy.max_delay is None else policy.max_delay
    is_approximate = policy.approximation is Approximation.MOST_RECENT
    reach = reach_of(monitor.formula)
    if reach is None:
        latest = "an interval has no end, so some verdicts wait for the end of the streams"
    elif reach + delay:
        latest = f"at most {format_duration(reach + delay)} after the time of the start"
        if reach and delay:
            parts = format_duration(reach), format_duration(delay)
            latest += f": {parts[0]} of intervals and {parts[1]} of max delay"
    else:
        latest = "with the state of its start"
    order = "" if policy.max_delay is not None else "; the streams are taken to be in order"
    states = (
        "at each sample" if policy.period is None else f"every {format_duration(policy.period)}"
    )
    return "\n".join(
        [
            f"normal form  {normal_form(monitor.formula)}",
            f"states       {states}, with values that are "
            + ("the newest" if is_approximate else "valid just then")
            + order,
            f"a verdict    {latest}; reported are {monitor.report}"
            + (", with their robustness" if monitor.robustness else "")
            + (", of the first state alone" if monitor.once else ""),
            f"memory       {_memory(monitor, reach, has_own_states)}",
        ]
    )


def _memory(monitor: CheckedMonitor, reach: int | None, has_own_states: bool) -> str:
    """How many states are kept at most, and the bytes of each. ``reach``: that of the formula."""
    if has_own_states:
        size = float(bytes_of_state(monitor))
    elif is_sliced(monitor):
        size = bits_of_state(monitor) / 8
    else:
        size = float(BYTES_OF_NODE * count_of(monitor.formula))
    each = f"about {size:g} bytes of each for an object"
    remembered, period = remembered_by(monitor), monitor.policy.period
    back = past_reach_of(monitor.formula, remembered)
    if reach is None or back is None:
        why = (
            "since the oldest start without a verdict" if back is not None else "from the first on"
        )
        return f"all states {why}, {each}; the monitor fails with more than {MOST_STATES:,}"
    if reach + back == 0:
        states = "one state"
    elif period is None:
        states = f"the states of {format_duration(reach + back)}"
    else:
        states = f"at most {(reach + back) // period + 2:,} states"
    if remembered:
        # In each reading; and the first of all, for objects to come.
        others = 2 * len(remembered) + (not has_own_states)
        states += f" and {others} of the past without an end"
    return f"{states}, {each}"


def verdict_annotation(stream: str, event: str, monitor: CheckedMonitor) -> StreamAnnotation | None:
    """Return the annotation of a stream of verdicts that are the values of ``event`` (an IRI); None
    without objects."""
    objects = dict(monitor.fixed)
    roles = tuple(
        Role(objects[sort], sort, name) if sort in objects else Role(sort, None, name)
        for name, sort in monitor.parameters
    )
    if not roles:
        return None
    return with_ssl_source(StreamAnnotation(stream, (Content(event, VERDICT, (), roles),), ""))
