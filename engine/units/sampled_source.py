"""Sample-based sources: functions of time, called periodically ([DyKnow10 Def. 5.9, 5.33])."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from ...streams.generator import StreamGenerator
from ...streams.time import TIME_MAX
from ..model.process_reports import OnReport, ignore_report
from ..processes.call_adapter import Answers, Row
from ..processes.external_io import Reading, ReadingTurn
from ..processes.registry import SourceImplementation
from ..processes.supervision import (
    DIRECT,
    ErrorCounters,
    Instance,
    ProcessEvent,
    RecordedBlock,
    RecordedError,
    Runner,
    Supervisor,
    describe,
    is_interrupt,
)


class SampledSource:
    """A running source. Each `tick` reads it at the due times ``start + k * period`` that have
    passed. ``start`` None: the first tick is the first due time.

    A sample is available and valid at its due time, unless its code states other times. A tick
    reads at most ``behind`` due times, the latest; ``missed`` counts earlier ones, since a sensor
    that is read late does not report the past. If readings are recorded and the disk has no room,
    the source is not read; ``without_room`` counts these due times (`Tape`). A source that its rule
    stops ends its output; ``failure`` is the reason.

    ``parameters`` are those of the code, as text. Cost: Python per reading. Memory: constant.
    """

    def __init__(
        self,
        implementation: SourceImplementation,
        output: StreamGenerator,
        start: int | None,
        *,
        on_event: Callable[[SampledSource, ProcessEvent, str], None],
        runner: Runner = DIRECT,
        behind: int = 100,
        name: str | None = None,
        parameters: Mapping[str, str] | None = None,
        on_report: OnReport = ignore_report,
    ) -> None:
        self.implementation = implementation
        self.output = output
        self.name = name or implementation.name
        self.counters = ErrorCounters()
        self.failure: str | None = None
        self.missed = 0
        self.without_room = 0
        self._next = start
        self._behind = behind
        self._answers = Answers(output, on_report, is_source=True)
        self._runner = runner
        self._instance: Instance[Callable[..., Any]] = Instance(
            lambda: implementation.make(parameters)
        )
        self._supervisor = Supervisor(
            implementation.rule,
            runner,
            self.counters,
            self._instance.forget,
            self._stop_by_rule,
            lambda event, text: on_event(self, event, text),
        )

    def tick(self, now: int) -> None:
        """Read the source at the due times up to ``now`` (ns), and advance the output to it."""
        if self.failure is not None:
            return
        if self._next is None:
            self._next = now
        if self._next <= now:
            period = self.implementation.period
            due = (now - self._next) // period + 1
            missed = max(0, due - self._behind)
            self.missed += missed
            times = [self._next + k * period for k in range(missed, due)]
            self._next += due * period
            self._run(times)
        if self.failure is None and now < TIME_MAX:
            self.output.advance(now + 1)

    def stop(self) -> None:
        """Stop reading, and end the output."""
        self.failure = self.failure or "stopped"
        self.output.end()
        self.output.close()

    def _stop_by_rule(self, reason: str) -> None:
        self.failure = reason
        self.output.end()

    def _run(self, times: Sequence[int]) -> None:
        items = [(time, None) for time in times]
        tape = self._runner.tape
        if tape is None:
            self._supervisor.run(items, lambda time, _: self._call(time), self._answers.offer)
            return
        turn = tape.turn(self.name, self.output.name)
        returned = self._supervisor.run(
            items, lambda time, _: self._read(turn, time), self._answers.offer
        )
        self.without_room += turn.end(returned.calls, returned.time, returned.blocked)

    def _read(self, turn: ReadingTurn, time: int) -> Row | None:
        """Read the source at ``time``, or replay its reading."""
        before = self._answers.mark()
        reading = turn.read(time, partial(self._record, time))
        if reading is None:
            self._answers.rewind(before)
            return None
        if reading.is_blocked:
            raise RecordedBlock(reading.error)
        if reading.error is not None:
            raise RecordedError(reading.error)
        if turn.is_replaying:
            self._answers.replay(reading.sample, reading.report)
        return reading.sample

    def _call(self, time: int) -> Row | None:
        return self._answers.row(self._instance.get()(time), time, time)

    def _record(self, time: int) -> Reading:
        """Call the code, and return its sample, report or error for the tape."""
        before = len(self._answers.reports)
        try:
            row = self._call(time)
        except BaseException as error:  # recorded, and raised in `_read`
            if is_interrupt(error):
                raise
            return Reading(self.name, time, error=describe(error))
        for report in self._answers.reports[before:]:
            return Reading(self.name, time, row, report.quality, report.contains)
        return Reading(self.name, time, row)
