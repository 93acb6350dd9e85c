"""Parses specifications in XML (`languages.specification`) in a worker.

The longest text takes half a second, which would block the event loop. And libxml2 is C code with a
history of exploits, which must not run in the service's own process.
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
from .worker import PATIENCE, End, NoWorker, WorkerError
from .xml_elements import specification_of

SECONDS: Final = 5.0
"""Of processor time: ten times what the longest text takes."""
_BYTES: Final = 4 << 20


class IsolatedSpecifications:
    """Parses specifications in workers of ``pool``."""

    def __init__(self, pool: Pool) -> None:
        self._pool = pool

    async def read(self, text: bytes) -> Specification:
        """Parse a text within limits (`parse_specification`). Raises `LanguageError`, also if the
        text exceeds a limit, and `Busy`."""
        source = decode(text)
        work = Job(ReadSpecification(source, MOST_PARTS, MOST_ELEMENTS), SECONDS)
        try:
            answer = await self._pool.run(
                lambda worker: worker.call(work, _BYTES, patience=PATIENCE), PATIENCE * SECONDS
            )
            return await anyio.to_thread.run_sync(_read, answer, source)
        except NoWorker as error:
            raise Busy from error
        except (WorkerError, BadAnswer) as error:
            is_slow = isinstance(error, WorkerError) and error.end is End.DEADLINE
            hint = "" if is_slow else "send it in several parts"
            raise LanguageError(
                f"reading the text was stopped: {error}", source, Span(0, 0), hint
            ) from error


def _read(answer: Answer, source: str) -> Specification:
    match answer:
        case Elements(rows):
            return specification_of(rows, source)
        case Misread(message, hint, start, end):
            if not 0 <= start <= end <= len(source):
                raise BadAnswer("a position outside of the text")
            raise LanguageError(message, source, Span(start, end), hint)
        case TooMuch(what, limit):
            raise LanguageError(
                f"the text has more than {limit} {what}",
                source,
                Span(0, 0),
                "send it in several parts: a `stream` element can read insertions of earlier parts "
                "(dyknow.Client and `dyknow specification apply` split texts automatically)",
            )
        case Failed(message):
            raise LanguageError(message, source, Span(0, 0))
    raise BadAnswer("an answer of another kind than the job")
