"""Event streams: their messages, how a client resumes them, and what it gives to its callers."""

from __future__ import annotations

from collections.abc import AsyncGenerator, AsyncIterator, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Self, TypedDict

import httpx
import msgspec
from httpx_sse import ServerSentEvent

from ..config.media_types import POSITION
from .errors import check
from .tables import samples_frame

if TYPE_CHECKING:
    from pandas import DataFrame

RETRY_FIRST = 0.2
RETRY_LONGEST = 5.0
SILENCE = 60.0
"""Seconds without a byte, not even a ping, after which an event stream counts as broken."""


@dataclass(frozen=True, slots=True)
class Event:
    """A message of an event stream: ``kind`` is sample, result, rematched, gap or end; ``data`` is
    its JSON.

    ``id`` is that of the last sample so far.
    """

    kind: str
    id: str
    data: Mapping[str, Any] = field(repr=False)

    @property
    def values(self) -> Mapping[str, Any]:
        """The named values of a sample."""
        values: Mapping[str, Any] = self.data.get("values", {})
        return values

    @property
    def rdf(self) -> str:
        """The sample as N-Triples."""
        return str(self.data.get("rdf", ""))

    @property
    def count(self) -> int:
        """The number of samples that this one stands for, with ``every``."""
        return int(self.data.get("count", 1))


class Delivery(TypedDict, total=False):
    """What the messages of samples are. ``last`` begins with so many of the newest samples;
    ``rdf=False`` leaves out the RDF, and ``fields`` all values but these; ``every`` (``"250ms"``)
    is the least time between two messages of one object: its newest sample, and `Event.count`."""

    last: int
    rdf: bool
    fields: Sequence[str]
    every: str


@dataclass(frozen=True, slots=True)
class EventSource:
    """The event stream of ``path``; ``streams`` are those of `/follow`. It ends with the last of
    them."""

    path: str
    since: str | None = None
    resume: bool = True
    streams: tuple[str, ...] = ()
    delivery: Delivery = field(default_factory=Delivery)

    def __post_init__(self) -> None:
        unknown = self.delivery.keys() - Delivery.__annotations__.keys()
        if unknown:
            raise TypeError(f"unknown parameters of events: {', '.join(sorted(unknown))}")

    def parameters(self, *, begins: bool) -> dict[str, Any]:
        """The parameters of a request; unless it ``begins``, without those that say where."""
        found: dict[str, Any] = {"stream": list(self.streams)} if self.streams else {}
        if begins and self.since is not None:
            found["since"] = self.since
        if begins and "last" in self.delivery:
            found["last"] = self.delivery["last"]
        if not self.delivery.get("rdf", True):
            found["rdf"] = "no"
        if "fields" in self.delivery:
            found["fields"] = list(self.delivery["fields"])
        if "every" in self.delivery:
            found["every"] = self.delivery["every"]
        return found


class Following:
    """The state of an event stream over its connections: what to ask for next, and its end."""

    def __init__(self, source: EventSource, timeout: float) -> None:
        self._source = source
        self._timeout = httpx.Timeout(timeout, read=SILENCE)
        self._last: str | None = None
        # The switches since the last sample: the service sends them again after a reconnection.
        self._switches: list[Event] = []
        self._ended: set[str] = set()
        self._wait = RETRY_FIRST

    @property
    def resumes(self) -> bool:
        """Whether to connect again where a connection ends before the stream does."""
        return self._source.resume

    @property
    def survives(self) -> bool:
        """Whether to connect again after an error. The first connection must succeed: retries
        cannot mend a wrong address."""
        return self._source.resume and self._last is not None

    @property
    def is_over(self) -> bool:
        """Whether the last stream has ended."""
        return bool(self._ended) and len(self._ended) >= len(set(self._source.streams))

    def request(self) -> dict[str, Any]:
        """Return the arguments of the next request for ``httpx.stream``."""
        headers = {"Accept": "text/event-stream", "Cache-Control": "no-store"}
        if self._last is not None:
            headers["Last-Event-ID"] = self._last
        return {
            "method": "GET",
            "url": self._source.path,
            "headers": headers,
            "params": self._source.parameters(begins=self._last is None),
            "timeout": self._timeout,
        }

    def begin(self, response: httpx.Response) -> None:
        """Note the beginning of a response; the body of an error has been read. Raises
        `ServiceError`, and ``httpx.RemoteProtocolError`` for a service that is not ready."""
        if response.status_code >= 500 and self.survives:
            raise httpx.RemoteProtocolError("the service is not ready")
        check(response)
        # The start's id: a connection that breaks before the first sample loses none.
        self._last = self._last or response.headers.get(POSITION)

    def take(self, message: ServerSentEvent) -> Event | None:
        """Return the event of a message; None for an empty one, and for a repeated switch."""
        if not message.data:
            return None
        self._wait = RETRY_FIRST
        event = Event(message.event, message.id, msgspec.json.decode(message.data))
        stream = str(event.data.get("stream"))
        match event.kind:
            case "sample" | "result":
                self._last = event.id
                self._switches.clear()
                self._ended.discard(stream)
            case "rematched":
                if event in self._switches:
                    return None
                self._switches.append(event)
            case "end":
                self._ended.add(stream)
        return event

    def next_wait(self) -> float:
        """Return the seconds until the next connection: twice as long each time."""
        wait, self._wait = self._wait, min(self._wait * 2, RETRY_LONGEST)
        return wait


class Events(Iterator[Event]):
    """The events of a stream as they come. `close` ends the connection, and so does dropping it."""

    def __init__(self, source: EventSource, events: Generator[Event]) -> None:
        self._source = source
        self._events = events

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Event:
        return next(self._events)

    def close(self) -> None:
        """End the connection."""
        self._events.close()

    def to_pandas(self, limit: int | None = None) -> DataFrame:
        """Return the samples until the stream's end, or the next ``limit`` ones, as a DataFrame.

        Its columns are ``stream`` (of `follow`), ``valid`` and ``available`` (UTC), and the fields.
        A stream that does not end needs a ``limit``. Needs dyknow[pandas].
        """
        samples: list[Event] = []
        while limit is None or len(samples) < limit:
            event = next(self, None)
            if event is None:
                break
            if event.kind == "sample":
                samples.append(event)
        return _frame(samples, self._source)


class AsyncEvents(AsyncIterator[Event]):
    """The same for `AsyncClient`: iterate with ``async for``."""

    def __init__(self, source: EventSource, events: AsyncGenerator[Event]) -> None:
        self._source = source
        self._events = events

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Event:
        return await anext(self._events)

    async def aclose(self) -> None:
        """End the connection."""
        await self._events.aclose()

    async def to_pandas(self, limit: int | None = None) -> DataFrame:
        """See `Events.to_pandas`."""
        samples: list[Event] = []
        while limit is None or len(samples) < limit:
            event = await anext(self, None)
            if event is None:
                break
            if event.kind == "sample":
                samples.append(event)
        return _frame(samples, self._source)


def _frame(samples: Sequence[Event], source: EventSource) -> DataFrame:
    return samples_frame([event.data for event in samples], with_stream=bool(source.streams))
