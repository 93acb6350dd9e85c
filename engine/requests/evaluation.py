"""Progress and failures of the units that read a stream."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

from ...streams.generator import StreamGenerator
from ..configuration.configuration import Configuration
from ..model.views import EvaluationView, FailureView
from ..units.backlog import Backlog
from ..units.base import ComputationalUnit
from ..units.windowed import WindowUnit
from .continuous_queries import RegisteredQueries
from .event_requests import EventRequests
from .subscriptions import Subscriptions

AnyUnit = TypeVar("AnyUnit", bound=ComputationalUnit)


class Evaluation:
    """Answers how far units have evaluated a stream, which failed, and for which requests."""

    def __init__(
        self,
        configuration: Configuration,
        backlog: Backlog,
        requests: EventRequests,
        queries: RegisteredQueries,
        subscriptions: Subscriptions,
    ) -> None:
        self._configuration = configuration
        self._backlog = backlog
        self._requesters = (requests, queries, subscriptions)

    def backlog_of(self, stream: str) -> tuple[WindowUnit, ...]:
        """The units of the backlog that read ``stream``, directly or through other units."""
        units = [unit for unit in self._backlog.units if isinstance(unit, WindowUnit)]
        return self._readers(units, stream)

    def failure(self, generator: StreamGenerator) -> str | None:
        """The failure that keeps samples from a stream; None if there is none
        (`Configuration.failure_of`)."""
        unit = self._configuration.units.get(generator.name)
        if unit is None or unit.output is not generator:
            return None
        return self._configuration.failure_of(unit)

    def failed(self) -> tuple[FailureView, ...]:
        """The failed units. Cost: O(units), and O(requests) for each failure."""
        return self._failed(self._configuration.units.values())

    def of(self, name: str) -> EvaluationView:
        """How far all readers have evaluated stream ``name``. Raises `UnknownStream`. Cost:
        O(units²)."""
        generator = self._configuration.stream(name)
        stream, evaluated = generator.stream, generator.stream.last_number
        readers = self._readers(self._configuration.units.values(), generator.name)
        for unit in self.backlog_of(generator.name):
            through = unit.output.watermark
            number = 0 if through is None else stream.number_before(through)
            evaluated = min(evaluated, number, stream.last_number - 1)
        return EvaluationView(stream.last_number, evaluated, self._failed(readers))

    def _readers(self, units: Iterable[AnyUnit], stream: str) -> tuple[AnyUnit, ...]:
        """Those of ``units`` that read ``stream``, directly or through other units."""
        return tuple(
            unit
            for unit in units
            if any(
                source.name == stream
                for one in self._configuration.upstream_units(unit)
                for source in one.inputs
            )
        )

    def _failed(self, units: Iterable[ComputationalUnit]) -> tuple[FailureView, ...]:
        found = []
        for unit in units:
            if unit.failure is not None:
                stream = unit.output.name
                requests = tuple(id for each in self._requesters for id in each.of_stream(stream))
                found.append(FailureView(unit.name, stream, requests, unit.failure))
        return tuple(found)
