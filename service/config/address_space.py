"""A limit on the memory that a process may allocate."""

from __future__ import annotations

import resource


def limit_address_space(more: int) -> None:
    """Limit this process to ``more`` bytes beside what it has. Beyond it an allocation fails."""
    with open("/proc/self/statm", "rb") as file:
        most = int(file.read().split()[0]) * resource.getpagesize() + more
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
