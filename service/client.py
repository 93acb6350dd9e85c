"""A Python client with the verbs of the HTTP routes (docs/api.md).

    client = dyknow.Client("http://127.0.0.1:8000")
    request = client.request_event("dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)")
    for event in client.events(request["stream"], since=request["position"]):
        print(event.values, event.rdf)

Answers are the JSON of the routes as dicts. Refusals are `ServiceError`. Used by the command line.
"""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Self
from urllib.parse import quote

import httpx
import msgspec
from httpx_sse import EventSource, ServerSentEvent

from ..converters.ndjson import encode_ndjson
from ..streams.sample import SampleBatch
from .negotiation import (
    CSV,
    JSON,
    NDJSON,
    NTRIPLES,
    SPARQL_JSON,
    SPARQL_QUERY,
    TEXT,
    TURTLE,
)
from .sse import POSITION

URL = "http://127.0.0.1:8000"
RETRY_FIRST = 0.2
RETRY_LONGEST = 5.0
SILENCE = 60.0
"""Seconds without a byte, not even a ping, after which an event stream is taken for dead."""


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

    def __str__(self) -> str:
        place = ""
        if self.line is not None:
            place = f"line {self.line}" + ("" if self.column is None else f", column {self.column}")
            place += ": "
        lines = [f"{self.title}: {place}{self.detail}"]
        if self.excerpt:
            lines.append(self.excerpt)
        if self.problem.get("missing"):
            lines += ["missing:", *(f"  - {item}" for item in self.problem["missing"])]
        if self.hint:
            lines.append(f"hint: {self.hint}")
        return "\n".join(lines)


@dataclass(frozen=True, slots=True)
class Event:
    """A message of an event stream: ``kind`` is sample, gap or end; ``data`` its JSON."""

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


class Client:
    """The service's verbs over one HTTP connection pool. Not for several threads at once.

    ``transport`` and ``sleep`` are for tests. Every method raises `ServiceError` for a refusal
    and ``httpx.TransportError`` when there is no service at ``url``.
    """

    def __init__(
        self,
        url: str = URL,
        *,
        timeout: float = 30.0,
        transport: httpx.BaseTransport | None = None,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.url = url.rstrip("/")
        self._sleep = sleep
        self._timeout = timeout
        # An address on this machine is not reached through a proxy of the environment.
        self._http = httpx.Client(
            base_url=self.url, timeout=timeout, transport=transport, trust_env=False
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

    # -- streams and samples

    def put_stream(
        self,
        name: str,
        fields: Mapping[str, str] | Sequence[Mapping[str, str]],
        *,
        lateness: str | int = 0,
        retention: Mapping[str, Any] | None = None,
        namespace: str | None = None,
    ) -> dict[str, Any]:
        """Declare a stream: field names and types, how late samples may be, what is kept."""
        body: dict[str, Any] = {"fields": fields, "lateness": lateness}
        if retention is not None:
            body["retention"] = retention
        if namespace is not None:
            body["namespace"] = namespace
        return self._object("PUT", f"/streams/{_part(name)}", json=body)

    def streams(self) -> list[dict[str, Any]]:
        """All streams."""
        return self._list("GET", "/streams")

    def stream(self, name: str) -> dict[str, Any]:
        """One stream."""
        return self._object("GET", f"/streams/{_part(name)}")

    def remove_stream(self, name: str) -> None:
        """Remove a declared stream, unless it is read."""
        self._send("DELETE", f"/streams/{_part(name)}")

    def publish(
        self,
        stream: str,
        samples: Iterable[Mapping[str, Any]] | SampleBatch | bytes,
        *,
        idempotency_key: str | None = None,
        stamp: bool = False,
    ) -> int:
        """Publish rows, a batch, or NDJSON bytes; returns how many samples were accepted.

        A batch brings its available times unless ``stamp`` leaves them to the service. A full
        queue (429) and a lost connection are tried again under the same key, so that nothing is
        taken twice.
        """
        if isinstance(samples, SampleBatch):
            body = encode_ndjson(samples)
            if stamp:
                rows = msgspec.json.Decoder(dict[str, Any]).decode_lines(body)
                body = msgspec.json.Encoder().encode_lines([_unstamped(row) for row in rows])
        elif isinstance(samples, bytes):
            body = samples
        else:
            # json, not msgspec: it writes NaN as NaN, for the service to refuse, not as null.
            body = "\n".join(json.dumps(row) for row in samples).encode()
        headers = {
            "Content-Type": NDJSON,
            "Idempotency-Key": idempotency_key or uuid.uuid4().hex,
        }
        answer = self._again(
            "POST", f"/streams/{_part(stream)}/samples", content=body, headers=headers
        )
        return int(answer.json()["accepted"])

    def end(self, stream: str) -> None:
        """A recording has come to its end."""
        self._send("POST", f"/streams/{_part(stream)}/end")

    def history(
        self,
        stream: str,
        *,
        start: str | int | None = None,
        end: str | int | None = None,
        limit: int | None = None,
        at: str | int | None = None,
    ) -> list[dict[str, Any]]:
        """The kept samples by available time, or the most recent one at a valid time."""
        answer = self._history(stream, JSON, start, end, limit, at)
        found: list[dict[str, Any]] = answer.json()
        return found

    def history_text(self, stream: str, media_type: str = CSV, **arguments: Any) -> str:
        """The same as text: ``text/csv``, ``application/x-ndjson``, ``application/n-triples``."""
        wanted = {key: arguments.get(key) for key in ("start", "end", "limit", "at")}
        return self._history(stream, media_type, *wanted.values()).text

    def events(
        self, stream: str, *, since: str | None = None, resume: bool = True
    ) -> Iterator[Event]:
        """The stream's samples as they come, with `gap` and `end` messages among them.

        Ends after `end`. A connection that breaks is taken up again after the last sample seen,
        unless ``resume`` is False; then its error is raised.
        """
        return self._follow(f"/streams/{_part(stream)}/events", since, resume)

    def status_events(self, *, since: str | None = None) -> Iterator[Event]:
        """Every change of the stream space."""
        return self._follow("/status/events", since, True)

    # -- meaning

    def annotate(self, ssl: str) -> list[dict[str, Any]]:
        """Annotate streams and units by an SSL text."""
        return self._list("POST", "/annotations", content=ssl, headers={"Content-Type": TEXT})

    def annotations(self) -> list[dict[str, Any]]:
        """All annotations."""
        return self._list("GET", "/annotations")

    def subscribe(
        self, stream: str, policy: str = "", *, unit: str = "ms", since: str = "now"
    ) -> dict[str, Any]:
        """Subscribe to a stream under a policy as after `with` in KPL; its samples are `events` of
        the answer's ``stream``. ``since`` "start" begins with what is kept."""
        body = {"stream": stream, "policy": policy, "unit": unit, "since": since}
        return self._object("POST", "/subscriptions", json=body)

    def subscriptions(self) -> list[dict[str, Any]]:
        """The subscriptions that run."""
        return self._list("GET", "/subscriptions")

    def unsubscribe(self, id: str) -> None:
        """Give a subscription up."""
        self._send("DELETE", f"/subscriptions/{_part(id)}")

    def declare_kpl(self, text: str, unit: str = "ms") -> list[dict[str, Any]]:
        """Declare processes and streams in KPL; gives what is new. ``unit`` is what integers are
        where the text does not say."""
        headers = {"Content-Type": TEXT}
        return self._list("POST", "/kpl", content=text, headers=headers, params={"unit": unit})

    def kpl(self) -> list[dict[str, Any]]:
        """Everything declared in KPL, in order."""
        return self._list("GET", "/kpl")

    def kpl_declaration(self, name: str) -> dict[str, Any]:
        """One declaration by name or label, with what cannot be without it."""
        return self._object("GET", f"/kpl/{_part(name)}")

    def remove_kpl(self, name: str, *, cascade: bool = False) -> list[str]:
        """Remove a declaration, with ``cascade`` also what cannot be without it."""
        parameters = {"cascade": str(cascade).lower()}
        answer = self._object("DELETE", f"/kpl/{_part(name)}", params=parameters)
        removed: list[str] = answer["removed"]
        return removed

    def load_ontology(
        self, text: str, name: str | None = None, media_type: str = TURTLE
    ) -> dict[str, Any]:
        """Add or replace a domain ontology; without ``name`` it is the text's one owl:Ontology.

        ``media_type`` is that of Turtle, RDF/XML, JSON-LD or N-Triples.
        """
        parameters = {} if name is None else {"name": name}
        headers = {"Content-Type": media_type}
        return self._object("POST", "/ontologies", content=text, headers=headers, params=parameters)

    def ontologies(self) -> list[str]:
        """The names of the loaded ontologies."""
        found: list[str] = self._send("GET", "/ontologies").json()
        return found

    def ontology_report(self) -> dict[str, Any]:
        """Whether the stream space is well-formed: ``conforms``, and the ``violations``."""
        return self._object("GET", "/ontologies/report")

    def register_template(self, text: str, *, replace: str | None = None) -> dict[str, Any]:
        """Register an event template; ``replace`` names the one that it takes the place of."""
        headers = {"Content-Type": TEXT}
        if replace is None:
            return self._object("POST", "/templates", content=text, headers=headers)
        return self._object("PUT", f"/templates/{_part(replace)}", content=text, headers=headers)

    def templates(self) -> list[dict[str, Any]]:
        """All templates."""
        return self._list("GET", "/templates")

    def template(self, name: str) -> dict[str, Any]:
        """One template, by local name or IRI."""
        return self._object("GET", f"/templates/{_part(name)}")

    def remove_template(self, name: str) -> None:
        """Remove a template."""
        self._send("DELETE", f"/templates/{_part(name)}")

    def request_event(
        self,
        event: str,
        arguments: Sequence[str] | None = None,
        *,
        strategy: str = "fast",
        since: str = "now",
    ) -> dict[str, Any]:
        """Request an event: ``Event(arguments)`` as one text, or its name and arguments.

        ``since`` "start" begins with what the streams keep of their past. Others may have asked
        before: the answer's ``position``, as ``since`` of `events`, leaves out what came until now.
        """
        if arguments is None:
            headers = {"Content-Type": TEXT}
            parameters = {"strategy": strategy, "since": since}
            return self._object(
                "POST", "/events", content=event, headers=headers, params=parameters
            )
        body: dict[str, Any] = {"event": event, "arguments": list(arguments)}
        body |= {"strategy": strategy, "since": since}
        return self._object("POST", "/events", json=body)

    def requests(self) -> list[dict[str, Any]]:
        """The event requests that run."""
        return self._list("GET", "/events")

    def request(self, id: str) -> dict[str, Any]:
        """One event request that runs."""
        return self._object("GET", f"/events/{_part(id)}")

    def cancel_event(self, id: str) -> None:
        """Give an event request up."""
        self._send("DELETE", f"/events/{_part(id)}")

    def match(
        self,
        feature: str,
        *,
        sort: str | None = None,
        objects: Sequence[str] = (),
        strategy: str = "fast",
    ) -> dict[str, Any]:
        """How a feature could be had; nothing is started."""
        body = {"feature": feature, "sort": sort, "objects": list(objects), "strategy": strategy}
        return self._object("POST", "/match", json=body)

    def sparql(self, query: str) -> dict[str, Any] | str:
        """A SPARQL query's answer: SPARQL JSON for SELECT and ASK, Turtle for graphs."""
        accept = f"{SPARQL_JSON}, {TURTLE};q=0.9"
        answer = self._send(
            "POST",
            "/sparql",
            content=query,
            headers={"Content-Type": SPARQL_QUERY, "Accept": accept},
        )
        if answer.headers["content-type"].startswith(SPARQL_JSON):
            found: dict[str, Any] = answer.json()
            return found
        return answer.text

    def explain(
        self,
        *,
        event: str | None = None,
        template: str | None = None,
        query: str | None = None,
        id: str | None = None,
        feature: str | None = None,
    ) -> str:
        """Every stage of exactly one of these, as text."""
        given = {"event": event, "template": template, "query": query, "id": id}
        given["feature"] = feature
        parameters = {key: value for key, value in given.items() if value is not None}
        return self._send("GET", "/explain", params=parameters, headers={"Accept": TEXT}).text

    def status(self) -> dict[str, Any]:
        """The service at a glance."""
        return self._object("GET", "/status")

    def rdf(self, stream: str, *, limit: int | None = None) -> str:
        """The kept samples as N-Triples, by the stream's annotation."""
        return self._history(stream, NTRIPLES, None, None, limit, None).text

    # -- within

    def _history(
        self,
        stream: str,
        kind: str,
        start: str | int | None,
        end: str | int | None,
        limit: int | None,
        at: str | int | None,
    ) -> httpx.Response:
        given = {"from": start, "to": end, "limit": limit, "at": at}
        parameters = {key: value for key, value in given.items() if value is not None}
        path = f"/streams/{_part(stream)}/samples"
        return self._send("GET", path, params=parameters, headers={"Accept": kind})

    def _follow(self, path: str, since: str | None, resume: bool) -> Iterator[Event]:
        last: str | None = None
        wait = RETRY_FIRST
        timeout = httpx.Timeout(self._timeout, read=SILENCE)
        while True:
            headers = {"Accept": "text/event-stream", "Cache-Control": "no-store"}
            if last is not None:
                headers["Last-Event-ID"] = last
            parameters = {} if since is None or last is not None else {"since": since}
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
                        if message.event == "sample":
                            last = message.id
                        yield _event(message)
                        if message.event == "end":
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


def _part(name: str) -> str:
    return quote(name, safe="")


def _unstamped(row: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in row.items() if key != "available"}


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
