"""A source that is started because a request needs its stream ([Introspection15 §3.1])."""

from __future__ import annotations

from typing import Any

from ...streams.generator import StreamGenerator
from ...streams.sample import SampleBatch
from ..model.process_reports import OnReport, ignore_report
from ..model.status_changes import Role
from ..processes.registry import SourceImplementation
from ..processes.supervision import DIRECT, OnEvent, ProcessEvent, Runner
from .base import ComputationalUnit
from .sampled_source import SampledSource


class SourceUnit(ComputationalUnit):
    """A computational unit with zero input streams: it reads ``implementation`` at its period.

    ``on_event`` is called with failures, restarts and the stop, as for other user-written code.
    """

    role = Role.SOURCE

    def __init__(
        self,
        *args: Any,
        implementation: SourceImplementation,
        parameters: dict[str, str],
        on_event: OnEvent,
        on_report: OnReport = ignore_report,
        runner: Runner = DIRECT,
    ) -> None:
        super().__init__(*args)
        self._on_event = on_event
        self._source = SampledSource(
            implementation,
            self.output,
            None,
            on_event=self._handle_event,
            runner=runner,
            name=self.name,
            parameters=parameters,
            on_report=on_report,
        )
        self.counters = self._source.counters

    def tick(self, now: int) -> None:
        """Read the source at the due times up to ``now`` (ns)."""
        if self.failure is None:
            self._source.tick(now)

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        raise AssertionError("a source has no inputs")

    def _handle_event(self, _: SampledSource, event: ProcessEvent, text: str) -> None:
        if event is ProcessEvent.STOPPED:
            self.failure = text
        self._on_event(event, text)
