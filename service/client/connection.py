"""Connections to the service: refusals, retries, event streams. `Client` adds the verbs."""

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
"""Seconds without a byte, not even a ping, after which an event stream is taken for dead."""

_SAID_AGAIN = ("unknown ", "no such route", "method not allowed", "empty body")
"""How titles begin whose problems say the same in their details: "there is no stream 'x'"."""


class ServiceError(Exception):
    """A refusal of the service: what is wrong, where, and what to do next."""

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
        """The whole problem as it came."""

    @property
    def _kind(self) -> str:
        """The title, where the detail does not say it."""
        return "" if self.title.startswith(_SAID_AGAIN) else f"{self.title}: "

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
        found: Mapping[str, Any] = self.data.get("values", {})
        return found

    @property
    def rdf(self) -> str:
        """A sample as N-Triples."""
        return str(self.data.get("rdf", ""))


class Connection:
    """One HTTP connection pool to a service. Not for several threads at once.

    ``token`` says who asks, where the service wants to know; without it that of the environment
    variable ``DYKNOW_TOKEN``. ``transport`` and ``sleep`` are for tests. Every method raises
    `ServiceError` for a refusal and ``httpx.TransportError`` when there is no service at ``url``.
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
        # An address on this machine is not reached through a proxy of the environment.
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
        """The events of ``path``, until its end; of several ``streams`` until the last one's."""
        last: str | None = None
        # The switches since the last sample: the service tells them again when a client resumes.
        told: list[Event] = []
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
                ) as answer:
                    if answer.status_code >= 500 and last is not None and resume:
                        raise httpx.RemoteProtocolError("the service is not ready")
                    _check(answer)
                    # Known before the first sample: nothing is lost if the connection breaks.
                    last = last or answer.headers.get(POSITION)
                    for message in EventSource(answer).iter_sse():
                        if not message.data:
                            continue
                        wait = RETRY_FIRST
                        event = _event(message)
                        if event.kind == "sample":
                            last = event.id
                            told.clear()
                            ended.discard(str(event.data.get("stream")))
                        elif event.kind == "rematched":
                            if event in told:
                                continue
                            told.append(event)
                        yield event
                        if event.kind == "end":
                            ended.add(str(event.data.get("stream")))
                            if len(ended) >= len(set(streams)):
                                return
                if not resume:
                    return
            except httpx.TransportError:
                # The first connection must succeed: a wrong address is no broken connection.
                if not resume or last is None:
                    raise
            self._sleep(wait)
            wait = min(wait * 2, RETRY_LONGEST)

    def _again(self, method: str, path: str, **arguments: Any) -> httpx.Response:
        """Send until the service has room; a connection that broke is tried once more."""
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
        answer = self._http.request(method, path, **arguments)
        _check(answer)
        return answer

    def _object(self, method: str, path: str, **arguments: Any) -> dict[str, Any]:
        found: dict[str, Any] = self._send(method, path, **arguments).json()
        return found

    def _list(self, method: str, path: str, **arguments: Any) -> list[dict[str, Any]]:
        headers = {"Accept": JSON, **arguments.pop("headers", {})}
        found: list[dict[str, Any]] = self._send(method, path, headers=headers, **arguments).json()
        return found


def _event(message: ServerSentEvent) -> Event:
    return Event(message.event, message.id, msgspec.json.decode(message.data))


def _check(answer: httpx.Response) -> None:
    if answer.is_success:
        return
    answer.read()
    try:
        problem = answer.json()
    except ValueError:
        problem = {}
    if not isinstance(problem, dict) or "title" not in problem:
        # Not ours: a proxy, or another service at this address.
        problem = {"title": answer.reason_phrase or "error", "detail": answer.text[:500]}
    if "retry-after" in answer.headers:
        problem["retry_after"] = answer.headers["retry-after"]
    raise ServiceError(
        answer.status_code,
        str(problem["title"]),
        str(problem.get("detail", "")),
        hint=str(problem.get("hint", "")),
        line=problem.get("line"),
        column=problem.get("column"),
        excerpt=str(problem.get("excerpt", "")),
        problem=problem,
    )
