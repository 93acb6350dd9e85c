"""Loops that numpy cannot express, compiled by numba.

With ``NUMBA_DISABLE_JIT=1`` or ``DYKNOW_JIT=off`` each caller takes another way to the same result.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from threading import RLock
from typing import Any

JIT = os.environ.get("NUMBA_DISABLE_JIT", "0") in ("", "0") and (
    os.environ.get("DYKNOW_JIT", "on").lower() not in ("off", "0", "false")
)
"""Whether loops are compiled."""


_COMPILING = RLock()
_KERNELS: list[Kernel] = []


class Kernel:
    """A function with an explicit numba signature, compiled on the first call and kept in numba's
    cache; ``py_func`` is the same in plain Python, where integers do not overflow.

    ``allocates`` False: the function makes no arrays, and numba does not count references to those
    it has. ``calls``: the plain functions that it calls, those of other modules, too. They are
    compiled into it: an argument that is a tuple of arrays costs some 10 ns for each array in a
    call that is one, which is more than most of these functions do.
    """

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

    def compile(self) -> Callable[..., Any]:
        """The compiled function: made now, read from the cache, or known already."""
        with _COMPILING:
            if self._compiled is None:
                # Imported here: it takes half a second, which many commands never need.
                from numba import njit
                from numba.extending import register_jitable

                for function in self._calls:
                    register_jitable(forceinline=True)(function)
                if self._calls:
                    _renew(Path(self.py_func.__code__.co_filename))
                try:
                    self._compiled = njit(self.signature(), cache=True, **self._options)(
                        self.py_func
                    )
                except RuntimeError:
                    # No directory for the cache (a read-only root, no home): compile at each start.
                    self._compiled = njit(self.signature(), **self._options)(self.py_func)
            return self._compiled


def _renew(source: Path) -> None:
    """Give a module the time of the newest one in its folder and the folders beside it: numba's
    cache compares the time of the module only, and its loops have code of others in them."""
    newest = max(each.stat().st_mtime_ns for each in source.parents[1].rglob("*.py"))
    if newest > source.stat().st_mtime_ns:
        # Where nothing can be written, nobody changes modules one by one.
        with suppress(OSError):
            os.utime(source, ns=(newest, newest))


def _ignore(_done: int, _count: int) -> None:
    """Report no progress."""


def compile_all(tell: Callable[[int, int], None] = _ignore) -> None:
    """Compile every loop of the imported modules, one after the other; call ``tell`` with the
    number done and the number of all.

    The first time this takes a minute, later 30 ms a loop to read the cache. A thread does it
    while a service starts; a caller that needs a loop earlier waits for that one only.
    """
    if JIT:
        for done, kernel in enumerate(_KERNELS, start=1):
            kernel.compile()
            tell(done, len(_KERNELS))
