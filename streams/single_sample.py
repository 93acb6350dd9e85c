"""A single sample as a Python object: for user-written units, which are an edge of the system."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from .sample import Value


@dataclass(frozen=True, slots=True)
class Sample:
    """⟨t_a, t_v, v⟩ ([DyKnow10 Def. 5.3]); `None` where one is expected is no_sample.

    ``values`` are the named values, None for no_value. ``available`` None leaves the stamp to the
    system. A stream of a simple value sort has one field, and `value` is what it holds.
    """

    valid: int
    values: Mapping[str, Value] = field(default_factory=dict)
    available: int | None = None

    @property
    def value(self) -> Value:
        """The value of the only field; raises `ValueError` where there are several."""
        if len(self.values) != 1:
            names = ", ".join(self.values) or "none"
            raise ValueError(f"this sample has {len(self.values)} fields ({names}): name one")
        return next(iter(self.values.values()))

    def __getitem__(self, name: str) -> Value:
        return self.values[name]
