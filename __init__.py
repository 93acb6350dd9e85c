"""DyKnow: semantic stream reasoning.

People say what they want to know; the system finds or builds the streams that answer it.
The rooms and the way of a sample are described in ARCHITECTURE.md.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .service.config.version import __version__

if TYPE_CHECKING:
    from .continuous.evaluate import evaluate as evaluate
    from .converters.recordings.table_options import TableOptions as TableOptions
    from .engine.model.process_reports import Report as Report
    from .engine.processes.registry import computational_unit as computational_unit
    from .engine.processes.registry import sink as sink
    from .engine.processes.registry import source as source
    from .engine.recorded_run import run as run
    from .rdf.terms_to_columns import timed_triples as timed_triples
    from .service.client.client import AsyncClient as AsyncClient
    from .service.client.client import Client as Client
    from .streams.single_sample import Sample as Sample

__all__ = [
    "AsyncClient",
    "Client",
    "Report",
    "Sample",
    "TableOptions",
    "__version__",
    "computational_unit",
    "evaluate",
    "run",
    "sink",
    "source",
    "timed_triples",
]

_WHERE = {
    "AsyncClient": "service.client.client",
    "Client": "service.client.client",
    "Report": "engine.model.process_reports",
    "Sample": "streams.single_sample",
    "TableOptions": "converters.recordings.table_options",
    "computational_unit": "engine.processes.registry",
    "evaluate": "continuous.evaluate",
    "run": "engine.recorded_run",
    "sink": "engine.processes.registry",
    "source": "engine.processes.registry",
    "timed_triples": "rdf.terms_to_columns",
}


def __getattr__(name: str) -> Any:
    """Import a name when it is first used, so that a client does not load the engine."""
    module = _WHERE.get(name)
    if module is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{module}", __name__), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
