"""Structured logs: a line a request at debug, failures at error with their traceback. A line that
belongs to a request has its id; no line has a token.

The lines go to the standard library's logger ``dyknow``, so a program that embeds the application
configures them. `configure` is for the service's own process.
"""

from __future__ import annotations

import logging
import re
import sys
import threading
from contextvars import ContextVar
from types import TracebackType
from typing import Any, Final

import structlog

LOG_NAME: Final = "dyknow"

REQUEST: Final[ContextVar[str | None]] = ContextVar("dyknow_request", default=None)
"""The id of the request that is being answered."""
_SECRETS: Final = re.compile(
    r"(dyk_)[\w-]{16,}|(\bbearer\s+)[\w.~+/=-]+|(\b\w*token=)[^&\s\"'\\]+", re.IGNORECASE
)
"""Tokens with the service's prefix, and texts where a token usually stands."""


def _with_request(_logger: Any, _name: str, line: structlog.types.EventDict) -> dict[str, Any]:
    id = REQUEST.get()
    if id is not None:
        line.setdefault("request", id)
    return dict(line)


def mask(text: str) -> str:
    """The text with tokens masked: errors may quote a request."""
    return _SECRETS.sub(lambda found: f"{found[1] or found[2] or found[3]}***", text)


def _without_secrets(_logger: Any, _name: str, line: Any) -> str:
    return mask(str(line))


_SHARED: tuple[structlog.types.Processor, ...] = (
    _with_request,
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
    """Send all logs of this process to standard error, a line an event: those of the service and of
    uvicorn, others from warnings on, Python's warnings, and exceptions that end a thread."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=_SHARED,
            processors=[
                structlog.stdlib.ProcessorFormatter.remove_processors_meta,
                *_rendering(as_json),
                _without_secrets,
            ],
        )
    )
    number = getattr(logging, level.upper())
    root = logging.getLogger()
    root.handlers = [handler]
    root.setLevel(max(number, logging.WARNING))
    logging.captureWarnings(True)
    threading.excepthook = _thread_failed
    sys.excepthook = _failed
    for name in (LOG_NAME, "uvicorn"):
        logger = logging.getLogger(name)
        logger.handlers = [handler]
        logger.propagate = False
        # uvicorn logs every start and connection at info, and warns of every client that does not
        # speak HTTP. Any client could fill the log with these; metrics count them.
        logger.setLevel(number if name == LOG_NAME else max(number, logging.ERROR))


def _failed(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Log an exception that ends the process."""
    log().critical("failed", exc_info=(kind, error, trace))


def _thread_failed(failure: threading.ExceptHookArgs) -> None:
    name = None if failure.thread is None else failure.thread.name
    trace = (failure.exc_type, failure.exc_value, failure.exc_traceback)
    log().error("thread failed", thread=name, exc_info=trace)


def _rendering(as_json: bool) -> list[structlog.types.Processor]:
    if as_json:
        return [structlog.processors.format_exc_info, structlog.processors.JSONRenderer()]
    # The usual formatter prints the variables of every frame, such as headers with tokens.
    plain = structlog.dev.plain_traceback
    return [structlog.dev.ConsoleRenderer(colors=sys.stderr.isatty(), exception_formatter=plain)]
