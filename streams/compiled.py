"""Loops that numpy has no word for, compiled by numba.

With ``NUMBA_DISABLE_JIT=1`` or ``DYKNOW_JIT=off`` whoever has such a loop takes another way, with
the same results.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

JIT = os.environ.get("NUMBA_DISABLE_JIT", "0") in ("", "0") and (
    os.environ.get("DYKNOW_JIT", "on").lower() not in ("off", "0", "false")
)
"""Whether loops are compiled."""


class Kernel:
    """A function with an explicit numba signature, compiled on the first call and kept in numba's
    cache; ``py_func`` is the same in plain Python, where integers do not overflow."""

    def __init__(self, py_func: Callable[..., Any], signature: Callable[[], Any]) -> None:
        self.py_func = py_func
        self.signature = signature
        self._compiled: Callable[..., Any] | None = None

    def __call__(self, *arguments: Any) -> Any:
        if self._compiled is None:
            # Imported here: numba takes half a second that a service without queries can save.
            from numba import njit

            try:
                self._compiled = njit(self.signature(), cache=True, nogil=True)(self.py_func)
            except RuntimeError:
                # No directory to cache in (a read-only root without a home): compile each start.
                self._compiled = njit(self.signature(), nogil=True)(self.py_func)
        return self._compiled(*arguments)
