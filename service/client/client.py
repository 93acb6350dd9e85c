"""A Python client with a method for each HTTP route (docs/reference/http.md).

    client = dyknow.Client("http://127.0.0.1:8000")
    request = client.request_event("dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)")
    for event in client.events(request["stream"], since=request["position"]):
        print(event.values, event.rdf)

Methods return the JSON of the routes as dicts. A refusal raises `ServiceError`. The command line
uses this client.
"""

from __future__ import annotations

import json
import uuid
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote

import httpx
import msgspec

from ..config.defaults import URL
from ..config.media_types import (
    CSV,
    JSON,
    NDJSON,
    NTRIPLES,
    SPARQL_JSON,
    SPARQL_QUERY,
    TEXT,
    TURTLE,
)
from .connection import Connection, Event, ServiceError
from .parts import (
    description_parts,
    joined,
    kpl_parts,
    send_parts,
    specification_parts,
    ssl_parts,
)

if TYPE_CHECKING:
    from ...streams.sample import SampleBatch

__all__ = ["URL", "Client", "Event", "RoundedNumbers", "ServiceError"]


class RoundedNumbers(UserWarning):
    """The service has rounded numbers of float fields (docs/reference/formats.md)."""


class Client(Connection):
    """The service's routes over one HTTP connection pool. Not thread-safe."""

    # -- streams and samples

    def put_stream(
        self,
        name: str,
        fields: Mapping[str, str] | Sequence[Mapping[str, str]],
        *,
        lateness: str | int = 0,
        idle: str | int | None = None,
        ahead: str | int | None = None,
        retention: Mapping[str, Any] | None = None,
        namespace: str | None = None,
    ) -> dict[str, Any]:
        """Declare a stream with the names and types of its fields.

        ``lateness``: how late samples may be; ``idle``: the silence after which readers no longer
        wait; ``ahead``: how far ahead of the clock samples may be (``"oo"``: any); ``retention``:
        the size of the history."""
        body: dict[str, Any] = {"fields": fields, "lateness": lateness}
        if idle is not None:
            body["idle"] = idle
        if ahead is not None:
            body["ahead"] = ahead
        if retention is not None:
            body["retention"] = retention
        if namespace is not None:
            body["namespace"] = namespace
        return self._object("PUT", f"/streams/{_part(name)}", json=body)

    def streams(self) -> list[dict[str, Any]]:
        """Return all streams."""
        return self._list("GET", "/streams")

    def stream(self, name: str) -> dict[str, Any]:
        """Return one stream."""
        return self._object("GET", f"/streams/{_part(name)}")

    def evaluation(self, stream: str) -> dict[str, Any]:
        """Return how far the readers of a stream have evaluated it, and which of them failed."""
        return self._object("GET", f"/streams/{_part(stream)}/evaluation")

    def remove_stream(self, name: str) -> None:
        """Remove a declared stream, or one of late samples. A stream with readers stays: 409."""
        self._send("DELETE", f"/streams/{_part(name)}")

    def publish(
        self,
        stream: str,
        samples: Iterable[Mapping[str, Any]] | SampleBatch | bytes,
        *,
        idempotency_key: str | None = None,
        stamp: bool = False,
    ) -> int:
        """Publish rows, a batch, or NDJSON bytes; returns the number of accepted samples.

        A batch has its own available times; with ``stamp`` the service stamps it instead. The
        client repeats a request that is refused for a full queue (429) or loses its connection,
        under the same key, so that the service accepts the samples once. Warns of `RoundedNumbers`.
        """
        headers = {
            "Content-Type": NDJSON,
            "Idempotency-Key": idempotency_key or uuid.uuid4().hex,
        }
        response = self._send_until_room(
            "POST",
            f"/streams/{_part(stream)}/samples",
            content=_ndjson(samples, stamp),
            headers=headers,
        )
        return _accepted(stream, response.json())

    def publish_live(
        self,
        stream: str,
        batches: Iterable[Iterable[Mapping[str, Any]] | SampleBatch | bytes],
        *,
        stamp: bool = False,
    ) -> int:
        """Publish the items of ``batches`` as they come, in one request; returns the number of
        accepted samples after the last.

        There is no response in between, so small batches cost little. A refusal ends the request,
        at the latest with the next batch: `ServiceError`, with the number of accepted samples in
        ``problem["accepted"]``. A broken connection (``httpx.TransportError``) ends it too; then
        that number is unknown, and the client repeats nothing. The service ends a silent request;
        yield an empty list now and then to keep it. Warns of `RoundedNumbers` when it ends.
        """
        response = self._send(
            "POST",
            f"/streams/{_part(stream)}/samples/live",
            content=(_ndjson(samples, stamp).rstrip(b"\n") + b"\n" for samples in batches),
            headers={"Content-Type": NDJSON},
        )
        return _accepted(stream, response.json())

    def end(self, stream: str) -> None:
        """End a stream, such as that of a recording."""
        self._send("POST", f"/streams/{_part(stream)}/end")

    def history(
        self,
        stream: str,
        *,
        start: str | int | None = None,
        end: str | int | None = None,
        limit: int | None = None,
        **query: str | int | None,
    ) -> list[dict[str, Any]]:
        """Return samples of the history by available time, with valid times from ``valid_from`` to
        ``valid_to``. Or one of these queries: ``at`` or ``before`` (with ``known``), ``prev``,
        ``last_avail`` [DyKnow10 Def. 5.5-5.7]; see `GET /streams/{name}/samples`.

        Raises `ServiceError` 410 if the result depends on evicted samples.
        """
        arguments = {"start": start, "end": end, "limit": limit, **query}
        samples: list[dict[str, Any]] = self._history(stream, JSON, arguments).json()
        return samples

    def history_text(self, stream: str, media_type: str = CSV, **arguments: Any) -> str:
        """Return the same as text: ``text/csv``, ``application/x-ndjson``,
        ``application/n-triples``."""
        return self._history(stream, media_type, arguments).text

    def events(
        self, stream: str, *, since: str | None = None, resume: bool = True
    ) -> Iterator[Event]:
        """Yield the stream's samples as they come, and `gap` and `end` messages.

        Returns after `end`. After a broken connection the client resumes behind the last sample; if
        ``resume`` is False it raises the error instead.
        """
        return self._follow(f"/streams/{_part(stream)}/events", since, resume)

    def follow(self, streams: Sequence[str], *, since: str | None = None) -> Iterator[Event]:
        """Yield the samples of several streams as they come, on one connection; cf. `events`.

        Returns after the last stream's ``end``. An event's ``data["stream"]`` names its stream.
        """
        return self._follow("/follow", since, True, streams)

    def status_events(self, *, since: str | None = None) -> Iterator[Event]:
        """Yield every change of the stream space."""
        return self._follow("/status/events", since, True)

    # -- meaning

    def annotate(self, ssl: str) -> list[dict[str, Any]]:
        """Annotate streams and units by an SSL text. The client sends a long text in parts, each of
        which takes effect as a whole or not at all
        (docs/reference/http-conventions.md, "Sizes")."""
        headers = {"Content-Type": TEXT}
        return joined(
            send_parts(
                ssl_parts(ssl),
                lambda part: self._list("POST", "/annotations", content=part, headers=headers),
            )
        )

    def describe(
        self, streams: Mapping[str, Any] | Sequence[Mapping[str, Any]]
    ) -> list[dict[str, Any]]:
        """Annotate one or several streams: ``{"stream", "contents": [{"feature", "field", …}]}``;
        many in parts, as in `annotate`."""
        parts = description_parts(streams)
        return joined(send_parts(parts, lambda part: self._list("POST", "/annotations", json=part)))

    def annotations(self) -> list[dict[str, Any]]:
        """Return all annotations."""
        return self._list("GET", "/annotations")

    def set_quality(self, stream: str, quality: float) -> None:
        """Set the quality of a stream, 0 to 1."""
        self._send("PUT", f"/streams/{_part(stream)}/quality", json={"quality": quality})

    def register_transformation(
        self, description: Mapping[str, Any] | str, *, replace: str | None = None
    ) -> list[dict[str, Any]]:
        """Register a transformation by its JSON, or one or several by a Turtle text; ``replace``
        is the name of one to replace."""
        body: dict[str, Any] = {"json": description}
        if isinstance(description, str):
            body = {"content": description, "headers": {"Content-Type": TURTLE}}
        if replace is None:
            body_json = self._send("POST", "/transformations", **body).json()
        else:
            body_json = self._send("PUT", f"/transformations/{_part(replace)}", **body).json()
        registered: list[dict[str, Any]] = body_json if isinstance(body_json, list) else [body_json]
        return registered

    def transformations(self) -> list[dict[str, Any]]:
        """Return all transformations."""
        return self._list("GET", "/transformations")

    def transformation(self, name: str) -> dict[str, Any]:
        """Return one transformation."""
        return self._object("GET", f"/transformations/{_part(name)}")

    def change_transformation(
        self, name: str, *, cost: float | None = None, quality: float | None = None
    ) -> dict[str, Any]:
        """Change the cost or quality of a transformation."""
        body = {"cost": cost, "quality": quality}
        return self._object("PATCH", f"/transformations/{_part(name)}", json=body)

    def remove_transformation(self, name: str) -> None:
        """Remove a transformation. One with a running unit stays: 409."""
        self._send("DELETE", f"/transformations/{_part(name)}")

    def subscribe(
        self, stream: str, policy: str = "", *, unit: str = "ms", since: str = "now"
    ) -> dict[str, Any]:
        """Subscribe to a stream under a policy as after `with` in KPL. `events` of the result's
        ``stream`` yields its samples. ``since``: "start" begins with the whole history, a time or a
        duration such as "30s" before the newest sample there."""
        body = {"stream": stream, "policy": policy, "unit": unit, "since": since}
        return self._object("POST", "/subscriptions", json=body)

    def subscribe_to(
        self,
        feature: str,
        *,
        sort: str | None = None,
        objects: Sequence[str] = (),
        strategy: str = "fast",
        policy: str = "",
        unit: str = "ms",
        since: str = "now",
        staleness: str | int | None = None,
        min_quality: float = 0.0,
        hold_off: str | int = "2s",
    ) -> dict[str, Any]:
        """Subscribe to a feature, of any streams that have it; `subscription_events` yields its
        samples and switches. For ``since`` see `request_event`."""
        body: dict[str, Any] = {
            "feature": feature,
            "sort": sort,
            "objects": list(objects),
            "strategy": strategy,
            "policy": policy,
            "unit": unit,
            "since": since,
            "staleness": staleness,
            "min_quality": min_quality,
            "hold_off": hold_off,
        }
        return self._object("POST", "/subscriptions", json=body)

    def subscription(self, id: str) -> dict[str, Any]:
        """Return one subscription."""
        return self._object("GET", f"/subscriptions/{_part(id)}")

    def subscription_events(
        self, id: str, *, since: str | None = None, resume: bool = True
    ) -> Iterator[Event]:
        """Yield the events of a subscription, as `events` does; for a feature also `rematched`
        between the samples, each switch once."""
        return self._follow(f"/subscriptions/{_part(id)}/events", since, resume)

    def rematches(self, id: str) -> list[dict[str, Any]]:
        """Return the latest switches of a subscription to a feature, oldest first."""
        return self._list("GET", f"/subscriptions/{_part(id)}/rematches")

    def subscriptions(self) -> list[dict[str, Any]]:
        """Return the running and the waiting subscriptions."""
        return self._list("GET", "/subscriptions")

    def unsubscribe(self, id: str) -> None:
        """Cancel a subscription."""
        self._send("DELETE", f"/subscriptions/{_part(id)}")

    def declare_kpl(self, text: str, unit: str = "ms") -> list[dict[str, Any]]:
        """Declare processes and streams in KPL; returns the new declarations. ``unit`` is the unit
        of integers if the text has none. A long text goes in parts, as in `annotate`."""
        request: dict[str, Any] = {"headers": {"Content-Type": TEXT}, "params": {"unit": unit}}
        parts = kpl_parts(text)
        return joined(
            send_parts(parts, lambda part: self._list("POST", "/kpl", content=part, **request))
        )

    def kpl(self) -> list[dict[str, Any]]:
        """Return all KPL declarations, in order."""
        return self._list("GET", "/kpl")

    def kpl_declaration(self, name: str) -> dict[str, Any]:
        """Return one declaration by name or label, with those that depend on it."""
        return self._object("GET", f"/kpl/{_part(name)}")

    def remove_kpl(self, name: str, *, cascade: bool = False) -> list[str]:
        """Remove a declaration, and with ``cascade`` those that depend on it; return the names."""
        parameters = {"cascade": str(cascade).lower()}
        response = self._object("DELETE", f"/kpl/{_part(name)}", params=parameters)
        removed: list[str] = response["removed"]
        return removed

    def apply_specification(self, xml: str | bytes) -> dict[str, Any]:
        """Insert and remove units by an XML text, as a whole or not at all. A text without removals
        and with more insertions than a request may have goes in parts, as in `annotate`."""
        headers = {"Content-Type": "application/xml"}
        parts = specification_parts(xml)
        changed, *others = send_parts(
            parts,
            lambda part: self._object("POST", "/specifications", content=part, headers=headers),
        )
        for other in others:
            for key, value in other.items():
                changed[key] = (
                    changed[key] | value if isinstance(value, dict) else changed[key] + value
                )
        return dict(changed)

    def insertions(self) -> list[dict[str, Any]]:
        """Return the insertions of specifications, in order."""
        return self._list("GET", "/specifications")

    def current_specification(self) -> str:
        """Return the running configuration as an XML text."""
        return self._send("GET", "/specifications/current").text

    def load_ontology(
        self, text: str, name: str | None = None, media_type: str = TURTLE
    ) -> dict[str, Any]:
        """Add or replace a domain ontology; its default ``name`` is the IRI of the text's one
        owl:Ontology. ``media_type``: Turtle, RDF/XML, JSON-LD or N-Triples."""
        parameters = {} if name is None else {"name": name}
        headers = {"Content-Type": media_type}
        return self._object("POST", "/ontologies", content=text, headers=headers, params=parameters)

    def ontologies(self) -> list[str]:
        """Return the names of the loaded ontologies."""
        names: list[str] = self._send("GET", "/ontologies").json()
        return names

    def ontology(self, name: str) -> str:
        """Return the triples of a loaded ontology as Turtle."""
        path = f"/ontologies/{_part(name)}"
        return self._send("GET", path, headers={"Accept": TURTLE}).text

    def remove_ontology(self, name: str) -> None:
        """Remove an ontology. One whose terms are used stays: 409, and ``problem["used_by"]``."""
        self._send("DELETE", f"/ontologies/{_part(name)}")

    def vocabulary(self) -> dict[str, Any]:
        """Return the ``sorts``, ``features`` and ``events`` that texts may name."""
        return self._object("GET", "/vocabulary")

    def ontology_report(self) -> dict[str, Any]:
        """Validate the stream space: ``conforms``, and the ``violations``."""
        return self._object("GET", "/ontologies/report")

    def register_template(self, text: str, *, replace: str | None = None) -> dict[str, Any]:
        """Register an event template; ``replace`` is the name of one to replace."""
        headers = {"Content-Type": TEXT}
        if replace is None:
            return self._object("POST", "/templates", content=text, headers=headers)
        return self._object("PUT", f"/templates/{_part(replace)}", content=text, headers=headers)

    def templates(self) -> list[dict[str, Any]]:
        """Return all templates."""
        return self._list("GET", "/templates")

    def template(self, name: str) -> dict[str, Any]:
        """Return one template, by local name or IRI."""
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

        ``since``: "start" begins with the whole histories of the streams, a time (ISO-8601 or ns)
        with the samples available from then on, a duration such as "30s" that long before the
        newest sample of all streams that are read. 410: a stream no longer has all of these.
        Earlier requests may share the stream: `events` with the result's ``position`` as ``since``
        skips their samples.
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
        """Return the running and the waiting event requests."""
        return self._list("GET", "/events")

    def request(self, id: str) -> dict[str, Any]:
        """Return one event request."""
        return self._object("GET", f"/events/{_part(id)}")

    def cancel_event(self, id: str) -> None:
        """Cancel an event request."""
        self._send("DELETE", f"/events/{_part(id)}")

    def why(self, name: str, start: str | int, objects: Sequence[str] = ()) -> dict[str, Any]:
        """Return the explanation of a monitor's verdict: the one that starts at the time ``start``
        (ISO-8601 or ns) for these ``objects``, one for each parameter in order. Of a pattern, that
        of the matches that start, or are valid, then."""
        parameters = {"start": str(start), "object": list(objects)}
        return self._object("GET", f"/queries/{_part(name)}/why", params=parameters)

    def partial_matches(
        self, name: str, objects: Sequence[str] = (), limit: int = 20
    ) -> dict[str, Any]:
        """Return the partial matches of a pattern that have all these ``objects``, the newest
        first."""
        parameters = {"object": list(objects), "limit": limit}
        return self._object("GET", f"/queries/{_part(name)}/partial", params=parameters)

    def register_query(
        self,
        text: str,
        *,
        semantics: str | None = None,
        bounds: str = "(]",
        origin: str | int = 0,
        report: str = "non-empty",
        strategy: str = "fast",
        since: str = "now",
    ) -> dict[str, Any]:
        """Register a continuous query (``REGISTER STREAM|QUERY …``). `events` of the result's
        ``stream`` yields its samples, `query_results` its windows. Equal queries are shared. For
        ``since`` see `request_event`."""
        options = {"semantics": semantics, "bounds": bounds, "origin": origin, "report": report}
        options |= {"strategy": strategy, "since": since}
        parameters = {key: value for key, value in options.items() if value is not None}
        headers = {"Content-Type": SPARQL_QUERY}
        return self._object("POST", "/queries", content=text, headers=headers, params=parameters)

    def queries(self) -> list[dict[str, Any]]:
        """Return the registered queries."""
        return self._list("GET", "/queries")

    def query(self, name: str, *, explain: bool = False) -> dict[str, Any]:
        """Return one registered query; with ``explain`` its stages as ``explanation``."""
        parameters = {"explain": "true"} if explain else {}
        return self._object("GET", f"/queries/{_part(name)}", params=parameters)

    def remove_query(self, name: str) -> None:
        """Remove one registration of a query."""
        self._send("DELETE", f"/queries/{_part(name)}")

    def query_results(
        self,
        name: str,
        *,
        start: str | int | None = None,
        end: str | int | None = None,
        limit: int | None = None,
    ) -> dict[str, Any] | str:
        """Return the result of the last window: SPARQL JSON for SELECT and ASK, Turtle for
        CONSTRUCT. Or those of the kept windows that end from ``start`` to ``end``, the newest
        ``limit``."""
        accept = f"{SPARQL_JSON}, {TURTLE};q=0.9"
        return _json_or_text(self._query_results(name, accept, start, end, limit))

    def query_results_text(self, name: str, media_type: str = CSV, **arguments: Any) -> str:
        """Return the same as text: ``text/csv``, ``text/tab-separated-values``,
        ``application/sparql-results+xml``, ``application/n-triples``, ``application/ld+json``."""
        window_range = [arguments.get(key) for key in ("start", "end", "limit")]
        return self._query_results(name, media_type, *window_range).text

    def match(
        self,
        feature: str,
        *,
        sort: str | None = None,
        objects: Sequence[str] = (),
        strategy: str = "fast",
    ) -> dict[str, Any]:
        """Find a plan for a feature; nothing starts."""
        body = {"feature": feature, "sort": sort, "objects": list(objects), "strategy": strategy}
        return self._object("POST", "/match", json=body)

    def sparql(self, query: str) -> dict[str, Any] | str:
        """Return a SPARQL query's answer: SPARQL JSON for SELECT and ASK, Turtle for graphs."""
        accept = f"{SPARQL_JSON}, {TURTLE};q=0.9"
        headers = {"Content-Type": SPARQL_QUERY, "Accept": accept}
        return _json_or_text(self._send("POST", "/sparql", content=query, headers=headers))

    def explain(
        self,
        *,
        event: str | None = None,
        template: str | None = None,
        query: str | None = None,
        id: str | None = None,
        feature: str | None = None,
    ) -> str:
        """Return the stages of exactly one of these, as text."""
        things = {"event": event, "template": template, "query": query, "id": id}
        things["feature"] = feature
        parameters = {key: value for key, value in things.items() if value is not None}
        return self._send("GET", "/explain", params=parameters, headers={"Accept": TEXT}).text

    def status(self) -> dict[str, Any]:
        """Return an overview of the service."""
        return self._object("GET", "/status")

    def rdf(self, stream: str, *, limit: int | None = None) -> str:
        """Return the history as N-Triples, by the stream's annotation."""
        return self._history(stream, NTRIPLES, {"limit": limit}).text

    # -- helpers

    def _query_results(
        self,
        name: str,
        accept: str,
        start: str | int | None,
        end: str | int | None,
        limit: int | None,
    ) -> httpx.Response:
        bounds = {"from": start, "to": end, "limit": limit}
        parameters = {key: value for key, value in bounds.items() if value is not None}
        path = f"/queries/{_part(name)}/results"
        return self._send("GET", path, params=parameters, headers={"Accept": accept})

    def _history(
        self, stream: str, kind: str, arguments: Mapping[str, str | int | None]
    ) -> httpx.Response:
        unknown = arguments.keys() - _HISTORY_PARAMETERS
        if unknown:
            raise TypeError(f"unknown parameters of a history: {', '.join(sorted(unknown))}")
        names = {"start": "from", "end": "to"}
        parameters = {
            names.get(key, key): value for key, value in arguments.items() if value is not None
        }
        path = f"/streams/{_part(stream)}/samples"
        return self._send("GET", path, params=parameters, headers={"Accept": kind})


_HISTORY_PARAMETERS: Final = frozenset(
    {"start", "end", "valid_from", "valid_to", "limit"}
    | {"at", "before", "prev", "last_avail", "known"}
)


def _json_or_text(response: httpx.Response) -> dict[str, Any] | str:
    if response.headers["content-type"].startswith(SPARQL_JSON):
        results: dict[str, Any] = response.json()
        return results
    return response.text


def _part(name: str) -> str:
    return quote(name, safe="")


def _accepted(stream: str, answer: Mapping[str, Any]) -> int:
    """Return the number of samples in a response; warn of rounded ones."""
    if rounded := answer.get("rounded"):
        warnings.warn(
            f"{stream}: the service rounded {rounded['count']} numbers to the nearest double, "
            f"the first in line {rounded['line']}, field {rounded['field']!r}",
            RoundedNumbers,
            stacklevel=3,
        )
    return int(answer["accepted"])


def _ndjson(samples: Iterable[Mapping[str, Any]] | SampleBatch | bytes, stamp: bool) -> bytes:
    """Encode rows, a batch or lines as NDJSON; ``stamp`` omits a batch's available times."""
    if isinstance(samples, bytes):
        return samples
    # A list has rows: skip the imports of numpy and the encoder of columns.
    if not isinstance(samples, list | tuple):
        from ...converters.ndjson import encode_ndjson
        from ...streams.sample import SampleBatch

        if isinstance(samples, SampleBatch):
            body = encode_ndjson(samples)
            if not stamp:
                return body
            rows = msgspec.json.Decoder(dict[str, Any]).decode_lines(body)
            return msgspec.json.Encoder().encode_lines([_unstamped(row) for row in rows])
    # json, not msgspec: it writes NaN as NaN, which the service refuses; msgspec writes null.
    return "\n".join(json.dumps(row) for row in samples).encode()


def _unstamped(row: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in row.items() if key != "available"}
