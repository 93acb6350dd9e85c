"""Rows that a pattern plan reads, and the matches that it gives, in columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ....streams.sample import Times

Values: TypeAlias = NDArray[np.int64] | NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Rows in order of arrival; each array has shape ``(n,)``.

    ``kind`` is the place of a row's source in ``kinds``; ``start`` and ``end`` are ns. Keys and
    integers of ``columns`` are int64, numbers float64. A column that is left out has no values.
    """

    kinds: tuple[str, ...]
    kind: NDArray[np.int64]
    start: Times
    end: Times
    columns: Mapping[str, Values]

    def __len__(self) -> int:
        return len(self.end)

    def __getitem__(self, part: slice) -> Rows:
        """The rows of a part."""
        columns = {name: values[part] for name, values in self.columns.items()}
        return Rows(self.kinds, self.kind[part], self.start[part], self.end[part], columns)


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Matches in the order in which they were decided.

    ``rows`` has shape ``(m, elements)``: the number of the row of each element, of a Kleene element
    the first; rows are numbered from 0 in order of arrival over all batches. ``decided`` has shape
    ``(m,)``: the time, in ns, from which on no later row changes the match. ``outputs`` has the
    plan's outputs by name, shape ``(m,)``: int64, float64, or arrays of these for `Listed`.
    """

    rows: NDArray[np.int64]
    decided: Times
    outputs: Mapping[str, NDArray[Any]]
    last: NDArray[np.int64]
    """The number of the row that came last, shape ``(m,)``."""

    def __len__(self) -> int:
        return len(self.decided)


def concatenated(parts: Sequence[Matches]) -> Matches:
    """Return the matches of all parts, of which there is at least one, in order."""
    if len(parts) == 1:
        return parts[0]
    # A copy, also of one part among empty ones: the evaluator writes into its tables again.
    return Matches(
        np.concatenate([each.rows for each in parts]),
        np.concatenate([each.decided for each in parts]),
        {name: np.concatenate([each.outputs[name] for each in parts]) for name in parts[0].outputs},
        np.concatenate([each.last for each in parts]),
    )
