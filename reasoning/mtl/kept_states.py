"""The states that an evaluator of formulas keeps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...streams.sample import Mask, Times
from ..states.states import States, Values


@dataclass(frozen=True, slots=True, eq=False)
class KeptStates:
    """States kept, as one `States`; for each whether the verdict of a binding is out, and when it
    left."""

    states: States
    is_decided: Mask
    left: Times

    def take(self, rows: Any) -> KeptStates:
        return KeptStates(
            self.states.take(rows),
            self.is_decided[rows],
            self.left[rows],
        )

    def followed_by(self, new: KeptStates) -> KeptStates:
        """These states, and new ones after them, which may have further objects."""
        kept, states = self.states, new.states
        values = {
            term: Values(
                _extended(kept.values[term].values, part.values),
                _extended(kept.values[term].known, part.known),
            )
            for term, part in states.values.items()
        }
        return KeptStates(
            States(
                np.concatenate([kept.valid, states.valid]),
                np.concatenate([kept.horizon, states.horizon]),
                states.objects,
                {s: _extended(kept.present[s], part) for s, part in states.present.items()},
                values,
            ),
            _extended(self.is_decided, new.is_decided),
            np.concatenate([self.left, new.left]),
        )


def _extended(kept: NDArray[Any], new: NDArray[Any]) -> NDArray[Any]:
    """Rows kept, with the columns that new objects added, and new rows after them."""
    if kept.shape[1:] != new.shape[1:]:
        more = zip(kept.shape[1:], new.shape[1:], strict=True)
        kept = np.pad(kept, [(0, 0), *((0, n - k) for k, n in more)])
    return np.concatenate([kept, new])
