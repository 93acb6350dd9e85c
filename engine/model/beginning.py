"""Where the answer to a request begins: with what comes, with all that its streams keep, or at a
moment of their past (SPEC §1: a subscription may begin in the past).

A request that begins at a moment gives what it would give from ``start`` over the samples available
from then on alone, so an instant is read as a whole or not at all. Where retention has forgotten a
part of them the request is refused (`Forgotten`).
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


def beginning_of(text: str) -> Beginning:
    """The beginning that a request says; the inverse of ``str``. Raises `BadArguments`."""
    with suppress(ValueError):
        return Since(text)
    moment = Moment.parse(text)
    if moment is None:
        raise BadArguments(
            f"since {text!r} is neither now, start, a time nor a duration",
            "write start, 2021-10-07T19:12:53Z, or 30s before the newest sample",
        )
    return moment


def settled(begin: Beginning, read: Iterable[FluentStream]) -> Beginning:
    """``begin`` with a time in place of a duration: so long before the newest sample of all the
    streams that are ``read``."""
    return begin.among(read) if isinstance(begin, Moment) else begin


def check_kept(begin: Beginning, stream: FluentStream) -> None:
    """Raise `Forgotten` where ``stream`` has forgotten samples from the moment ``begin`` on.
    ``start`` is all that is kept, and no duration is left (`settled`)."""
    if isinstance(begin, Moment):
        begin.check(stream)


def names_read(supplies: Iterable[Supply]) -> tuple[str, ...]:
    """The streams from which the plans ``supplies`` are made, each once."""
    nodes = (node for supply in supplies for node in nodes_of_supply(supply))
    return tuple(dict.fromkeys(node.stream for node in nodes if isinstance(node, UseStream)))


def last_before(begin: Beginning) -> int:
    """The available time (ns) up to which a request with the past ``begin`` reads nothing."""
    if not isinstance(begin, Moment):
        return TIME_MIN
    return max(begin.time - 1, TIME_MIN)


def as_far_as_kept(begin: Beginning, start: Callable[[Beginning], T]) -> T:
    """``start`` from ``begin``, or where its streams have forgotten a part, from the oldest time
    that all of them keep: for a request that was accepted when the samples were still there."""
    while True:
        try:
            return start(begin)
        except Forgotten as error:
            if error.oldest is None:
                raise
            begin = Moment(error.oldest)
