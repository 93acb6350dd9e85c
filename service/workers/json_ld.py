"""Parses JSON-LD of publishers in a worker, and hands it on as N-Quads.

A short text can take minutes (contexts within contexts), and a chain of terms in a context that
are defined by each other overflows the parser's stack, which would end the service. N-Quads are
read in the service's own process; so a restart, which reads the log, never parses JSON-LD.
"""

from __future__ import annotations

from typing import Final

from ...converters.errors import WireError
from ...converters.wire import BatchLimits
from .messages import Failed, Job, ReadJsonLd, Refused, TooMuch, Written
from .pool import Busy, Pool
from .worker import PATIENCE, End, NoWorker, WorkerError

SECONDS: Final = 10.0
"""Of processor time: twice what a million statements of the usual form take."""
_OVERHEAD: Final = 1 << 16


class IsolatedJsonLd:
    """Parses JSON-LD in workers of ``pool``, within the limits of a batch."""

    def __init__(self, pool: Pool, limits: BatchLimits) -> None:
        self._pool = pool
        self._limits = limits

    async def nquads(self, text: bytes, sender: str) -> bytes:
        """Return the statements as N-Quads, with blank nodes by order of appearance.

        Raises `WireError` for what is no JSON-LD, names a remote context or exceeds a limit, and
        `Busy`.
        """
        most, size = self._limits.samples, self._limits.decoded
        work = Job(ReadJsonLd(text, most, size), SECONDS)
        try:
            answer = await self._pool.run(
                lambda worker: worker.call(work, size + _OVERHEAD, patience=PATIENCE),
                PATIENCE * SECONDS,
                sender,
            )
        except NoWorker as error:
            raise Busy from error
        except WorkerError as error:
            hint = "give the document one context" if error.end is End.DEADLINE else ""
            raise WireError(
                None,
                f"reading the text was stopped: {error}",
                hint or "send N-Quads, or simplify its context",
            ) from error
        match answer:
            case Written(body):
                return body
            case Refused(message, hint, line, column):
                place = "" if column is None else f"column {column}: "
                raise WireError(line, f"{place}{message}", hint)
            case TooMuch(what, limit):
                raise WireError(None, f"a batch has at most {limit} {what}", "send several batches")
            case Failed(message):
                raise WireError(None, message)
        raise WireError(None, "the worker gave an answer of another kind")
