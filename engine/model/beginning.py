"""The beginning of a request's answer: new samples, all retained samples, or a moment in the past
(SPEC §1: a subscription may begin in the past).

Law: a request that begins at a moment gives the same output as one from ``start`` over only the
samples available from that moment on. It therefore reads an instant as a whole or not at all. If
retention has dropped some of these samples, the request is refused (`Forgotten`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import TypeAlias, TypeVar

from ...matching.plan import Supply, UseStream, nodes_of_supply
from ...streams.history import FluentStream
from ...streams.past_queries import Forgotten, Moment
from ...streams.time import TIME_MIN
from .errors import BadArguments
from .views import Since

Beginning: TypeAlias = Since | Moment
T = TypeVar("T")


def parse_beginning(text: str) -> Beginning:
    """Parse the ``since`` of a request; the inverse of ``str``. Raises `BadArguments`."""
    with suppress(ValueError):
        return Since(text)
    moment = Moment.parse(text)
    if moment is None:
        raise BadArguments(
            f"since {text!r} is not now, start, a time or a duration",
            "write start, 2021-10-07T19:12:53Z, or 30s before the newest sample",
        )
    return moment


def resolve_duration(begin: Beginning, read: Iterable[FluentStream]) -> Beginning:
    """Return ``begin`` with a time instead of a duration, which counts back from the newest sample
    of all streams that are ``read``."""
    return begin.among(read) if isinstance(begin, Moment) else begin


def check_retained(begin: Beginning, stream: FluentStream) -> None:
    """Raise `Forgotten` if ``stream`` has dropped samples from the moment ``begin`` on. ``start``
    means all retained samples. Contract: ``begin`` is no duration (`resolve_duration`)."""
    if isinstance(begin, Moment):
        begin.check(stream)


def existing_streams(supplies: Iterable[Supply]) -> tuple[str, ...]:
    """Return the names of the existing streams that the plans ``supplies`` use, each once."""
    nodes = (node for supply in supplies for node in nodes_of_supply(supply))
    return tuple(dict.fromkeys(node.stream for node in nodes if isinstance(node, UseStream)))


def last_before(begin: Beginning) -> int:
    """Return the last available time (ns) whose samples a request from ``begin`` does not read."""
    if not isinstance(begin, Moment):
        return TIME_MIN
    return max(begin.time - 1, TIME_MIN)


def start_from_retained(begin: Beginning, start: Callable[[Beginning], T]) -> T:
    """Call ``start`` with ``begin``, or with the oldest time that all its streams retain if that is
    later. For restoring a request: its samples were retained when it was accepted."""
    while True:
        try:
            return start(begin)
        except Forgotten as error:
            if error.oldest is None:
                raise
            begin = Moment(error.oldest)
