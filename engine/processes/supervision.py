"""What happens when a user-written process raises, blocks or gives back nonsense.

Computational units, sources and sinks run code that the system has not seen before. A failure of
it concerns that process alone: it is counted, told, and answered by the rule that the process
declared. `FunctionProcess`, `SampledSource` and `Sink` call the code through a `Supervisor`.

There is no clock here. Whether code blocks is for the `Runner` to say: `DirectRunner` waits for
ever, `service/runtime/process_watchdog` has a deadline.
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

_ALL_TOLD = 10
"""So many errors of a process are told each; after that only each doubling of their number is."""
_LONGEST = 500
"""Characters of an error's text that are kept."""


class UnitBlocked(Exception):
    """A process did not come back within its deadline."""


class ProcessError(Exception):
    """A process gave back what it must not: the message says which field, and what it may be."""


class OnError(StrEnum):
    """What a process declares to happen when it raises."""

    RESTART = "restart"
    """The state is no_value again; it goes on with what comes next, unless that fails too often."""
    SKIP = "skip"
    """What failed gives no sample; the state stays as it was."""
    STOP = "stop"
    """The first error is the last."""


@dataclass(frozen=True, slots=True)
class ErrorRule:
    """``restarts``: how many failures in a row end in a restart; the next one stops the process.
    ``deadline``: ns within which one call must come back; None: it is never watched."""

    on_error: OnError = OnError.RESTART
    restarts: int = 3
    deadline: int | None = 2 * SECOND


class ProcessEvent(StrEnum):
    """What is told of a process. A failure comes first, what the rule made of it second; of a
    failure that was skipped nothing more is told."""

    FAILED = "unit failed"
    RESTARTED = "unit restarted"
    STOPPED = "unit stopped by rule"


Later: TypeAlias = Callable[[Sequence[Failed], int], bool]
"""Called with what failed and how many failures in a row there are now; whether it is to be told by
`Supervisor.hear`, and not now."""
Tell: TypeAlias = Callable[[ProcessEvent, str], None]
"""Called with what happened and a text for people; after the samples made before it went out."""


@dataclass(slots=True)
class ErrorCounters:
    """How often a process failed. ``last_error_time`` is the time (ns) of what it failed on."""

    errors: int = 0
    restarts: int = 0
    last_error: str | None = None
    last_error_time: int | None = None

    def note(self, text: str, time: int | None) -> None:
        """One more error."""
        self.errors += 1
        self.last_error = text
        self.last_error_time = time


class Runner(Protocol):
    """Whoever calls user-written code. ``tape`` has what sources say, where that is recorded."""

    @property
    def tape(self) -> Tape | None: ...

    def run(self, work: Callable[[], T], deadline: int | None, progress: Callable[[], int]) -> T:
        """What ``work()`` gives; what it raises is raised.

        ``work`` makes many calls; ``progress()`` grows with each that came back. Raises
        `UnitBlocked` when it has not grown for ``deadline`` ns. ``work`` may still be running
        then: it writes to nothing that anybody reads any more.
        """


class DirectRunner:
    """Calls, and waits as long as it takes."""

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
class _Made(Generic[Result]):
    result: Result


class Came(NamedTuple):
    """So many ``calls`` came back; the next one, for ``time``, did not: ``blocked`` says so."""

    calls: int
    time: int = 0
    blocked: str | None = None


class Supervisor:
    """Calls a process item by item and answers its failures by its rule.

    ``restart`` makes the process forget its state, ``stop`` takes it out of the network for the
    reason given; ``tell`` hears what happened, last of all. ``later`` may put that off.

    Law: what is made, counted and told does not depend on how the items were cut into runs.

    Contract: a call that was given up by the runner changes nothing here when it comes back.
    """

    def __init__(
        self,
        rule: ErrorRule,
        runner: Runner,
        counters: ErrorCounters,
        restart: Callable[[], None],
        stop: Callable[[str], None],
        tell: Tell,
        later: Later | None = None,
    ) -> None:
        self.rule = rule
        self.counters = counters
        self._later = later
        self._runner = runner
        self._restart = restart
        self._stop = stop
        self._stopped: str | None = None
        self._tell = tell
        self._in_a_row = 0

    def run(
        self,
        items: Sequence[tuple[int, Item]],
        step: Callable[[int, Item], Result],
        deliver: Callable[[Sequence[Result]], None],
    ) -> Came:
        """``step(time, item)`` for each in order; what was made goes to ``deliver``, then what
        went wrong is told. After a stop the rest of the items is left alone.

        Whatever the code raises is an error of the process, SystemExit included; only a person's
        Ctrl-C passes through (`is_interrupt`).
        """
        came = Came(0)
        if self._stopped is not None or not items:
            return came
        log: list[_Made[Result] | _Failure] = []
        row = self._in_a_row

        def work() -> None:
            # Only `log` is shared, and only appended to: whoever gave this up has a copy.
            nonlocal row
            for time, item in items:
                try:
                    log.append(_Made(step(time, item)))
                    row = 0
                except RecordedBlock:
                    raise
                except BaseException as error:  # isolated, counted and reported by the rule
                    if is_interrupt(error):
                        raise
                    row += 1
                    verdict = self._verdict(row)
                    if verdict is _Verdict.RESTARTED:
                        self._restart()
                    log.append(_Failure(time, describe(error), verdict, self._reason(row)))
                    if verdict is _Verdict.STOPPED:
                        return

        try:
            self._runner.run(work, self.rule.deadline, lambda: len(log))
            entries = log
            came = Came(len(entries))
        except UnitBlocked as blocked:
            entries = log.copy()
            came = Came(len(entries))
            if len(entries) < len(items):  # else the last call came back at the last moment
                time = items[len(entries)][0]
                came = Came(len(entries), time, describe(blocked))
                entries.append(_Failure(time, describe(blocked), _Verdict.STOPPED))
        before, self._in_a_row = self._in_a_row, row
        if not self._is_put_off(entries, before):
            self._settle(entries, deliver)
        return came

    def hear(self, failed: Sequence[Failed], in_a_row: int) -> None:
        """Count and tell what was put off, and act upon it."""
        self._in_a_row = in_a_row
        entries = [
            _Failure(one.time, one.text, _Verdict(one.verdict), one.reason) for one in failed
        ]
        self._settle(entries, lambda _: None)

    def _is_put_off(self, entries: Sequence[_Made[Result] | _Failure], before: int) -> bool:
        """Whether what went wrong is told later. It is not called any more then, if it stops."""
        failures = [entry for entry in entries if isinstance(entry, _Failure)]
        if self._later is None or not (failures or self._in_a_row < before):
            return False
        failed = [Failed(one.time, one.text, one.verdict, one.reason) for one in failures]
        if not self._later(failed, self._in_a_row):
            return False
        if failures and failures[-1].verdict is _Verdict.STOPPED:
            self._stopped = failures[-1].text
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
        entries: Sequence[_Made[Result] | _Failure],
        deliver: Callable[[Sequence[Result]], None],
    ) -> None:
        told: list[tuple[ProcessEvent, str]] = []
        for entry in entries:
            if isinstance(entry, _Failure):
                told += self._count(entry)
        # Samples first: who hears of a failure has what was made before it.
        deliver([entry.result for entry in entries if isinstance(entry, _Made)])
        if self._stopped is not None:
            self._stop(self._stopped)
        for event, text in told:
            self._tell(event, text)

    def _count(self, failure: _Failure) -> list[tuple[ProcessEvent, str]]:
        """Count a failure; what is to be told of it."""
        counters = self.counters
        counters.note(failure.text, failure.time)
        count = counters.errors
        is_told = count <= _ALL_TOLD or count & (count - 1) == 0
        events = []
        if is_told or failure.verdict is _Verdict.STOPPED:
            text = f"error {count}: {failure.text}; {failure.verdict}"
            events.append((ProcessEvent.FAILED, text))
        match failure.verdict:
            case _Verdict.SKIPPED:
                pass
            case _Verdict.RESTARTED:
                counters.restarts += 1
                if is_told:
                    events.append((ProcessEvent.RESTARTED, f"restart {counters.restarts}"))
            case _Verdict.STOPPED:
                self._stopped = failure.text + (f" ({failure.reason})" if failure.reason else "")
                events.append((ProcessEvent.STOPPED, self._stopped))
            case _:
                assert_never(failure.verdict)
        return events


@dataclass(slots=True)
class Instance(Generic[T]):
    """The code of one process, made when it is first needed and made anew after a restart.

    A class is instantiated for each process, a function is taken as it is; what the constructor
    raises is an error of the process.
    """

    make: Callable[[], T]
    _made: list[T] = field(default_factory=list)

    def get(self) -> T:
        """The code to call."""
        if not self._made:
            self._made.append(self.make())
        return self._made[0]

    @property
    def is_made(self) -> bool:
        """Whether there is code that may have state."""
        return bool(self._made)

    def forget(self) -> None:
        """The next call goes to a new one."""
        self._made.clear()


class RecordedError(Exception):
    """What went wrong when it was done first; its text is what was said of it then."""


class RecordedBlock(RecordedError, UnitBlocked):
    """It did not come back when it was done first."""


def is_interrupt(error: BaseException) -> bool:
    """Whether ``error`` is a person's Ctrl-C, not something that user-written code raised.

    Python raises it in the main thread, and only while its own handler of SIGINT is installed: the
    service has another one.
    """
    return (
        isinstance(error, KeyboardInterrupt)
        and threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    )


def describe(error: BaseException) -> str:
    """``ZeroDivisionError: division by zero (units.py:12)``: one line that can be sent anywhere.

    An error may refuse to say what it is; then its type must do.
    """
    if isinstance(error, RecordedError):
        return str(error)
    try:
        text = str(error)
    except BaseException as second:  # user code again; the type is reported
        if is_interrupt(second):
            raise
        text = f"(its text cannot be had: {type(second).__name__})"
    kind = type(error).__name__
    whole = f"{kind}: {text}" if text else kind
    if not isinstance(error, ProcessError | UnitBlocked):
        whole += _place(error.__traceback__)
    whole = " ".join(whole.split())
    whole = whole.encode("utf-8", "backslashreplace").decode()
    return whole if len(whole) <= _LONGEST else f"{whole[: _LONGEST - 1]}…"


def _place(trace: TracebackType | None) -> str:
    """`` (file:line)`` of where it was raised."""
    if trace is None:
        return ""
    while trace.tb_next is not None:
        trace = trace.tb_next
    return f" ({Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno})"
