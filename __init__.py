"""DyKnow: semantic stream reasoning.

People say what they want to know; the system finds or builds the streams that answer it.
The rooms and the way of a sample are described in ARCHITECTURE.md.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .continuous.evaluate import evaluate as evaluate
    from .engine.processes import computational_unit as computational_unit
    from .engine.processes import sink as sink
    from .engine.processes import source as source
    from .engine.reports import Report as Report
    from .service.client import Client as Client
    from .streams.single import Sample as Sample

__version__ = "0.1.0"
__all__ = [
    "Client",
    "Report",
    "Sample",
    "__version__",
    "computational_unit",
    "evaluate",
    "sink",
    "source",
]

_WHERE = {
    "Client": "service.client",
    "Report": "engine.reports",
    "Sample": "streams.single",
    "computational_unit": "engine.processes",
    "evaluate": "continuous.evaluate",
    "sink": "engine.processes",
    "source": "engine.processes",
}


def __getattr__(name: str) -> Any:
    """Imported when first used: who writes a unit or a client needs only that half."""
    module = _WHERE.get(name)
    if module is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{module}", __name__), name)
