"""``dyknow demo``: the scenario of [Events14 §V.C], from nothing to events."""

from __future__ import annotations


def demo() -> None:
    """Replay five minutes of recorded flights, and find events in them."""
    from .demonstration import show

    show()
