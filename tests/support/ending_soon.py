"""What must not take long, in units of what this machine does at this time: no test depends on its
speed."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

COUNTED = 200_000


def unit() -> float:
    """The processor time of a loop that counts; some 10 ms."""
    begun, counted = time.process_time(), 0
    while counted < COUNTED:
        counted += 1
    return time.process_time() - begun


@contextmanager
def ends_within(units: float) -> Iterator[None]:
    """Fail where the block takes more processor time than so many units, taken before it and
    after it."""
    before = unit()
    begun = time.process_time()
    yield
    took = time.process_time() - begun
    assert took < units * max(before, unit())
