"""Runs long read-only work on a fork of the process: a snapshot of its memory.

    result = snapshots.take(work)     # takes some milliseconds, however long ``work`` takes
    result()                          # waits for the result of ``work``, in any thread

The kernel copies a page of memory when one of the two processes writes to it. So the service goes
on while the fork pickles gigabytes. Only the calling thread exists in the fork. A lock that another
thread holds at the fork stays locked there for ever, and its data may be half changed; ``work``
must not wait for such a lock, and opens its files anew. The fork ends with its parent thread.
"""

from __future__ import annotations

import ctypes
import gc
import os
import pickle
import select
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext, suppress
from typing import Any, Final, NoReturn, TypeVar

from ...engine.durability.checkpoint import CheckpointError
from ..config.oom_priority import be_dispensable

T = TypeVar("T")

IS_SUPPORTED: Final = sys.platform == "linux"
"""On other systems, forking a process with threads is unreliable."""
_TIMEOUT: Final = 300.0
"""Seconds that a fork may take."""
_NICE: Final = 5
"""The fork's niceness: the service comes first."""
_DIES_WITH_PARENT: Final = 1
"""PR_SET_PDEATHSIG of Linux' prctl(2)."""
_NO_LOCK: Final = nullcontext()


class SnapshotError(CheckpointError):
    """The fork failed or died. The caller may run the work in this process instead."""


class Snapshots:
    """Forks of this process, one at a time."""

    def __init__(self, timeout: float = _TIMEOUT) -> None:
        self._timeout = timeout
        self._prctl = ctypes.CDLL(None, use_errno=True).prctl if IS_SUPPORTED else None
        self._lock = threading.Lock()
        self._child = 0
        """The process id of the fork; 0: none."""

    def take(
        self, work: Callable[[], T], lock: AbstractContextManager[object] = _NO_LOCK
    ) -> Callable[[], T]:
        """Begin ``work`` in a fork, and return a function that waits for it. The function returns
        the result of ``work`` or raises its error, both pickled.

        ``lock`` guards the data that ``work`` reads and other threads change. The fork happens
        while this thread holds it, so the data are consistent and the lock is free in the fork.
        Both raise `SnapshotError` if the fork fails.
        """
        parent = os.getpid()
        try:
            reader, writer = os.pipe()
        except OSError as error:
            raise _cannot_fork(error) from error
        try:
            with lock:
                child = os.fork()
        except OSError as error:
            os.close(reader)
            os.close(writer)
            raise _cannot_fork(error) from error
        if not child:
            self._run_in_fork(work, writer, parent)
        os.close(writer)
        with self._lock:
            self._child = child
        return lambda: self._result(reader, child)

    def kill(self) -> None:
        """Kill the fork, if there is one: the service stops."""
        with self._lock:
            if self._child:
                _kill(self._child)

    def _run_in_fork(self, work: Callable[[], Any], writer: int, parent: int) -> NoReturn:
        """Run ``work`` in the fork, send its result, and exit."""
        status = 1
        try:
            assert self._prctl is not None
            self._prctl(_DIES_WITH_PARENT, signal.SIGKILL)
            # The parent may have ended before the call above, which then sends no signal.
            if os.getppid() != parent:
                os._exit(1)
            # The directory's lock and all connections must close with the service, not later.
            last = max(map(int, os.listdir("/proc/self/fd")))
            os.closerange(3, writer)
            os.closerange(writer + 1, last + 1)
            # A terminal signals both processes, and the service kills the fork when it stops.
            for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                signal.signal(each, signal.SIG_IGN)
            # A collection writes to objects everywhere, and the kernel would copy their pages.
            gc.disable()
            os.nice(_NICE)
            be_dispensable()
            with os.fdopen(writer, "wb") as target:
                try:
                    answer = True, work()
                except Exception as error:  # noqa: BLE001  `_result` raises it again
                    answer = False, error
                target.write(pickle.dumps(answer))
            status = 0
        finally:
            # Never return into the code of the service.
            os._exit(status)

    def _result(self, reader: int, child: int) -> Any:
        data = None
        try:
            data = self._read(reader)
        finally:
            os.close(reader)
            # A fork that has sent its result exits by itself.
            status = self._reap(child, kill=data is None)
        if data is None:
            raise SnapshotError(f"a fork of the process took more than {self._timeout:g} s")
        try:
            is_done, result = pickle.loads(data)
        except Exception as error:  # the data are cut off, or its exception cannot be unpickled
            reason = "" if not data else f": {type(error).__name__}: {error}"
            raise SnapshotError(f"a fork of the process has died ({status}){reason}") from error
        if not is_done:
            raise result
        return result

    def _reap(self, child: int, *, kill: bool) -> int:
        """Wait for the end of ``child``, and return its exit code."""
        with self._lock:
            if kill:
                _kill(child)
            try:
                _, status = os.waitpid(child, 0)
            except ChildProcessError:  # the parent process set SIGCHLD to be ignored
                status = 0
            # The id is free for other processes now. The lock keeps `kill` from using it.
            self._child = 0
        return os.waitstatus_to_exitcode(status)

    def _read(self, reader: int) -> bytes | None:
        """Read until the end; None after the timeout."""
        # `select` fails for descriptors from 1024 on, and each connection has a descriptor.
        ready = select.poll()
        ready.register(reader, select.POLLIN)
        until = time.monotonic() + self._timeout
        parts: list[bytes] = []
        while True:
            left = until - time.monotonic()
            if left <= 0 or not ready.poll(left * 1000):
                return None
            part = os.read(reader, 1 << 16)
            if not part:
                return b"".join(parts)
            parts.append(part)


def _kill(child: int) -> None:
    with suppress(ProcessLookupError):  # it has ended already
        os.kill(child, signal.SIGKILL)


def _cannot_fork(error: OSError) -> SnapshotError:
    return SnapshotError(f"cannot fork the process: {error}")
