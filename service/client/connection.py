"""Connections to the service: errors, retries, event streams. `Client` adds the routes."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Self

import httpx
import msgspec
from httpx_sse import EventSource, ServerSentEvent

from ..config.defaults import TOKEN, URL
from ..config.media_types import JSON, POSITION

RETRY_FIRST = 0.2
RETRY_LONGEST = 5.0
SILENCE = 60.0
"""Seconds without a byte, not even a ping, after which an event stream counts as broken."""

_REDUNDANT_TITLES = ("unknown ", "no such route", "method not allowed", "empty body")
"""Beginnings of titles that a problem's detail repeats: "there is no stream 'x'"."""


class ServiceError(Exception):
    """An error response of the service: what happened, where, and what to do next."""

    def __init__(
        self,
        status: int,
        title: str,
        detail: str,
        *,
        hint: str = "",
        line: int | None = None,
        column: int | None = None,
        excerpt: str = "",
        problem: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(detail)
        self.status = status
        self.title = title
        self.detail = detail
        self.hint = hint
        self.line = line
        self.column = column
        self.excerpt = excerpt
        self.problem = dict(problem or {})
        """The whole problem document."""

    @property
    def _kind(self) -> str:
        """The title, unless the detail repeats it."""
        return "" if self.title.startswith(_REDUNDANT_TITLES) else f"{self.title}: "

    def __str__(self) -> str:
        place = ""
        if self.line is not None:
            place = f"line {self.line}" + ("" if self.column is None else f", column {self.column}")
            place += ": "
        lines = [f"{self._kind}{place}{self.detail}"]
        if self.excerpt:
            lines.append(self.excerpt)
        missing = [item for item in self.problem.get("missing") or () if item not in self.detail]
        if missing:
            lines += ["missing:", *(f"  - {item}" for item in missing)]
        if self.hint:
            lines.append(f"hint: {self.hint}")
        return "\n".join(lines)


@dataclass(frozen=True, slots=True)
class Event:
    """A message of an event stream: ``kind`` is sample, rematched, gap or end; ``data`` its JSON.

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


class Connection:
    """One HTTP connection pool to a service. Not thread-safe.

    ``token`` authenticates the caller; its default is the environment variable ``DYKNOW_TOKEN``.
    ``transport`` and ``sleep`` are for tests. Every method raises `ServiceError` for an error
    response and ``httpx.TransportError`` if no service responds at ``url``.
    """

    def __init__(
        self,
        url: str = URL,
        *,
        token: str | None = None,
        timeout: float = 30.0,
        transport: httpx.BaseTransport | None = None,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.url = url.rstrip("/")
        self._sleep = sleep
        self._timeout = timeout
        token = os.environ.get(TOKEN, "") if token is None else token
        # trust_env=False: a proxy from the environment cannot reach an address on this machine.
        self._http = httpx.Client(
            base_url=self.url,
            headers={"Authorization": f"Bearer {token.strip()}"} if token else {},
            timeout=timeout,
            transport=transport,
            trust_env=False,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def _follow(
        self, path: str, since: str | None, resume: bool, streams: Sequence[str] = ()
    ) -> Iterator[Event]:
        """Yield the events of ``path`` until its end; of several ``streams`` until the last end."""
        last: str | None = None
        # The switches since the last sample: the service sends them again after a reconnection.
        switches: list[Event] = []
        ended: set[str] = set()
        wait = RETRY_FIRST
        timeout = httpx.Timeout(self._timeout, read=SILENCE)
        while True:
            headers = {"Accept": "text/event-stream", "Cache-Control": "no-store"}
            if last is not None:
                headers["Last-Event-ID"] = last
            parameters: dict[str, Any] = {"stream": list(streams)} if streams else {}
            if since is not None and last is None:
                parameters["since"] = since
            try:
                with self._http.stream(
                    "GET", path, headers=headers, params=parameters, timeout=timeout
                ) as response:
                    if response.status_code >= 500 and last is not None and resume:
                        raise httpx.RemoteProtocolError("the service is not ready")
                    _check(response)
                    # The start's id: a connection that breaks before the first sample loses none.
                    last = last or response.headers.get(POSITION)
                    for message in EventSource(response).iter_sse():
                        if not message.data:
                            continue
                        wait = RETRY_FIRST
                        event = _event(message)
                        if event.kind == "sample":
                            last = event.id
                            switches.clear()
                            ended.discard(str(event.data.get("stream")))
                        elif event.kind == "rematched":
                            if event in switches:
                                continue
                            switches.append(event)
                        yield event
                        if event.kind == "end":
                            ended.add(str(event.data.get("stream")))
                            if len(ended) >= len(set(streams)):
                                return
                if not resume:
                    return
            except httpx.TransportError:
                # The first connection must succeed: retries cannot mend a wrong address.
                if not resume or last is None:
                    raise
            self._sleep(wait)
            wait = min(wait * 2, RETRY_LONGEST)

    def _send_until_room(self, method: str, path: str, **arguments: Any) -> httpx.Response:
        """Send, and repeat while the service is full (429), and once after a broken connection."""
        broken = False
        while True:
            try:
                return self._send(method, path, **arguments)
            except ServiceError as error:
                if error.status != 429:
                    raise
                self._sleep(float(error.problem.get("retry_after", 1)))
            except (httpx.ReadError, httpx.RemoteProtocolError):
                if broken:
                    raise
                broken = True

    def _send(self, method: str, path: str, **arguments: Any) -> httpx.Response:
        response = self._http.request(method, path, **arguments)
        _check(response)
        return response

    def _object(self, method: str, path: str, **arguments: Any) -> dict[str, Any]:
        value: dict[str, Any] = self._send(method, path, **arguments).json()
        return value

    def _list(self, method: str, path: str, **arguments: Any) -> list[dict[str, Any]]:
        headers = {"Accept": JSON, **arguments.pop("headers", {})}
        items: list[dict[str, Any]] = self._send(method, path, headers=headers, **arguments).json()
        return items


def _event(message: ServerSentEvent) -> Event:
    return Event(message.event, message.id, msgspec.json.decode(message.data))


def _check(response: httpx.Response) -> None:
    """Raises `ServiceError` for an error response."""
    if response.is_success:
        return
    response.read()
    try:
        problem = response.json()
    except ValueError:
        problem = {}
    if not isinstance(problem, dict) or "title" not in problem:
        # The response of a proxy, or of another service at this address.
        problem = {"title": response.reason_phrase or "error", "detail": response.text[:500]}
    if "retry-after" in response.headers:
        problem["retry_after"] = response.headers["retry-after"]
    raise ServiceError(
        response.status_code,
        str(problem["title"]),
        str(problem.get("detail", "")),
        hint=str(problem.get("hint", "")),
        line=problem.get("line"),
        column=problem.get("column"),
        excerpt=str(problem.get("excerpt", "")),
        problem=problem,
    )
