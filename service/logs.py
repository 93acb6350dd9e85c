"""Structured logs: one line a request at debug, failures at error with their trace.

The lines go through the standard library's logger ``dyknow``: whoever runs the application inside
something else decides where they go. `configure` is for the service's own process.
"""

from __future__ import annotations

import logging
import sys
from typing import Final

import structlog

LOG_NAME: Final = "dyknow"

_SHARED: tuple[structlog.types.Processor, ...] = (
    structlog.stdlib.add_log_level,
    structlog.processors.TimeStamper(fmt="iso", utc=True),
)
_LOG: structlog.stdlib.BoundLogger = structlog.wrap_logger(
    logging.getLogger(LOG_NAME),
    processors=[
        structlog.stdlib.filter_by_level,
        *_SHARED,
        structlog.stdlib.ProcessorFormatter.wrap_for_formatter,
    ],
    wrapper_class=structlog.stdlib.BoundLogger,
    context_class=dict,
)


def log() -> structlog.stdlib.BoundLogger:
    """The service's logger."""
    return _LOG


def configure(level: str, as_json: bool) -> None:
    """Send the service's and uvicorn's logs to standard error, one line an event."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=_SHARED,
            processors=[
                structlog.stdlib.ProcessorFormatter.remove_processors_meta,
                *_rendering(as_json),
            ],
        )
    )
    number = getattr(logging, level.upper())
    for name in (LOG_NAME, "uvicorn"):
        logger = logging.getLogger(name)
        logger.handlers = [handler]
        logger.propagate = False
        # uvicorn tells of every start and connection at info, and warns of every client that does
        # not speak HTTP, which whoever likes may write a log full of; metrics count those.
        logger.setLevel(number if name == LOG_NAME else max(number, logging.ERROR))


def _rendering(as_json: bool) -> list[structlog.types.Processor]:
    if as_json:
        return [structlog.processors.format_exc_info, structlog.processors.JSONRenderer()]
    # The usual formatter prints the variables of every frame, headers with tokens among them.
    plain = structlog.dev.plain_traceback
    return [structlog.dev.ConsoleRenderer(colors=sys.stderr.isatty(), exception_formatter=plain)]
