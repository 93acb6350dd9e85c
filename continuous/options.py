"""How a continuous query is to be read where the text leaves it open."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

Semantics = Literal["bag", "set"]
Bounds = Literal["(]", "[)"]


@dataclass(frozen=True, slots=True)
class Options:
    """``semantics``: whether equal triples of a window count each ("bag") or once ("set").

    ``bounds``: a window with end e is ``(e - RANGE, e]`` or ``[e - RANGE, e)``. ``origin`` (ns):
    ends are ``origin + k * STEP``.
    """

    semantics: Semantics = "bag"
    bounds: Bounds = "(]"
    origin: int = 0

    def __post_init__(self) -> None:
        if self.semantics not in get_args(Semantics):
            raise ValueError(f"semantics is 'bag' or 'set', not {self.semantics!r}")
        if self.bounds not in get_args(Bounds):
            raise ValueError(f"bounds is '(]' or '[)', not {self.bounds!r}")
