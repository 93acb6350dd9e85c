"""Starts monitors: what a formula needs is matched with streams, as for a query (SPEC §8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...languages.mtl import CheckedMonitor, Monitor, check_mtl
from ...languages.mtl.checked import ObjectConstant, ObjectVariable, Reading
from ...matching.match import Match
from ...matching.plan import Supply
from ...matching.subject import Sorts, Subject
from ...matching.want import Want
from ...ontology.ontology import Ontology
from ...rdf.dictionary import TermDictionary
from ...rdf.namespaces import shorten
from ...reasoning.mtl.evaluator import sorts_of
from ...reasoning.mtl.formulas import reach_of, readings_of
from ...reasoning.mtl.nodes import term_of
from ...streams.generator import StreamGenerator
from ...streams.policies.policy import Approximation
from ...streams.time import format_duration
from ...templates.needs import Needs
from ..configuration.configuration import MTL, Configuration
from ..model.beginning import Beginning
from ..model.errors import BadArguments
from ..units.monitor import RESULT_FIELDS, MonitorUnit, verdict_schema
from ..units.term_readers import TermInput
from .plan_execution import Plans
from .stream_binding import supplies_of
from .supply_inputs import merge_inputs


@dataclass(frozen=True, slots=True)
class MonitorNeeds:
    """A monitor, and the features that it needs: for each want the readings that it serves."""

    monitor: CheckedMonitor
    text: Monitor
    readings: dict[Want, list[Reading]]

    @property
    def needs(self) -> Needs:
        return Needs(tuple(self.readings), None)


def monitor_needs(monitor: Monitor, source: str, ontology: Ontology) -> MonitorNeeds:
    """Return what a monitor needs. Raises `LanguageError`, and `BadArguments` for a parameter whose
    objects no feature gives."""
    checked = check_mtl(monitor, source, ontology.vocabulary)
    sorts = sorts_of(checked)
    readings: dict[Want, list[Reading]] = {}
    for reading in dict.fromkeys(readings_of(checked.formula)):
        readings.setdefault(_want(reading, sorts), []).append(reading)
    arguments = (a for reading in readings_of(checked.formula) for a in reading.arguments)
    named = {argument.name for argument in arguments if isinstance(argument, ObjectVariable)}
    for name, sort in sorts.items():
        if name not in named:
            raise BadArguments(
                f"no feature of `?{name}` is in the formula, so its objects are not known",
                f"read a feature of it, such as `speed(?{name})`, or leave `?{name} in "
                f"{shorten(sort)}` out",
            )
    for name, _ in checked.parameters:
        if name in (*RESULT_FIELDS, "available", "valid"):
            raise BadArguments(
                f"`?{name}` cannot be a parameter: the verdicts have a field {name!r}",
                "give the variable another name",
            )
    return MonitorNeeds(checked, monitor, readings)


class MonitorStarter:
    """Starts the units of monitors."""

    def __init__(
        self,
        ontology: Ontology,
        dictionary: TermDictionary,
        configuration: Configuration,
        plans: Plans,
    ) -> None:
        self._ontology = ontology
        self._dictionary = dictionary
        self._configuration = configuration
        self._plans = plans

    def start(
        self,
        name: str,
        source: str,
        needed: MonitorNeeds,
        matches: Sequence[Match],
        since: Beginning,
    ) -> MonitorUnit:
        """Start the units of the ``matches``, one for each want, and the monitor over them."""
        supplies = supplies_of(matches)
        terms = [each for supply in supplies for each in self._inputs(needed, supply, since)]
        sources = dict.fromkeys(each.input.source for each in terms)

        def make(output: StreamGenerator) -> MonitorUnit:
            return MonitorUnit(
                *self._configuration.identity(MTL, list(sources), output, {"query": source}),
                monitor=needed.monitor,
                terms=terms,
                dictionary=self._dictionary,
                wider=self._wider(needed.monitor),
                text=needed.text,
                explanation=explain_monitor(needed.monitor),
                newest=self._configuration.newest_upstream,
            )

        return self._configuration.start_query(verdict_schema(needed.monitor), make, since, name)

    def _inputs(self, needed: MonitorNeeds, supply: Supply, since: Beginning) -> list[TermInput]:
        streams = [self._plans.obtain(source.node, since) for source in supply.sources]
        inputs = merge_inputs(
            supply, streams, self._configuration, lambda: self._ontology.vocabulary
        )
        sorts = sorts_of(needed.monitor)
        # Readings of one term share its values, under whatever variables.
        terms = {term_of(reading, sorts): reading for reading in needed.readings[supply.want]}
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


def explain_monitor(monitor: CheckedMonitor) -> str:
    """Describe the evaluation of a monitor before it starts."""
    policy = monitor.policy
    delay = 0 if policy.max_delay is None else policy.max_delay
    is_approximate = policy.approximation is Approximation.MOST_RECENT
    reach = reach_of(monitor.formula)
    latest = (
        "an interval has no end, so some verdicts wait for the end of the streams"
        if reach is None
        else f"at most {format_duration(reach + delay)} after the time of the start"
    )
    order = "" if policy.max_delay is not None else "; the streams are taken to be in order"
    states = (
        "at each sample" if policy.period is None else f"every {format_duration(policy.period)}"
    )
    return "\n".join(
        [
            f"states       {states}, with values that are "
            + ("the newest" if is_approximate else "valid just then")
            + order,
            f"a verdict    {latest}; reported are {monitor.report}"
            + (", of the first state alone" if monitor.once else ""),
        ]
    )


def _want(reading: Reading, sorts: dict[str, str]) -> Want:
    first, *others = (
        Subject(None, argument.iri)
        if isinstance(argument, ObjectConstant)
        else Subject(sorts[argument.name], None)
        for argument in reading.arguments
    )
    return Want(reading.feature, first.sort, first.object, tuple(others))
