"""What takes long and changes nothing, done on a copy of the process as it is at this moment.

    found = snapshots.take(work)      # some milliseconds, however long ``work`` takes
    found()                           # what it gives, in any thread

The copy is a fork: the kernel copies a page of memory when one of the two writes into it. So the
service goes on while the copy pickles gigabytes. Only the thread that asked is in the copy: it must
not wait for another one, and opens its files anew. What another thread has locked at that moment is
locked there for ever, and half changed. It ends with the thread that asked.
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

CAN: Final = sys.platform == "linux"
"""Elsewhere a fork of a process with threads is not to be relied on."""
_PATIENCE: Final = 300.0
"""Seconds that a copy may take."""
_NICE: Final = 5
"""It gives way to the service."""
_DIES_WITH_PARENT: Final = 1
"""PR_SET_PDEATHSIG of Linux' prctl(2)."""
_FREE: Final = nullcontext()


class SnapshotError(CheckpointError):
    """There is no copy, or it has died: the work may be tried in this process."""


class Snapshots:
    """Copies of this process, one at a time."""

    def __init__(self, patience: float = _PATIENCE) -> None:
        self._patience = patience
        self._prctl = ctypes.CDLL(None, use_errno=True).prctl if CAN else None
        self._lock = threading.Lock()
        self._child = 0
        """The process at work; 0: none."""

    def take(
        self, work: Callable[[], T], lock: AbstractContextManager[object] = _FREE
    ) -> Callable[[], T]:
        """Begin ``work`` in a copy; gives what waits for what it gives or raises, both pickled.

        ``lock``: under which other threads change what ``work`` reads. The copy is made while none
        of them has it, and nobody has it there. Raises `SnapshotError` where there can be no copy,
        and so does what waits.
        """
        parent = os.getpid()
        try:
            reader, writer = os.pipe()
        except OSError as error:
            raise _no_room(error) from error
        try:
            with lock:
                child = os.fork()
        except OSError as error:
            os.close(reader)
            os.close(writer)
            raise _no_room(error) from error
        if not child:
            self._be_copy(work, writer, parent)
        os.close(writer)
        with self._lock:
            self._child = child
        return lambda: self._found(reader, child)

    def end(self) -> None:
        """End the copy that is at work: nobody waits for it any more, or soon nobody will."""
        with self._lock:
            if self._child:
                _kill(self._child)

    def _be_copy(self, work: Callable[[], Any], writer: int, parent: int) -> NoReturn:
        """In the copy: nothing that is the service's is touched, and nothing outlives it."""
        status = 1
        try:
            assert self._prctl is not None
            self._prctl(_DIES_WITH_PARENT, signal.SIGKILL)
            if os.getppid() != parent:
                os._exit(1)
            # The service's lock, connections and files end with the service, not with this.
            last = max(map(int, os.listdir("/proc/self/fd")))
            os.closerange(3, writer)
            os.closerange(writer + 1, last + 1)
            for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                signal.signal(each, signal.SIG_IGN)
            gc.disable()
            os.nice(_NICE)
            be_dispensable()
            with os.fdopen(writer, "wb") as target:
                try:
                    answer = True, work()
                except Exception as error:  # noqa: BLE001  raised again where it is waited for
                    answer = False, error
                target.write(pickle.dumps(answer))
            status = 0
        finally:
            # However it ends: what follows is the service's business.
            os._exit(status)

    def _found(self, reader: int, child: int) -> Any:
        data = None
        try:
            data = self._read(reader)
        finally:
            os.close(reader)
            # One that has said all is about to end, or has.
            status = self._ended(child, kill=data is None)
        if data is None:
            raise SnapshotError(f"a copy of the process took more than {self._patience:g} s")
        try:
            is_done, found = pickle.loads(data)
        except Exception as error:  # it has not come to its end, or raised what cannot be read
            told = "" if not data else f": {type(error).__name__}: {error}"
            raise SnapshotError(f"a copy of the process has died ({status}){told}") from error
        if not is_done:
            raise found
        return found

    def _ended(self, child: int, *, kill: bool) -> int:
        """Wait until ``child`` is gone; its exit code."""
        with self._lock:
            if kill:
                _kill(child)
            try:
                _, status = os.waitpid(child, 0)
            except ChildProcessError:  # who started the service has it ignore the ends of children
                status = 0
            self._child = 0
        return os.waitstatus_to_exitcode(status)

    def _read(self, reader: int) -> bytes | None:
        """What it says until its end; None: it has not come to an end."""
        # Not `select`, which takes no descriptor from 1024 on: each connection has one.
        ready = select.poll()
        ready.register(reader, select.POLLIN)
        until = time.monotonic() + self._patience
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
    with suppress(ProcessLookupError):  # it has just ended, and is not waited for
        os.kill(child, signal.SIGKILL)


def _no_room(error: OSError) -> SnapshotError:
    return SnapshotError(f"there is no room for a copy of the process: {error}")
