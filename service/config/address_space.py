"""The memory of this process: its size, and a limit on what it may allocate (Linux).

psutil reads the size, too, but no control groups (`memory_limit.available_memory`), and importing
it takes 12 ms of each worker.
"""

from __future__ import annotations

import resource
from typing import Final, NamedTuple

_PAGE: Final = resource.getpagesize()


class ProcessSize(NamedTuple):
    """Bytes of addresses, and of memory that is taken now."""

    addresses: int
    resident: int


def process_size() -> ProcessSize:
    """The size of this process."""
    with open("/proc/self/statm", "rb") as file:
        addresses, resident, *_ = file.read().split()
    return ProcessSize(int(addresses) * _PAGE, int(resident) * _PAGE)


def limit_address_space(more: int) -> None:
    """Limit this process to ``more`` bytes beside what it has. Beyond it an allocation fails."""
    most = process_size().addresses + more
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
