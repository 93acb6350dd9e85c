"""How a continuous query is to be read where the text leaves it open."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

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
