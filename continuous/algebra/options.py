"""Options of a continuous query that its text does not state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

Semantics = Literal["bag", "set"]
Bounds = Literal["(]", "[)"]
Report = Literal["non-empty", "change", "close"]


@dataclass(frozen=True, slots=True)
class Options:
    """``semantics``: equal triples of a window count each ("bag") or once ("set").

    ``bounds``: a window with end e is ``(e - RANGE, e]`` or ``[e - RANGE, e)``. ``origin`` (ns):
    ends are ``origin + k * STEP``. ``report``: an evaluation gives a result if it has content
    ("non-empty"), if its content differs from that of the last evaluation ("change"), or always,
    from the first content on ("close").
    """

    semantics: Semantics = "bag"
    bounds: Bounds = "(]"
    origin: int = 0
    report: Report = "non-empty"

    def __post_init__(self) -> None:
        for name, known in (("semantics", Semantics), ("bounds", Bounds), ("report", Report)):
            value = getattr(self, name)
            if value not in get_args(known):
                words = [repr(word) for word in get_args(known)]
                listed = f"{', '.join(words[:-1])} or {words[-1]}"
                raise ValueError(f"{name} is {listed}, not {value!r}")
