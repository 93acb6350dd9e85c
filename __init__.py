"""DyKnow: semantic stream reasoning.

People say what they want to know; the system finds or builds the streams that answer it.
The rooms and the way of a sample are described in ARCHITECTURE.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .continuous.evaluate import evaluate as evaluate
    from .service.client import Client as Client

__version__ = "0.1.0"
__all__ = ["Client", "__version__", "evaluate"]


def __getattr__(name: str) -> Any:
    """`evaluate` and `Client`, imported when first used: each needs only its own half."""
    if name == "evaluate":
        from .continuous.evaluate import evaluate

        return evaluate
    if name == "Client":
        from .service.client import Client

        return Client
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
