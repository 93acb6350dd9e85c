"""The rules by which a program orders and adapts the samples of a stream
(docs/reference/data-directory.md).

Rules 1, up to DyKnow 0.1: available times are unique. A row with a taken available time is a
duplicate, and samples of one moment stand 1 ns apart. A policy is of the whole stream. Rules 2:
samples that share an available time are one instant, ordered by their sequence numbers, and a
policy of an annotated stream holds for each object by itself (SPEC §1). The journal records which
rules hold, so that recovery repeats the commands of an earlier program by the rules of that
program.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

UNIQUE_TIMES: Final = 1
INSTANTS: Final = 2


@dataclass(slots=True)
class Rules:
    """The rules that hold now. All generators of an engine share one object, which recovery
    changes between two commands."""

    version: int = INSTANTS

    @property
    def gap(self) -> int:
        """The least distance (ns) between the available times of two samples of a stream."""
        return 1 if self.version == UNIQUE_TIMES else 0

    @property
    def separates_objects(self) -> bool:
        """Whether a policy of an annotated stream holds for each object by itself."""
        return self.version != UNIQUE_TIMES
