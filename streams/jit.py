"""Loops that numpy cannot express, compiled by numba.

With ``NUMBA_DISABLE_JIT=1`` or ``DYKNOW_JIT=off`` each caller takes another way to the same result.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from threading import RLock, Timer
from time import monotonic
from typing import Any, ClassVar, Final

import numpy as np

JIT = os.environ.get("NUMBA_DISABLE_JIT", "0") in ("", "0") and (
    os.environ.get("DYKNOW_JIT", "on").lower() not in ("off", "0", "false")
)
"""Whether loops are compiled."""


_COMPILING = RLock()
_KERNELS: list[Kernel] = []
FEW: Final = 256
"""So many rows need no compiled loop."""
PATIENCE = 0.1
"""Seconds that loops may take in plain Python, all together, before they are compiled."""
NOTICEABLE = 2.0
"""Seconds of compiling after which a notice says so."""


class _Notice:
    """Tells once, while loops are compiled, that this takes long."""

    def __init__(self) -> None:
        self.tell: Callable[[], None] | None = None
        self._spent = 0.0

    def begin(self, tell: Callable[[], None]) -> None:
        self.tell, self._spent = tell, 0.0

    @contextmanager
    def watch(self) -> Iterator[None]:
        if self.tell is None:
            yield
            return
        begun = monotonic()
        timer = Timer(max(0.0, NOTICEABLE - self._spent), self._tell_once)
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
            self._spent += monotonic() - begun

    def _tell_once(self) -> None:
        tell, self.tell = self.tell, None
        if tell is not None:
            tell()


_NOTICE: Final = _Notice()


def when_compiling(tell: Callable[[], None]) -> None:
    """Call ``tell`` once, from another thread, when from now on loops have been compiled for
    `NOTICEABLE` in all."""
    _NOTICE.begin(tell)


class Kernel:
    """A function with an explicit numba signature, compiled on the first call and kept in numba's
    cache; ``py_func`` is the same in plain Python, where integers do not overflow.

    ``allocates`` False: the function makes no arrays, and numba does not count references to those
    it has. ``calls``: the plain functions that it calls, those of other modules, too. They are
    compiled into it: an argument that is a tuple of arrays costs some 10 ns for each array in a
    call that is one, which is more than most of these functions do.
    """

    interpreted: ClassVar[float] = 0.0
    """Seconds that loops took in plain Python."""

    def __init__(
        self,
        py_func: Callable[..., Any],
        signature: Callable[[], Any],
        *,
        allocates: bool = True,
        calls: Sequence[Callable[..., Any]] = (),
    ) -> None:
        self.py_func = py_func
        self.signature = signature
        self._calls = calls
        self._options: dict[str, Any] = {"nogil": True} | ({} if allocates else {"_nrt": False})
        self._compiled: Callable[..., Any] | None = None
        _KERNELS.append(self)

    def __call__(self, *arguments: Any) -> Any:
        compiled = self._compiled or self.compile()
        return compiled(*arguments)

    def run(self, *arguments: Any, size: int = FEW + 1) -> Any:
        """Call it, or ``py_func`` where loops are not compiled.

        ``size``: how much it has to do, in rows or the like. With `FEW` or less it runs in plain
        Python while it is not compiled, as long as there is `PATIENCE`: so that a first result need
        not wait for the compiler."""
        is_compiled = self._compiled is not None or size > FEW or Kernel.interpreted >= PATIENCE
        if JIT and is_compiled:
            return self(*arguments)
        begun = monotonic()
        try:
            with np.errstate(all="ignore"):  # as the compiled loop does
                return self.py_func(*arguments)
        finally:
            Kernel.interpreted += monotonic() - begun

    def compile(self) -> Callable[..., Any]:
        """The compiled function: made now, read from the cache, or known already."""
        with _COMPILING:
            if self._compiled is None:
                # Imported here: it takes half a second, which many commands never need.
                from numba import njit
                from numba.extending import register_jitable

                for function in self._calls:
                    register_jitable(forceinline=True)(function)
                loop = njit(**self._options)(self.py_func)
                try:
                    loop.enable_caching()
                    if self._calls:
                        _depend(loop, _sources(Path(self.py_func.__code__.co_filename).parents[1]))
                except RuntimeError:
                    # No directory for the cache (a read-only root, no home): compile at each start.
                    loop = njit(**self._options)(self.py_func)
                with _NOTICE.watch():
                    loop.compile(self.signature())
                loop.disable_compile()
                self._compiled = loop
            return self._compiled


def _depend(loop: Any, sources: str) -> None:
    """Let what the cache has of a loop be valid for these sources only.

    Numba compares the module of the loop, but code and constants of others are in the loop, too.
    There is no public way to say so.
    """
    file = loop._cache._cache_file
    file._source_stamp = file._source_stamp, sources


@cache
def _sources(folder: Path) -> str:
    """A digest of the modules in a folder and the folders in it."""
    found = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        found.update(path.read_bytes())
    return found.hexdigest()


def _ignore(_done: int, _count: int) -> None:
    """Report no progress."""


def compile_all(tell: Callable[[int, int], None] = _ignore, *, backwards: bool = False) -> None:
    """Compile every loop of the imported modules, one after the other; call ``tell`` with the
    number done and the number of all.

    The first time this takes two minutes, later 30 ms a loop to read the cache. A thread does it
    while a service starts; a caller that needs a loop earlier waits for that one only. Of two
    processes one goes ``backwards``: where they meet, each reads the rest from the cache.
    """
    if JIT:
        kernels = _KERNELS[::-1] if backwards else _KERNELS
        for done, kernel in enumerate(kernels, start=1):
            kernel.compile()
            tell(done, len(_KERNELS))
