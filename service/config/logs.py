"""Structured logs: one line a request at debug, failures at error with their trace; every line that
is written within a request has its id, and none a token.

The lines go through the standard library's logger ``dyknow``: whoever runs the application inside
something else decides where they go. `configure` is for the service's own process.
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
"""Tokens as we make them, and whatever stands where one would."""


def _with_request(_logger: Any, _name: str, line: structlog.types.EventDict) -> dict[str, Any]:
    id = REQUEST.get()
    if id is not None:
        line.setdefault("request", id)
    return dict(line)


def _without_secrets(_logger: Any, _name: str, line: Any) -> str:
    """The line as it is written, less what looks like a token: errors may quote what was sent."""
    return _SECRETS.sub(lambda found: f"{found[1] or found[2] or found[3]}***", str(line))


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
    """Send all logs of this process to standard error, one line an event: the service's, uvicorn's,
    and what others say from warnings on. So are warnings of Python, and what ends a thread."""
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
        # uvicorn tells of every start and connection at info, and warns of every client that does
        # not speak HTTP, which whoever likes may write a log full of; metrics count those.
        logger.setLevel(number if name == LOG_NAME else max(number, logging.ERROR))


def _failed(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Nobody caught it: the process ends."""
    log().critical("failed", exc_info=(kind, error, trace))


def _thread_failed(failure: threading.ExceptHookArgs) -> None:
    name = None if failure.thread is None else failure.thread.name
    trace = (failure.exc_type, failure.exc_value, failure.exc_traceback)
    log().error("thread failed", thread=name, exc_info=trace)


def _rendering(as_json: bool) -> list[structlog.types.Processor]:
    if as_json:
        return [structlog.processors.format_exc_info, structlog.processors.JSONRenderer()]
    # The usual formatter prints the variables of every frame, headers with tokens among them.
    plain = structlog.dev.plain_traceback
    return [structlog.dev.ConsoleRenderer(colors=sys.stderr.isatty(), exception_formatter=plain)]
