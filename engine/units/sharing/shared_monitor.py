"""Requests of one formula template that differ in an object and in values, evaluated as one (SPEC
§8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....languages.mtl.ast import Monitor
from ....languages.mtl.checked import CheckedMonitor
from ....reasoning.mtl.evaluator import Constants
from ....reasoning.mtl.monitoring import Reported
from ....reasoning.mtl.part_monitoring import MonitoredPart, PartMonitoring
from ....streams.generator import StreamGenerator
from ....streams.sample import SampleBatch
from ..reasoning.monitor import RecalledSamples, explain_verdicts
from ..reasoning.sample_reasoner import is_by_clock
from ..reasoning.term_readers import TermInput, term_readers
from ..reasoning.verdict_samples import VerdictWriter
from .shared_reasoner import ReasoningInstance, SharedReasoner


class SharedMonitorUnit(SharedReasoner["MonitorInstance"]):
    """Evaluates a formula for each of the objects that its instances ask for, with the values of
    each. ``monitor`` has the parameters of the template."""

    def __init__(
        self,
        *args: Any,
        monitor: CheckedMonitor,
        terms: Sequence[TermInput],
        text: Monitor,
        explanation: str,
        **options: Any,
    ) -> None:
        super().__init__(*args, **options)
        self._monitor = monitor
        self.text = text
        self.terms = tuple(terms)
        self._explanation = explanation
        self._begin()

    def _begin(self) -> None:
        self.monitoring = PartMonitoring(self._monitor, len(self.sources))
        self._readers = term_readers(self.terms, self._dictionary)

    def explain(self) -> str:
        """Describe the evaluation: the formula, its states by now, and the verdicts."""
        return self._explain(self._explanation, *explain_verdicts(self.monitoring, self.samples))

    @property
    def reasoning(self) -> PartMonitoring:
        return self.monitoring

    def enter(self, object: str, values: Constants) -> int:
        """Evaluate the formula for ``object`` (an IRI) from now on; return its number."""
        return self.ask_for(object, self.monitoring.add_part(object, values))

    def recall(
        self, number: int, since: Mapping[StreamGenerator, int], monitor: CheckedMonitor
    ) -> RecalledSamples:
        """Return the retained samples of an instance's object, for explanations; of each stream
        those after the available time (ns) ``since``. ``monitor``: with its values."""
        own, evicting = self.past_of_part(number, since)
        watermark = self._end + 1 if self.all_ended else self.least_watermark
        newest = self._newest_of(*self.sources)
        return RecalledSamples(
            monitor,
            self.text,
            self.terms,
            {},
            self.monitoring.part(number).grid,
            len(self.sources),
            own,
            evicting,
            {self.sources.index(source): self._newest_of(source) for source in self._ended},
            self._end if self.all_ended else None,
            watermark,
            watermark is not None and not self.all_ended and is_by_clock(watermark, newest),
        )

    def _emit(self, found: Reported) -> None:
        parts = found.objects[0].astype(np.int64)

        def of_instance(rows: NDArray[np.int64], instance: MonitorInstance) -> Reported:
            return found.take(rows)

        self._hand_out(parts, found.available, found.valid, of_instance)


class MonitorInstance(ReasoningInstance):
    """Emits the verdicts of one ``object`` (an IRI). ``monitor``: that of this object;
    ``of_all``: that of all objects with the same ``values``."""

    def __init__(
        self,
        *args: Any,
        template: SharedMonitorUnit,
        object: str,
        monitor: CheckedMonitor,
        of_all: CheckedMonitor,
        values: Constants,
    ) -> None:
        super().__init__(
            *args, template=template, object=object, enter=lambda: template.enter(object, values)
        )
        self.monitor = monitor
        self._of_all = of_all
        self._writer = VerdictWriter(monitor)
        self._left: MonitoredPart | None = None
        """How far its evaluation was when it left."""

    @property
    def template(self) -> SharedMonitorUnit:
        """The unit that evaluates this formula together with others."""
        assert isinstance(self._template, SharedMonitorUnit)
        return self._template

    @property
    def monitoring(self) -> MonitoredPart:
        """How far its evaluation is. Contract: it has begun."""
        if self.number is not None:
            return self.template.monitoring.part(self.number)
        assert self._left is not None
        return self._left

    def leave(self, *, forgets: bool = True) -> None:
        if self.number is not None:
            self._left = self.monitoring
        super().leave(forgets=forgets)

    @property
    def is_finished(self) -> bool:
        # The end has decided its single start.
        return self.monitor.once and self.monitoring.states > 0

    def recall(self) -> RecalledSamples:
        """Return the retained samples that it has read, for explanations."""
        assert self.number is not None
        return self.template.recall(self.number, self._since, self._of_all)

    def _emit(self, found: Reported) -> None:
        objects = np.full((1, len(found)), self.object, object)
        columns = self._writer.columns(found, objects, self.output.stream.pools)
        self.output.emit(SampleBatch(self.output.stamps_at(found.available), found.valid, columns))
