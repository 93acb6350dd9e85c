"""Handles user-written code that raises an error, blocks, or returns a wrong answer.

Computational units, sources and sinks run unknown code. A failure concerns that process alone: it
is counted, reported, and handled by the rule that the process declares. `FunctionProcess`,
`TransformationUnit`, `SampledSource` and `Sink` call their code through a `Supervisor`.

This module has no clock. The `Runner` decides whether code blocks: `DirectRunner` waits without
limit, `service/runtime/process_watchdog` has a deadline.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from types import TracebackType
from typing import Generic, NamedTuple, Protocol, TypeAlias, TypeVar, assert_never

from ...streams.time import SECOND
from .external_io import Failed, Tape

T = TypeVar("T")
Item = TypeVar("Item")
Result = TypeVar("Result")

_REPORTED = 10
"""The number of errors of a process that are each reported. After that only each doubling of their
number is, so that a failing process does not flood the status stream."""
_MAX_TEXT = 500
"""The greatest number of characters of an error's text."""


class UnitBlocked(Exception):
    """A process did not return within its deadline."""


class ProcessError(Exception):
    """A process returned a wrong answer; the message names the field and the expected value."""


class OnError(StrEnum):
    """The rule of a process for its errors."""

    RESTART = "restart"
    """Reset the state to no_value and go on with the next sample, unless failures are too many."""
    SKIP = "skip"
    """Drop the sample; the state stays as it was."""
    STOP = "stop"
    """Stop at the first error."""


@dataclass(frozen=True, slots=True)
class ErrorRule:
    """``restarts``: the number of failures in a row with a restart; the next one stops the process.
    ``deadline``: ns within which a call must return; None: no deadline."""

    on_error: OnError = OnError.RESTART
    restarts: int = 3
    deadline: int | None = 2 * SECOND


class ProcessEvent(StrEnum):
    """Events of a process. FAILED comes first; a restart or stop by the rule follows."""

    FAILED = "unit failed"
    RESTARTED = "unit restarted"
    STOPPED = "unit stopped by rule"


DeferFailures: TypeAlias = Callable[[Sequence[Failed], int], bool]
"""Called with failures and the number of failures in a row; returns whether `apply_failures` will
handle them later."""
OnEvent: TypeAlias = Callable[[ProcessEvent, str], None]
"""Called with an event and a text for users, after the samples before it were offered."""


@dataclass(slots=True)
class ErrorCounters:
    """Counters of a process's errors. ``last_error_time`` is the time (ns) of the sample that
    failed."""

    errors: int = 0
    restarts: int = 0
    last_error: str | None = None
    last_error_time: int | None = None

    def note(self, text: str, time: int | None) -> None:
        """Count an error."""
        self.errors += 1
        self.last_error = text
        self.last_error_time = time


class Runner(Protocol):
    """Calls user-written code. ``tape`` records the readings of sources, if there is a log."""

    @property
    def tape(self) -> Tape | None: ...

    def run(self, work: Callable[[], T], deadline: int | None, progress: Callable[[], int]) -> T:
        """Return the result of ``work()``, or raise its error.

        ``work`` makes many calls; ``progress()`` grows with each that returns. Raises `UnitBlocked`
        when it has not grown for ``deadline`` ns. ``work`` may still run then; the caller ignores
        whatever it does from there on.
        """


class DirectRunner:
    """Calls without a deadline."""

    tape: Tape | None = None

    def run(self, work: Callable[[], T], deadline: int | None, progress: Callable[[], int]) -> T:
        return work()


DIRECT = DirectRunner()


class _Verdict(StrEnum):
    SKIPPED = "the sample is skipped"
    RESTARTED = "it starts again without state"
    STOPPED = "it stops"


@dataclass(frozen=True, slots=True)
class _Failure:
    time: int
    text: str
    verdict: _Verdict
    reason: str = ""


@dataclass(frozen=True, slots=True)
class _Success(Generic[Result]):
    result: Result


class Returned(NamedTuple):
    """The number of ``calls`` that returned. If the next one, for ``time``, blocked, ``blocked`` is
    the error."""

    calls: int
    time: int = 0
    blocked: str | None = None


class Supervisor:
    """Calls a process item by item, and handles its failures by its rule.

    ``restart`` drops the state of the process, ``stop`` stops it for a reason. ``on_event`` is
    called with the events, last of all. ``defer`` may put the failures off.

    Law: results, counters and events do not depend on how the items were cut into runs.

    Contract: a call that the runner has given up changes nothing here when it returns.
    """

    def __init__(
        self,
        rule: ErrorRule,
        runner: Runner,
        counters: ErrorCounters,
        restart: Callable[[], None],
        stop: Callable[[str], None],
        on_event: OnEvent,
        defer: DeferFailures | None = None,
    ) -> None:
        self.rule = rule
        self.counters = counters
        self._defer = defer
        self._runner = runner
        self._restart = restart
        self._stop = stop
        self._stop_reason: str | None = None
        self._on_event = on_event
        self._in_a_row = 0

    def run(
        self,
        items: Sequence[tuple[int, Item]],
        step: Callable[[int, Item], Result],
        deliver: Callable[[Sequence[Result]], None],
    ) -> Returned:
        """Call ``step(time, item)`` for each item in order; pass the results to ``deliver``, then
        report the failures. A stop skips the rest of the items.

        Every error of the code is an error of the process, SystemExit included; only the user's
        Ctrl-C passes through (`is_interrupt`).
        """
        returned = Returned(0)
        if self._stop_reason is not None or not items:
            return returned
        log: list[_Success[Result] | _Failure] = []
        in_a_row = self._in_a_row

        def work() -> None:
            # It shares only `log`, and only appends. After `UnitBlocked` the caller uses a copy.
            nonlocal in_a_row
            for time, item in items:
                try:
                    log.append(_Success(step(time, item)))
                    in_a_row = 0
                except RecordedBlock:
                    raise
                except BaseException as error:  # isolated, counted and reported by the rule
                    if is_interrupt(error):
                        raise
                    in_a_row += 1
                    verdict = self._verdict(in_a_row)
                    if verdict is _Verdict.RESTARTED:
                        self._restart()
                    log.append(_Failure(time, describe(error), verdict, self._reason(in_a_row)))
                    if verdict is _Verdict.STOPPED:
                        return

        try:
            self._runner.run(work, self.rule.deadline, lambda: len(log))
            entries = log
            returned = Returned(len(entries))
        except UnitBlocked as blocked:
            entries = log.copy()
            returned = Returned(len(entries))
            if len(entries) < len(items):  # else the last call returned at the last moment
                time = items[len(entries)][0]
                returned = Returned(len(entries), time, describe(blocked))
                entries.append(_Failure(time, describe(blocked), _Verdict.STOPPED))
        before, self._in_a_row = self._in_a_row, in_a_row
        if not self._defer_failures(entries, before):
            self._settle(entries, deliver)
        return returned

    def apply_failures(self, failed: Sequence[Failed], in_a_row: int) -> None:
        """Count, report and handle failures that ``defer`` has put off."""
        self._in_a_row = in_a_row
        entries = [
            _Failure(one.time, one.text, _Verdict(one.verdict), one.reason) for one in failed
        ]
        self._settle(entries, lambda _: None)

    def _defer_failures(self, entries: Sequence[_Success[Result] | _Failure], before: int) -> bool:
        """Put failures off if possible; return whether. A process that its rule stops is not called
        any more meanwhile."""
        failures = [entry for entry in entries if isinstance(entry, _Failure)]
        if self._defer is None or not (failures or self._in_a_row < before):
            return False
        failed = [Failed(one.time, one.text, one.verdict, one.reason) for one in failures]
        if not self._defer(failed, self._in_a_row):
            return False
        if failures and failures[-1].verdict is _Verdict.STOPPED:
            self._stop_reason = failures[-1].text
        return True

    def _verdict(self, in_a_row: int) -> _Verdict:
        match self.rule.on_error:
            case OnError.SKIP:
                return _Verdict.SKIPPED
            case OnError.STOP:
                return _Verdict.STOPPED
            case OnError.RESTART:
                return _Verdict.STOPPED if in_a_row > self.rule.restarts else _Verdict.RESTARTED
            case _:
                assert_never(self.rule.on_error)

    def _reason(self, in_a_row: int) -> str:
        if self.rule.on_error is OnError.RESTART:
            return f"{in_a_row} failures in a row, {self.rule.restarts} restarts are allowed"
        return f"on_error is {self.rule.on_error}"

    def _settle(
        self,
        entries: Sequence[_Success[Result] | _Failure],
        deliver: Callable[[Sequence[Result]], None],
    ) -> None:
        events: list[tuple[ProcessEvent, str]] = []
        for entry in entries:
            if isinstance(entry, _Failure):
                events += self._count(entry)
        # Samples first: a listener of failures then has the samples before them.
        deliver([entry.result for entry in entries if isinstance(entry, _Success)])
        if self._stop_reason is not None:
            self._stop(self._stop_reason)
        for event, text in events:
            self._on_event(event, text)

    def _count(self, failure: _Failure) -> list[tuple[ProcessEvent, str]]:
        """Count a failure; return the events to report."""
        counters = self.counters
        counters.note(failure.text, failure.time)
        count = counters.errors
        is_reported = count <= _REPORTED or count & (count - 1) == 0
        events = []
        if is_reported or failure.verdict is _Verdict.STOPPED:
            text = f"error {count}: {failure.text}; {failure.verdict}"
            events.append((ProcessEvent.FAILED, text))
        match failure.verdict:
            case _Verdict.SKIPPED:
                pass
            case _Verdict.RESTARTED:
                counters.restarts += 1
                if is_reported:
                    events.append((ProcessEvent.RESTARTED, f"restart {counters.restarts}"))
            case _Verdict.STOPPED:
                reason = failure.text + (f" ({failure.reason})" if failure.reason else "")
                self._stop_reason = reason
                events.append((ProcessEvent.STOPPED, reason))
            case _:
                assert_never(failure.verdict)
        return events


@dataclass(slots=True)
class Instance(Generic[T]):
    """The callable of one process: ``make`` makes it at the first call, and again after a restart.

    A class is instantiated for each process. Not at the start, so that an error of its constructor
    is an error of the process.
    """

    make: Callable[[], T]
    _made: list[T] = field(default_factory=list)

    def get(self) -> T:
        """Return the callable."""
        if not self._made:
            self._made.append(self.make())
        return self._made[0]

    @property
    def is_made(self) -> bool:
        """Whether there is a callable, which may have a state."""
        return bool(self._made)

    def forget(self) -> None:
        """Make a new callable at the next call."""
        self._made.clear()


class RecordedError(Exception):
    """An error of the first run, with its recorded text."""


class RecordedBlock(RecordedError, UnitBlocked):
    """A call that blocked in the first run."""


def is_interrupt(error: BaseException) -> bool:
    """Whether ``error`` is the user's Ctrl-C, not an error of user-written code.

    Python raises it in the main thread, and only while its own handler of SIGINT is installed. The
    service installs another handler.
    """
    return (
        isinstance(error, KeyboardInterrupt)
        and threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    )


def describe(error: BaseException) -> str:
    """Return an error as one line: ``ZeroDivisionError: division by zero (units.py:12)``.

    It is valid UTF-8 and of bounded length. If the error's ``__str__`` fails, only its type is
    reported.
    """
    if isinstance(error, RecordedError):
        return str(error)
    try:
        text = str(error)
    except BaseException as second:  # user code again; the type is reported
        if is_interrupt(second):
            raise
        text = f"(its text raised {type(second).__name__})"
    kind = type(error).__name__
    line = f"{kind}: {text}" if text else kind
    if not isinstance(error, ProcessError | UnitBlocked):
        line += _place(error.__traceback__)
    line = " ".join(line.split())
    line = line.encode("utf-8", "backslashreplace").decode()
    return line if len(line) <= _MAX_TEXT else f"{line[: _MAX_TEXT - 1]}…"


def _place(trace: TracebackType | None) -> str:
    """Return `` (file:line)`` of the code that raised the error."""
    if trace is None:
        return ""
    while trace.tb_next is not None:
        trace = trace.tb_next
    return f" ({Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno})"
