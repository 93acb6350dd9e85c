"""The verbs of both clients, one for each HTTP route (docs/reference/http.md).

The file is long because it is a list: a verb is its arguments, a docstring and a request, and none
needs another. Most verbs return the flow of one request; those with several are generators.
"""

from __future__ import annotations

import uuid
import warnings
from collections.abc import AsyncIterable, AsyncIterator, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, Unpack
from urllib.parse import quote

import httpx

from ..config.media_types import (
    CSV,
    JSON,
    NDJSON,
    NTRIPLES,
    POSITION,
    SPARQL_JSON,
    SPARQL_QUERY,
    TEXT,
    TURTLE,
)
from .event_streams import Delivery, EventSource
from .flows import (
    Flow,
    feed,
    read_list,
    read_object,
    read_text,
    send,
    send_until_room,
    verb,
)
from .parts import (
    description_parts,
    kpl_parts,
    send_lists,
    send_parts,
    specification_parts,
    ssl_parts,
)
from .samples import ndjson
from .tables import History, SparqlResult

if TYPE_CHECKING:
    from .samples import Samples


class RoundedNumbers(UserWarning):
    """The service has rounded numbers of float fields (docs/reference/formats.md)."""


class Routes:
    """The verbs of both clients, each a flow (`flows`)."""

    # -- streams and samples

    @verb
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
    ) -> Flow[dict[str, Any]]:
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
        return read_object("PUT", f"/streams/{_part(name)}", json=body)

    @verb
    def put_rdf_stream(
        self, /, name: str, *, time: str | None = None, **settings: Any
    ) -> Flow[dict[str, Any]]:
        """Declare a stream of RDF. ``time``: the property (IRI) that gives the times of statements;
        ``settings``: ``lateness``, ``idle``, ``ahead`` and ``retention`` as for `put_stream`."""
        body = {"kind": "rdf", **settings, **({} if time is None else {"time": time})}
        return read_object("PUT", f"/streams/{_part(name)}", json=body)

    @verb
    def publish_rdf(
        self,
        stream: str,
        text: str | bytes,
        media_type: str = TURTLE,
        *,
        create: bool = False,
        idempotency_key: str | None = None,
    ) -> Flow[int]:
        """Publish a text of RDF (docs/reference/formats.md); return the number of its statements.

        ``media_type``: ``text/turtle``, ``application/trig``, ``application/n-triples``,
        ``application/n-quads`` or ``application/ld+json``. ``create`` makes a missing stream.
        Repeats the request as `publish` does.
        """
        headers = {
            "Content-Type": media_type,
            "Idempotency-Key": idempotency_key or uuid.uuid4().hex,
        }
        response = yield from send_until_room(
            "POST",
            f"/streams/{_part(stream)}/samples",
            content=text.encode() if isinstance(text, str) else text,
            params={"create": "rdf"} if create else {},
            headers=headers,
        )
        accepted: int = response.json()["accepted"]
        return accepted

    @verb
    def streams(self, *, fields: Sequence[str] | None = None) -> Flow[list[dict[str, Any]]]:
        """Return all streams, with only these members (``fields``) if there are any."""
        return read_list("GET", "/streams", params={"fields": fields} if fields else {})

    @verb
    def changed_streams(
        self, position: str = "start", *, fields: Sequence[str] | None = None
    ) -> Flow[tuple[list[dict[str, Any]], str]]:
        """Return the streams that have changed since ``position``, and the position after them for
        the next call. A removed stream is in no result: `status_events` reports it."""
        parameters = {"changed": position, **({"fields": fields} if fields else {})}
        response = yield from send("GET", "/streams", params=parameters, headers={"Accept": JSON})
        return response.json(), response.headers[POSITION]

    @verb
    def stream(self, name: str) -> Flow[dict[str, Any]]:
        """Return one stream."""
        return read_object("GET", f"/streams/{_part(name)}")

    @verb
    def evaluation(self, stream: str) -> Flow[dict[str, Any]]:
        """Return how far the readers of a stream have evaluated it, and which of them failed."""
        return read_object("GET", f"/streams/{_part(stream)}/evaluation")

    @verb
    def remove_stream(self, name: str) -> Flow[None]:
        """Remove a declared stream, or one of late samples. A stream with readers stays: 409."""
        yield from send("DELETE", f"/streams/{_part(name)}")

    @verb
    def publish(
        self,
        stream: str,
        samples: Samples,
        *,
        idempotency_key: str | None = None,
        stamp: bool = False,
    ) -> Flow[int]:
        """Publish rows, a batch, a DataFrame or NDJSON bytes; return the number of accepted
        samples.

        Times of rows are ISO-8601, ``datetime`` with a time zone, integers (ns), or floats: seconds
        since 1970 as of ``time.time()``. Raises `BadTime` for one that is not clear.

        A batch has its own available times; with ``stamp`` the service stamps it instead. The
        client repeats a request that is refused for a full queue (429) or loses its connection,
        under the same key, so that the service accepts the samples once. Warns of `RoundedNumbers`.
        """
        headers = {
            "Content-Type": NDJSON,
            "Idempotency-Key": idempotency_key or uuid.uuid4().hex,
        }
        response = yield from send_until_room(
            "POST",
            f"/streams/{_part(stream)}/samples",
            content=ndjson(samples, stamp),
            headers=headers,
        )
        return _accepted(stream, response.json())

    @verb
    def publish_live(
        self,
        stream: str,
        batches: Iterable[Samples] | AsyncIterable[Samples],
        *,
        stamp: bool = False,
    ) -> Flow[int]:
        """Publish the items of ``batches`` as they come, in one request; returns the number of
        accepted samples after the last.

        There is no response in between, so small batches cost little. A refusal ends the request,
        at the latest with the next batch: `ServiceError`, with the number of accepted samples in
        ``problem["accepted"]``. A broken connection (``httpx.TransportError``) ends it too; then
        that number is unknown, and the client repeats nothing. The service ends a silent request;
        yield an empty list now and then to keep it. Warns of `RoundedNumbers` when it ends.
        """
        response = yield from send(
            "POST",
            f"/streams/{_part(stream)}/samples/live",
            content=_bodies(batches, stamp),
            headers={"Content-Type": NDJSON},
        )
        return _accepted(stream, response.json())

    @verb
    def end(self, stream: str) -> Flow[None]:
        """End a stream, such as that of a recording."""
        yield from send("POST", f"/streams/{_part(stream)}/end")

    @verb
    def history(
        self,
        /,
        stream: str,
        *,
        start: str | int | None = None,
        end: str | int | None = None,
        limit: int | None = None,
        **query: str | int | Sequence[str] | None,
    ) -> Flow[History]:
        """Return samples of the history by available time, with valid times from ``valid_from`` to
        ``valid_to``, about an ``object``, and with only some ``fields``. With ``every`` (``"10s"``)
        return a row for each object and interval: the last sample, and minimum and maximum of each
        number. Or one of these queries: ``at`` or ``before`` (with ``known``), ``prev``,
        ``last_avail`` [DyKnow10 Def. 5.5-5.7]; see `GET /streams/{name}/samples`.

        Raises `ServiceError` 410 if the result depends on evicted samples.
        """
        arguments = {"start": start, "end": end, "limit": limit, **query}
        return History((yield from _history(stream, JSON, arguments)).json())

    @verb
    def history_text(self, /, stream: str, media_type: str = CSV, **arguments: Any) -> Flow[str]:
        """Return the same as text: ``text/csv``, ``application/x-ndjson``,
        ``application/n-triples``, ``application/ld+json``."""
        return (yield from _history(stream, media_type, arguments)).text

    @feed
    def events(
        self,
        stream: str,
        *,
        since: str | None = None,
        resume: bool = True,
        **delivery: Unpack[Delivery],
    ) -> EventSource:
        """Yield the stream's samples as they come, and `gap` and `end` messages. ``last`` begins
        with the newest samples; ``rdf``, ``fields`` and ``every`` make it less (`Delivery`).

        Returns after `end`. After a broken connection the client resumes behind the last sample; if
        ``resume`` is False it raises the error instead.
        """
        path = f"/streams/{_part(stream)}/events"
        return EventSource(path, since, resume, delivery=delivery)

    @feed
    def follow(
        self,
        streams: Sequence[str],
        *,
        since: str | None = None,
        **delivery: Unpack[Delivery],
    ) -> EventSource:
        """Yield the samples of several streams as they come, on one connection; cf. `events`.

        Returns after the last stream's ``end``. An event's ``data["stream"]`` names its stream.
        """
        return EventSource("/follow", since, streams=tuple(streams), delivery=delivery)

    @feed
    def status_events(self, *, since: str | None = None) -> EventSource:
        """Yield every change of the stream space."""
        return EventSource("/status/events", since, True)

    @verb
    def graph(self, around: str | None = None, depth: int | None = None) -> Flow[dict[str, Any]]:
        """Return what runs as ``nodes`` (streams, units, requests, queries, subscriptions) and
        ``edges``; with ``around`` what feeds the nodes of this name and what they feed, at most
        ``depth`` edges away."""
        bounds = {"around": around, "depth": depth}
        parameters = {key: value for key, value in bounds.items() if value is not None}
        return read_object("GET", "/graph", params=parameters)

    # -- meaning

    @verb
    def annotate(self, ssl: str) -> Flow[list[dict[str, Any]]]:
        """Annotate streams and units by an SSL text. The client sends a long text in parts, each of
        which takes effect as a whole or not at all
        (docs/reference/http-conventions.md, "Sizes")."""
        headers = {"Content-Type": TEXT}
        return send_lists(
            ssl_parts(ssl),
            lambda part: read_list("POST", "/annotations", content=part, headers=headers),
        )

    @verb
    def describe(
        self, streams: Mapping[str, Any] | Sequence[Mapping[str, Any]]
    ) -> Flow[list[dict[str, Any]]]:
        """Annotate one or several streams: ``{"stream", "contents": [{"feature", "field", …}]}``;
        many in parts, as in `annotate`."""
        parts = description_parts(streams)
        return send_lists(parts, lambda part: read_list("POST", "/annotations", json=part))

    @verb
    def annotations(self) -> Flow[list[dict[str, Any]]]:
        """Return all annotations."""
        return read_list("GET", "/annotations")

    @verb
    def set_quality(self, stream: str, quality: float) -> Flow[None]:
        """Set the quality of a stream, 0 to 1."""
        yield from send("PUT", f"/streams/{_part(stream)}/quality", json={"quality": quality})

    @verb
    def register_transformation(
        self, description: Mapping[str, Any] | str, *, replace: str | None = None
    ) -> Flow[list[dict[str, Any]]]:
        """Register a transformation by its JSON, or one or several by a Turtle text; ``replace``
        is the name of one to replace."""
        body: dict[str, Any] = {"json": description}
        if isinstance(description, str):
            body = {"content": description, "headers": {"Content-Type": TURTLE}}
        if replace is None:
            response = yield from send("POST", "/transformations", **body)
        else:
            response = yield from send("PUT", f"/transformations/{_part(replace)}", **body)
        body_json = response.json()
        registered: list[dict[str, Any]] = body_json if isinstance(body_json, list) else [body_json]
        return registered

    @verb
    def transformations(self) -> Flow[list[dict[str, Any]]]:
        """Return all transformations."""
        return read_list("GET", "/transformations")

    @verb
    def transformation(self, name: str) -> Flow[dict[str, Any]]:
        """Return one transformation."""
        return read_object("GET", f"/transformations/{_part(name)}")

    @verb
    def change_transformation(
        self, name: str, *, cost: float | None = None, quality: float | None = None
    ) -> Flow[dict[str, Any]]:
        """Change the cost or quality of a transformation."""
        body = {"cost": cost, "quality": quality}
        return read_object("PATCH", f"/transformations/{_part(name)}", json=body)

    @verb
    def remove_transformation(self, name: str) -> Flow[None]:
        """Remove a transformation. One with a running unit stays: 409."""
        yield from send("DELETE", f"/transformations/{_part(name)}")

    @verb
    def subscribe(
        self, stream: str, policy: str = "", *, unit: str = "ms", since: str = "now"
    ) -> Flow[dict[str, Any]]:
        """Subscribe to a stream under a policy as after `with` in KPL. `events` of the result's
        ``stream`` yields its samples. ``since``: "start" begins with the whole history, a time or a
        duration such as "30s" before the newest sample there."""
        body = {"stream": stream, "policy": policy, "unit": unit, "since": since}
        return read_object("POST", "/subscriptions", json=body)

    @verb
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
    ) -> Flow[dict[str, Any]]:
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
        return read_object("POST", "/subscriptions", json=body)

    @verb
    def subscription(self, id: str) -> Flow[dict[str, Any]]:
        """Return one subscription."""
        return read_object("GET", f"/subscriptions/{_part(id)}")

    @feed
    def query_events(
        self, name: str, *, since: str | None = None, resume: bool = True
    ) -> EventSource:
        """Yield the results of a query as they come, an event a window: `result`, whose ``data``
        has ``window_end`` and SPARQL JSON, or N-Triples in ``graph``. Resumes as `events`."""
        return EventSource(f"/queries/{_part(name)}/results/events", since, resume)

    @feed
    def subscription_events(
        self,
        id: str,
        *,
        since: str | None = None,
        resume: bool = True,
        **delivery: Unpack[Delivery],
    ) -> EventSource:
        """Yield the events of a subscription, as `events` does; for a feature also `rematched`
        between the samples, each switch once."""
        path = f"/subscriptions/{_part(id)}/events"
        return EventSource(path, since, resume, delivery=delivery)

    @verb
    def rematches(self, id: str) -> Flow[list[dict[str, Any]]]:
        """Return the latest switches of a subscription to a feature, oldest first."""
        return read_list("GET", f"/subscriptions/{_part(id)}/rematches")

    @verb
    def subscriptions(self) -> Flow[list[dict[str, Any]]]:
        """Return the running and the waiting subscriptions."""
        return read_list("GET", "/subscriptions")

    @verb
    def unsubscribe(self, id: str) -> Flow[None]:
        """Cancel a subscription."""
        yield from send("DELETE", f"/subscriptions/{_part(id)}")

    @verb
    def declare_kpl(self, text: str, unit: str = "ms") -> Flow[list[dict[str, Any]]]:
        """Declare processes and streams in KPL; returns the new declarations. ``unit`` is the unit
        of integers if the text has none. A long text goes in parts, as in `annotate`."""
        request: dict[str, Any] = {"headers": {"Content-Type": TEXT}, "params": {"unit": unit}}
        parts = kpl_parts(text)
        return send_lists(parts, lambda part: read_list("POST", "/kpl", content=part, **request))

    @verb
    def kpl(self) -> Flow[list[dict[str, Any]]]:
        """Return all KPL declarations, in order."""
        return read_list("GET", "/kpl")

    @verb
    def kpl_declaration(self, name: str) -> Flow[dict[str, Any]]:
        """Return one declaration by name or label, with those that depend on it."""
        return read_object("GET", f"/kpl/{_part(name)}")

    @verb
    def remove_kpl(self, name: str, *, cascade: bool = False) -> Flow[list[str]]:
        """Remove a declaration, and with ``cascade`` those that depend on it; return the names."""
        parameters = {"cascade": str(cascade).lower()}
        response = yield from read_object("DELETE", f"/kpl/{_part(name)}", params=parameters)
        removed: list[str] = response["removed"]
        return removed

    @verb
    def apply_specification(self, xml: str | bytes) -> Flow[dict[str, Any]]:
        """Insert and remove units by an XML text, as a whole or not at all. A text without removals
        and with more insertions than a request may have goes in parts, as in `annotate`."""
        headers = {"Content-Type": "application/xml"}
        parts = specification_parts(xml)
        changed, *others = yield from send_parts(
            parts,
            lambda part: read_object("POST", "/specifications", content=part, headers=headers),
        )
        for other in others:
            for key, value in other.items():
                changed[key] = (
                    changed[key] | value if isinstance(value, dict) else changed[key] + value
                )
        return dict(changed)

    @verb
    def insertions(self) -> Flow[list[dict[str, Any]]]:
        """Return the insertions of specifications, in order."""
        return read_list("GET", "/specifications")

    @verb
    def current_specification(self) -> Flow[str]:
        """Return the running configuration as an XML text."""
        return read_text("GET", "/specifications/current")

    @verb
    def load_ontology(
        self, text: str, name: str | None = None, media_type: str = TURTLE
    ) -> Flow[dict[str, Any]]:
        """Add or replace a domain ontology; its default ``name`` is the IRI of the text's one
        owl:Ontology. ``media_type``: Turtle, RDF/XML, JSON-LD or N-Triples."""
        parameters = {} if name is None else {"name": name}
        headers = {"Content-Type": media_type}
        return read_object("POST", "/ontologies", content=text, headers=headers, params=parameters)

    @verb
    def ontologies(self) -> Flow[list[str]]:
        """Return the names of the loaded ontologies."""
        names: list[str] = (yield from send("GET", "/ontologies")).json()
        return names

    @verb
    def ontology(self, name: str) -> Flow[str]:
        """Return the triples of a loaded ontology as Turtle."""
        path = f"/ontologies/{_part(name)}"
        return read_text("GET", path, headers={"Accept": TURTLE})

    @verb
    def remove_ontology(self, name: str) -> Flow[None]:
        """Remove an ontology. One whose terms are used stays: 409, and ``problem["used_by"]``."""
        yield from send("DELETE", f"/ontologies/{_part(name)}")

    @verb
    def vocabulary(self) -> Flow[dict[str, Any]]:
        """Return the ``sorts``, ``features`` and ``events`` that texts may name."""
        return read_object("GET", "/vocabulary")

    @verb
    def objects(
        self, sort: str | None = None, *, after: str | None = None, limit: int = 100
    ) -> Flow[dict[str, Any]]:
        """Return a page of the known ``objects``, of a sort and the sorts below it or of any; with
        ``more``, ask for the next page ``after`` the IRI of the last one."""
        query = {"sort": sort, "after": after, "limit": limit}
        parameters = {key: value for key, value in query.items() if value is not None}
        return read_object("GET", "/objects", params=parameters)

    @verb
    def object(self, name: str) -> Flow[dict[str, Any]]:
        """Return the sorts of an object, and the newest value of each of its features."""
        return read_object("GET", f"/objects/{_part(name)}")

    @verb
    def ontology_report(self) -> Flow[dict[str, Any]]:
        """Validate the stream space: ``conforms``, and the ``violations``."""
        return read_object("GET", "/ontologies/report")

    @verb
    def register_template(self, text: str, *, replace: str | None = None) -> Flow[dict[str, Any]]:
        """Register an event template; ``replace`` is the name of one to replace."""
        headers = {"Content-Type": TEXT}
        if replace is None:
            return read_object("POST", "/templates", content=text, headers=headers)
        return read_object("PUT", f"/templates/{_part(replace)}", content=text, headers=headers)

    @verb
    def templates(self) -> Flow[list[dict[str, Any]]]:
        """Return all templates."""
        return read_list("GET", "/templates")

    @verb
    def template(self, name: str) -> Flow[dict[str, Any]]:
        """Return one template, by local name or IRI."""
        return read_object("GET", f"/templates/{_part(name)}")

    @verb
    def remove_template(self, name: str) -> Flow[None]:
        """Remove a template."""
        yield from send("DELETE", f"/templates/{_part(name)}")

    @verb
    def request_event(
        self,
        event: str,
        arguments: Sequence[str] | None = None,
        *,
        strategy: str = "fast",
        since: str = "now",
    ) -> Flow[dict[str, Any]]:
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
            return read_object("POST", "/events", content=event, headers=headers, params=parameters)
        body: dict[str, Any] = {"event": event, "arguments": list(arguments)}
        body |= {"strategy": strategy, "since": since}
        return read_object("POST", "/events", json=body)

    @verb
    def requests(self) -> Flow[list[dict[str, Any]]]:
        """Return the running and the waiting event requests."""
        return read_list("GET", "/events")

    @verb
    def request(self, id: str) -> Flow[dict[str, Any]]:
        """Return one event request."""
        return read_object("GET", f"/events/{_part(id)}")

    @verb
    def cancel_event(self, id: str) -> Flow[None]:
        """Cancel an event request."""
        yield from send("DELETE", f"/events/{_part(id)}")

    @verb
    def why(self, name: str, start: str | int, objects: Sequence[str] = ()) -> Flow[dict[str, Any]]:
        """Return the explanation of a monitor's verdict: the one that starts at the time ``start``
        (ISO-8601 or ns) for these ``objects``, one for each parameter in order. Of a pattern, that
        of the matches that start, or are valid, then."""
        parameters = {"start": str(start), "object": list(objects)}
        return read_object("GET", f"/queries/{_part(name)}/why", params=parameters)

    @verb
    def event_why(
        self, id: str, start: str | int, objects: Sequence[str] = ()
    ) -> Flow[dict[str, Any]]:
        """Return the same for a request whose template is a formula or a pattern."""
        parameters = {"start": str(start), "object": list(objects)}
        return read_object("GET", f"/events/{_part(id)}/why", params=parameters)

    @verb
    def event_partial_matches(
        self, id: str, objects: Sequence[str] = (), limit: int = 20
    ) -> Flow[dict[str, Any]]:
        """Return the partial matches of a request whose template is a pattern: see
        `partial_matches`."""
        parameters = {"object": list(objects), "limit": limit}
        return read_object("GET", f"/events/{_part(id)}/partial", params=parameters)

    @verb
    def partial_matches(
        self, name: str, objects: Sequence[str] = (), limit: int = 20
    ) -> Flow[dict[str, Any]]:
        """Return the partial matches of a pattern that have all these ``objects``, the newest
        first."""
        parameters = {"object": list(objects), "limit": limit}
        return read_object("GET", f"/queries/{_part(name)}/partial", params=parameters)

    @verb
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
    ) -> Flow[dict[str, Any]]:
        """Register a continuous query (``REGISTER STREAM|QUERY …``). `events` of the result's
        ``stream`` yields its samples, `query_results` its windows. Equal queries are shared. For
        ``since`` see `request_event`."""
        options = {"semantics": semantics, "bounds": bounds, "origin": origin, "report": report}
        options |= {"strategy": strategy, "since": since}
        parameters = {key: value for key, value in options.items() if value is not None}
        headers = {"Content-Type": SPARQL_QUERY}
        return read_object("POST", "/queries", content=text, headers=headers, params=parameters)

    @verb
    def queries(self) -> Flow[list[dict[str, Any]]]:
        """Return the registered queries."""
        return read_list("GET", "/queries")

    @verb
    def query(self, name: str, *, explain: bool = False) -> Flow[dict[str, Any]]:
        """Return one registered query; with ``explain`` its stages as ``explanation``."""
        parameters = {"explain": "true"} if explain else {}
        return read_object("GET", f"/queries/{_part(name)}", params=parameters)

    @verb
    def remove_query(self, name: str) -> Flow[None]:
        """Remove one registration of a query."""
        yield from send("DELETE", f"/queries/{_part(name)}")

    @verb
    def query_results(
        self,
        name: str,
        *,
        start: str | int | None = None,
        end: str | int | None = None,
        limit: int | None = None,
    ) -> Flow[SparqlResult | str]:
        """Return the result of the last window: SPARQL JSON for SELECT and ASK, Turtle for
        CONSTRUCT. Or those of the kept windows that end from ``start`` to ``end``, the newest
        ``limit``."""
        accept = f"{SPARQL_JSON}, {TURTLE};q=0.9"
        return _result(_query_results(name, accept, start, end, limit))

    @verb
    def query_results_text(
        self, /, name: str, media_type: str = CSV, **arguments: Any
    ) -> Flow[str]:
        """Return the same as text: ``text/csv``, ``text/tab-separated-values``,
        ``application/sparql-results+xml``, ``application/n-triples``, ``application/ld+json``."""
        window_range = [arguments.get(key) for key in ("start", "end", "limit")]
        return (yield from _query_results(name, media_type, *window_range)).text

    @verb
    def match(
        self,
        feature: str,
        *,
        sort: str | None = None,
        objects: Sequence[str] = (),
        strategy: str = "fast",
    ) -> Flow[dict[str, Any]]:
        """Find a plan for a feature; nothing starts."""
        body = {"feature": feature, "sort": sort, "objects": list(objects), "strategy": strategy}
        return read_object("POST", "/match", json=body)

    @verb
    def sparql(
        self,
        query: str,
        *,
        default_graphs: Sequence[str] = (),
        named_graphs: Sequence[str] = (),
        parameters: Mapping[str, str] | None = None,
    ) -> Flow[SparqlResult | str]:
        """Return a SPARQL query's answer: SPARQL JSON for SELECT and ASK, Turtle for graphs.
        The graphs, by their IRIs, are read instead of those of FROM and FROM NAMED. A parameter
        stands for a variable: ``{"name": '"gps"', "sort": "dyknow:UAV", "limit": "100"}``."""
        accept = f"{SPARQL_JSON}, {TURTLE};q=0.9"
        return _result(_sparql(query, accept, default_graphs, named_graphs, parameters or {}))

    @verb
    def sparql_text(
        self,
        query: str,
        media_type: str,
        *,
        default_graphs: Sequence[str] = (),
        named_graphs: Sequence[str] = (),
        parameters: Mapping[str, str] | None = None,
    ) -> Flow[str]:
        """Return the same as text: ``text/csv``, ``application/rdf+xml`` and so on."""
        found = yield from _sparql(
            query, media_type, default_graphs, named_graphs, parameters or {}
        )
        return found.text

    @verb
    def describe_sparql(self) -> Flow[str]:
        """Return the Service Description of ``/sparql`` as Turtle: its formats and graphs."""
        return read_text("GET", "/sparql", headers={"Accept": TURTLE})

    @verb
    def explain(
        self,
        *,
        event: str | None = None,
        template: str | None = None,
        query: str | None = None,
        id: str | None = None,
        feature: str | None = None,
        since: str | None = None,
    ) -> Flow[str]:
        """Return the stages of exactly one of these, as text. With ``since`` (``start``, a time, a
        duration) also how often an event or a query would have fired on what is kept."""
        things = {"event": event, "template": template, "query": query, "id": id}
        body = things | {"feature": feature, "since": since}
        return read_text("POST", "/explain", json=body, headers={"Accept": TEXT})

    @verb
    def explanation(self, /, **thing: str | None) -> Flow[dict[str, Any]]:
        """Return the same as ``text``, ``stages`` and ``plan``, a tree of what was considered. Of a
        feature also for a ``sort``, and by a ``strategy``; with ``since`` also ``tried``.

        Raises `ServiceError` 422 if there is no plan; its ``problem`` has the same members, and
        ``missing``."""
        return read_object("POST", "/explain", json=thing, headers={"Accept": JSON})

    @verb
    def http_requests(self, *, status: int = 100, limit: int = 200) -> Flow[list[dict[str, Any]]]:
        """Return the newest HTTP requests that the service has answered, newest first: those with
        ``status`` or a greater one."""
        return read_list("GET", "/requests", params={"status": status, "limit": limit})

    @verb
    def journal(self) -> Flow[dict[str, Any]]:
        """Return what the data directory holds; ``recording`` is false without one."""
        return read_object("GET", "/journal")

    @verb
    def status(self) -> Flow[dict[str, Any]]:
        """Return an overview of the service."""
        return read_object("GET", "/status")

    @verb
    def rdf(self, stream: str, *, limit: int | None = None) -> Flow[str]:
        """Return the history as N-Triples, by the stream's annotation."""
        return (yield from _history(stream, NTRIPLES, {"limit": limit})).text


def _sparql(
    query: str,
    accept: str,
    default_graphs: Sequence[str],
    named_graphs: Sequence[str],
    parameters: Mapping[str, str],
) -> Flow[httpx.Response]:
    chosen: dict[str, str | list[str]] = {
        f"${name.lstrip('$?')}": term for name, term in parameters.items()
    }
    chosen |= {"default-graph-uri": list(default_graphs), "named-graph-uri": list(named_graphs)}
    headers = {"Content-Type": SPARQL_QUERY, "Accept": accept}
    return send("POST", "/sparql", params=chosen, content=query, headers=headers)


def _query_results(
    name: str,
    accept: str,
    start: str | int | None,
    end: str | int | None,
    limit: int | None,
) -> Flow[httpx.Response]:
    bounds = {"from": start, "to": end, "limit": limit}
    parameters = {key: value for key, value in bounds.items() if value is not None}
    path = f"/queries/{_part(name)}/results"
    return send("GET", path, params=parameters, headers={"Accept": accept})


def _history(
    stream: str, kind: str, arguments: Mapping[str, str | int | Sequence[str] | None]
) -> Flow[httpx.Response]:
    unknown = arguments.keys() - _HISTORY_PARAMETERS
    if unknown:
        raise TypeError(f"unknown parameters of a history: {', '.join(sorted(unknown))}")
    names = {"start": "from", "end": "to"}
    parameters = {
        names.get(key, key): value for key, value in arguments.items() if value is not None
    }
    path = f"/streams/{_part(stream)}/samples"
    return send("GET", path, params=parameters, headers={"Accept": kind})


_HISTORY_PARAMETERS: Final = frozenset(
    {"start", "end", "valid_from", "valid_to", "limit", "object", "fields", "every"}
    | {"at", "before", "prev", "last_avail", "known"}
)


def _bodies(
    batches: Iterable[Samples] | AsyncIterable[Samples], stamp: bool
) -> Iterator[bytes] | AsyncIterator[bytes]:
    """Return the NDJSON of batches, each with the end of its last line."""

    def body(samples: Samples) -> bytes:
        return ndjson(samples, stamp).rstrip(b"\n") + b"\n"

    if isinstance(batches, AsyncIterable):
        return (body(samples) async for samples in batches)
    return (body(samples) for samples in batches)


def _result(flow: Flow[httpx.Response]) -> Flow[SparqlResult | str]:
    """Return SPARQL JSON as a table, and a graph as text."""
    response = yield from flow
    if response.headers["content-type"].startswith(SPARQL_JSON):
        return SparqlResult(response.json())
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
            # Of `_accepted`, the flow, `_run`, the method and its caller, the last.
            stacklevel=5,
        )
    return int(answer["accepted"])
