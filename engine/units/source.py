"""A source that is started because somebody needs what it provides ([Introspection15 §3.1])."""

from __future__ import annotations

from typing import Any

from ...streams.generator import StreamGenerator
from ...streams.sample import SampleBatch
from ..model.process_reports import OnReport, ignore_report
from ..model.status_changes import Role
from ..processes.registry import SourceImplementation
from ..processes.supervision import DIRECT, ProcessEvent, Runner, Tell
from .base import ComputationalUnit
from .sampled_source import SampledSource


class SourceUnit(ComputationalUnit):
    """A computational unit with zero input streams: it reads ``implementation`` at its period.

    ``on_event`` hears of failures, restarts and the stop, as of other user-written code.
    """

    role = Role.SOURCE

    def __init__(
        self,
        *args: Any,
        implementation: SourceImplementation,
        parameters: dict[str, str],
        on_event: Tell,
        on_report: OnReport = ignore_report,
        runner: Runner = DIRECT,
    ) -> None:
        super().__init__(*args)
        self._on_event = on_event
        self._source = SampledSource(
            implementation,
            self.output,
            None,
            on_event=self._told,
            runner=runner,
            name=self.name,
            parameters=parameters,
            on_report=on_report,
        )
        self.counters = self._source.counters

    def tick(self, now: int) -> None:
        """The time is ``now`` (ns): read what is due."""
        if self.failure is None:
            self._source.tick(now)

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        raise AssertionError("a source has no inputs")

    def _told(self, _: SampledSource, event: ProcessEvent, text: str) -> None:
        if event is ProcessEvent.STOPPED:
            self.failure = text
        self._on_event(event, text)
