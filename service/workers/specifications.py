"""Specifications in XML (`languages.specification`), read in a worker, with their schema.

The longest text takes half a second, and libxml2 is C that strangers have broken before: neither is
for the process in which everybody else waits.
"""

from __future__ import annotations

from typing import Final

import anyio.to_thread

from ...languages.errors import LanguageError, Span
from ...languages.specification import Specification
from ...languages.specification.decoding import decode
from ..config.text_bounds import MOST_ELEMENTS, MOST_PARTS
from .messages import (
    Answer,
    BadAnswer,
    Elements,
    Failed,
    Job,
    Misread,
    ReadSpecification,
    TooMuch,
)
from .pool import Busy, Pool
from .worker import NoWorker, TookTooLong, WorkerError
from .xml_elements import specification_of

SECONDS: Final = 5.0
"""Ten times what the longest text takes."""
_BYTES: Final = 4 << 20


class IsolatedSpecifications:
    """Reads specifications by workers of ``pool``."""

    def __init__(self, pool: Pool) -> None:
        self._pool = pool

    async def read(self, text: bytes) -> Specification:
        """As `parse_specification` does, with bounds; raises `LanguageError`, also for a text that
        needs too much, and `Busy`."""
        source = decode(text)
        work = Job(ReadSpecification(source, MOST_PARTS, MOST_ELEMENTS), SECONDS)
        try:
            answer = await self._pool.run(lambda worker: worker.call(work, _BYTES), 2 * SECONDS)
            return await anyio.to_thread.run_sync(_read, answer, source)
        except NoWorker as error:
            raise Busy from error
        except (WorkerError, BadAnswer) as error:
            hint = "" if isinstance(error, TookTooLong) else "send it in several parts"
            raise LanguageError(
                f"reading the text was stopped: {error}", source, Span(0, 0), hint
            ) from error


def _read(answer: Answer, source: str) -> Specification:
    match answer:
        case Elements(rows):
            return specification_of(rows, source)
        case Misread(message, hint, start, end):
            if not 0 <= start <= end <= len(source):
                raise BadAnswer("a place that is not in the text")
            raise LanguageError(message, source, Span(start, end), hint)
        case TooMuch(what, limit):
            raise LanguageError(
                f"the text has more than {limit} {what}",
                source,
                Span(0, 0),
                "send it in several parts: what one inserts, the next can read by `stream` "
                "(dyknow.Client and `dyknow specification apply` do so by themselves)",
            )
        case Failed(message):
            raise LanguageError(message, source, Span(0, 0))
    raise BadAnswer("another answer than was asked for")
