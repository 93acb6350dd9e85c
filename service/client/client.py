"""A Python client with the verbs of the HTTP routes (docs/reference/http.md).

    client = dyknow.Client("http://127.0.0.1:8000")
    request = client.request_event("dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)")
    for event in client.events(request["stream"], since=request["position"]):
        print(event.values, event.rdf)

Answers are the JSON of the routes as dicts. Refusals are `ServiceError`. Used by the command line.
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
    sent,
    specification_parts,
    ssl_parts,
)

if TYPE_CHECKING:
    from ...streams.sample import SampleBatch

__all__ = ["URL", "Client", "Event", "RoundedNumbers", "ServiceError"]


class RoundedNumbers(UserWarning):
    """The service has rounded numbers of float fields (docs/reference/formats.md)."""


class Client(Connection):
    """The service's verbs over one HTTP connection pool. Not for several threads at once."""

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
        """Declare a stream: field names and types, how late samples may be, after how long without
        any nobody waits for it, how far ahead of the clock they may be (``"oo"``: any), what is
        kept."""
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
        """All streams."""
        return self._list("GET", "/streams")

    def stream(self, name: str) -> dict[str, Any]:
        """One stream."""
        return self._object("GET", f"/streams/{_part(name)}")

    def evaluation(self, stream: str) -> dict[str, Any]:
        """How far all is that reads a stream, and what of it failed."""
        return self._object("GET", f"/streams/{_part(stream)}/evaluation")

    def remove_stream(self, name: str) -> None:
        """Remove a declared stream, or one of late samples, unless it is read."""
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
        taken twice. Warns of `RoundedNumbers`.
        """
        headers = {
            "Content-Type": NDJSON,
            "Idempotency-Key": idempotency_key or uuid.uuid4().hex,
        }
        answer = self._again(
            "POST",
            f"/streams/{_part(stream)}/samples",
            content=_ndjson(samples, stamp),
            headers=headers,
        )
        return _accepted(stream, answer.json())

    def publish_live(
        self,
        stream: str,
        batches: Iterable[Iterable[Mapping[str, Any]] | SampleBatch | bytes],
        *,
        stamp: bool = False,
    ) -> int:
        """Publish what ``batches`` gives, as it gives it, in one request; returns how many samples
        were accepted once there are no more.

        Nobody is asked in between, so that small batches cost little. A refusal ends it, at the
        latest with the next batch: `ServiceError`, whose ``problem["accepted"]`` counts what was
        taken before. So does a connection that breaks (``httpx.TransportError``): what was taken is
        not known then, and nothing is sent again. Silence is ended by the service; an empty list
        now and then keeps the request. Warns of `RoundedNumbers` when it ends.
        """
        answer = self._send(
            "POST",
            f"/streams/{_part(stream)}/samples/live",
            content=(_ndjson(samples, stamp).rstrip(b"\n") + b"\n" for samples in batches),
            headers={"Content-Type": NDJSON},
        )
        return _accepted(stream, answer.json())

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
        **question: str | int | None,
    ) -> list[dict[str, Any]]:
        """The kept samples by available time; of these those valid from ``valid_from`` to
        ``valid_to``. Or what one of ``at`` and ``before`` (with ``known``), ``prev`` and
        ``last_avail`` asks for [DyKnow10 Def. 5.5-5.7]; see `GET /streams/{name}/samples`.

        Raises `ServiceError` 410 where the answer depends on samples that are forgotten.
        """
        given = {"start": start, "end": end, "limit": limit, **question}
        found: list[dict[str, Any]] = self._history(stream, JSON, given).json()
        return found

    def history_text(self, stream: str, media_type: str = CSV, **arguments: Any) -> str:
        """The same as text: ``text/csv``, ``application/x-ndjson``, ``application/n-triples``."""
        return self._history(stream, media_type, arguments).text

    def events(
        self, stream: str, *, since: str | None = None, resume: bool = True
    ) -> Iterator[Event]:
        """The stream's samples as they come, with `gap` and `end` messages among them.

        Ends after `end`. A connection that breaks is taken up again after the last sample seen,
        unless ``resume`` is False; then its error is raised.
        """
        return self._follow(f"/streams/{_part(stream)}/events", since, resume)

    def follow(self, streams: Sequence[str], *, since: str | None = None) -> Iterator[Event]:
        """The samples of several streams as they come, on one connection; else as `events`.

        Ends after the ``end`` of the last of them. An event's ``data["stream"]`` tells which it is
        of.
        """
        return self._follow("/follow", since, True, streams)

    def status_events(self, *, since: str | None = None) -> Iterator[Event]:
        """Every change of the stream space."""
        return self._follow("/status/events", since, True)

    # -- meaning

    def annotate(self, ssl: str) -> list[dict[str, Any]]:
        """Annotate streams and units by an SSL text; one that is longer than a request may be in
        parts, each of which is taken whole or not at all
        (docs/reference/http-conventions.md, "Sizes")."""
        headers = {"Content-Type": TEXT}
        return joined(
            sent(
                ssl_parts(ssl),
                lambda part: self._list("POST", "/annotations", content=part, headers=headers),
            )
        )

    def describe(
        self, streams: Mapping[str, Any] | Sequence[Mapping[str, Any]]
    ) -> list[dict[str, Any]]:
        """Annotate a stream, or several: ``{"stream", "contents": [{"feature", "field", …}]}``;
        many in parts, as `annotate`."""
        parts = description_parts(streams)
        return joined(sent(parts, lambda part: self._list("POST", "/annotations", json=part)))

    def annotations(self) -> list[dict[str, Any]]:
        """All annotations."""
        return self._list("GET", "/annotations")

    def set_quality(self, stream: str, quality: float) -> None:
        """How good a stream is from now on, 0 to 1."""
        self._send("PUT", f"/streams/{_part(stream)}/quality", json={"quality": quality})

    def register_transformation(
        self, description: Mapping[str, Any] | str, *, replace: str | None = None
    ) -> list[dict[str, Any]]:
        """Register a transformation by its JSON, or one or several by a Turtle text; ``replace``
        names the one that it takes the place of."""
        body: dict[str, Any] = {"json": description}
        if isinstance(description, str):
            body = {"content": description, "headers": {"Content-Type": TURTLE}}
        if replace is None:
            found = self._send("POST", "/transformations", **body).json()
        else:
            found = self._send("PUT", f"/transformations/{_part(replace)}", **body).json()
        registered: list[dict[str, Any]] = found if isinstance(found, list) else [found]
        return registered

    def transformations(self) -> list[dict[str, Any]]:
        """All transformations."""
        return self._list("GET", "/transformations")

    def transformation(self, name: str) -> dict[str, Any]:
        """One transformation."""
        return self._object("GET", f"/transformations/{_part(name)}")

    def change_transformation(
        self, name: str, *, cost: float | None = None, quality: float | None = None
    ) -> dict[str, Any]:
        """The cost or quality of a transformation has changed."""
        body = {"cost": cost, "quality": quality}
        return self._object("PATCH", f"/transformations/{_part(name)}", json=body)

    def remove_transformation(self, name: str) -> None:
        """Forget a transformation, unless a unit of it runs."""
        self._send("DELETE", f"/transformations/{_part(name)}")

    def subscribe(
        self, stream: str, policy: str = "", *, unit: str = "ms", since: str = "now"
    ) -> dict[str, Any]:
        """Subscribe to a stream under a policy as after `with` in KPL; its samples are `events` of
        the answer's ``stream``. ``since`` "start" begins with what is kept, a time or a duration
        such as "30s" before the newest sample there."""
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
        """Subscribe to a feature, whatever streams hold it; its samples and switches are
        `subscription_events`. For ``since`` see `request_event`."""
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
        """One subscription."""
        return self._object("GET", f"/subscriptions/{_part(id)}")

    def subscription_events(
        self, id: str, *, since: str | None = None, resume: bool = True
    ) -> Iterator[Event]:
        """As `events`, of a subscription: of one to a feature with `rematched` between the
        samples, each switch once."""
        return self._follow(f"/subscriptions/{_part(id)}/events", since, resume)

    def rematches(self, id: str) -> list[dict[str, Any]]:
        """The switches of a subscription to a feature, oldest first."""
        return self._list("GET", f"/subscriptions/{_part(id)}/rematches")

    def subscriptions(self) -> list[dict[str, Any]]:
        """The subscriptions that run."""
        return self._list("GET", "/subscriptions")

    def unsubscribe(self, id: str) -> None:
        """Give a subscription up."""
        self._send("DELETE", f"/subscriptions/{_part(id)}")

    def declare_kpl(self, text: str, unit: str = "ms") -> list[dict[str, Any]]:
        """Declare processes and streams in KPL; gives what is new. ``unit`` is what integers are
        where the text does not say. A long text goes in parts, as of `annotate`."""
        given: dict[str, Any] = {"headers": {"Content-Type": TEXT}, "params": {"unit": unit}}
        parts = kpl_parts(text)
        return joined(sent(parts, lambda part: self._list("POST", "/kpl", content=part, **given)))

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

    def apply_specification(self, xml: str | bytes) -> dict[str, Any]:
        """Insert and remove units as an XML text says; all of it or nothing. One that inserts more
        than a request may, and removes nothing, goes in parts, as of `annotate`."""
        headers = {"Content-Type": "application/xml"}
        parts = specification_parts(xml)
        changed, *others = sent(
            parts,
            lambda part: self._object("POST", "/specifications", content=part, headers=headers),
        )
        for other in others:
            for key, found in other.items():
                changed[key] = (
                    changed[key] | found if isinstance(found, dict) else changed[key] + found
                )
        return dict(changed)

    def insertions(self) -> list[dict[str, Any]]:
        """What specifications inserted, in order."""
        return self._list("GET", "/specifications")

    def current_specification(self) -> str:
        """The running configuration as an XML text."""
        return self._send("GET", "/specifications/current").text

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

        ``since`` "start" begins with what the streams keep of their past, a time (ISO-8601 or ns)
        with what was available then or later, a duration such as "30s" so long before the newest
        sample of all streams that are read. 410 where some of that is forgotten. Others may have
        asked before: the answer's ``position``, as ``since`` of `events`, leaves out what came
        until now.
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
        """Register a continuous query (``REGISTER STREAM|QUERY …``); its samples are `events` of
        the answer's ``stream``, its windows `query_results`. The same again is shared. For
        ``since`` see `request_event`."""
        given = {"semantics": semantics, "bounds": bounds, "origin": origin, "report": report}
        given |= {"strategy": strategy, "since": since}
        parameters = {key: value for key, value in given.items() if value is not None}
        headers = {"Content-Type": SPARQL_QUERY}
        return self._object("POST", "/queries", content=text, headers=headers, params=parameters)

    def queries(self) -> list[dict[str, Any]]:
        """The registered queries."""
        return self._list("GET", "/queries")

    def query(self, name: str, *, explain: bool = False) -> dict[str, Any]:
        """One registered query; with ``explain`` each stage of it as ``explanation``."""
        parameters = {"explain": "true"} if explain else {}
        return self._object("GET", f"/queries/{_part(name)}", params=parameters)

    def remove_query(self, name: str) -> None:
        """Give a registered query up."""
        self._send("DELETE", f"/queries/{_part(name)}")

    def query_results(
        self,
        name: str,
        *,
        start: str | int | None = None,
        end: str | int | None = None,
        limit: int | None = None,
    ) -> dict[str, Any] | str:
        """The result of the last window: SPARQL JSON for SELECT and ASK, Turtle for CONSTRUCT. Or
        those of the kept windows that end from ``start`` to ``end``, the newest ``limit``."""
        accept = f"{SPARQL_JSON}, {TURTLE};q=0.9"
        answer = self._query_results(name, accept, start, end, limit)
        if answer.headers["content-type"].startswith(SPARQL_JSON):
            found: dict[str, Any] = answer.json()
            return found
        return answer.text

    def query_results_text(self, name: str, media_type: str = CSV, **arguments: Any) -> str:
        """The same as text: ``text/csv``, ``text/tab-separated-values``,
        ``application/sparql-results+xml``, ``application/n-triples``, ``application/ld+json``."""
        wanted = [arguments.get(key) for key in ("start", "end", "limit")]
        return self._query_results(name, media_type, *wanted).text

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
        return self._history(stream, NTRIPLES, {"limit": limit}).text

    # -- within

    def _query_results(
        self,
        name: str,
        accept: str,
        start: str | int | None,
        end: str | int | None,
        limit: int | None,
    ) -> httpx.Response:
        given = {"from": start, "to": end, "limit": limit}
        parameters = {key: value for key, value in given.items() if value is not None}
        path = f"/queries/{_part(name)}/results"
        return self._send("GET", path, params=parameters, headers={"Accept": accept})

    def _history(
        self, stream: str, kind: str, given: Mapping[str, str | int | None]
    ) -> httpx.Response:
        unknown = given.keys() - _QUESTIONS
        if unknown:
            raise TypeError(f"no question about a history: {', '.join(sorted(unknown))}")
        names = {"start": "from", "end": "to"}
        parameters = {
            names.get(key, key): value for key, value in given.items() if value is not None
        }
        path = f"/streams/{_part(stream)}/samples"
        return self._send("GET", path, params=parameters, headers={"Accept": kind})


_QUESTIONS: Final = frozenset(
    {"start", "end", "valid_from", "valid_to", "limit"}
    | {"at", "before", "prev", "last_avail", "known"}
)


def _part(name: str) -> str:
    return quote(name, safe="")


def _accepted(stream: str, answer: Mapping[str, Any]) -> int:
    """How many samples an answer counts; warns of those that were rounded."""
    if rounded := answer.get("rounded"):
        warnings.warn(
            f"{stream}: the service rounded {rounded['count']} numbers to the nearest double, "
            f"the first in line {rounded['line']}, field {rounded['field']!r}",
            RoundedNumbers,
            stacklevel=3,
        )
    return int(answer["accepted"])


def _ndjson(samples: Iterable[Mapping[str, Any]] | SampleBatch | bytes, stamp: bool) -> bytes:
    """Rows, a batch or lines, as lines; ``stamp`` leaves a batch's available times out."""
    if isinstance(samples, bytes):
        return samples
    # Rows in a list are no batch, and need neither numpy nor what encodes its columns.
    if not isinstance(samples, list | tuple):
        from ...converters.ndjson import encode_ndjson
        from ...streams.sample import SampleBatch

        if isinstance(samples, SampleBatch):
            body = encode_ndjson(samples)
            if not stamp:
                return body
            rows = msgspec.json.Decoder(dict[str, Any]).decode_lines(body)
            return msgspec.json.Encoder().encode_lines([_unstamped(row) for row in rows])
    # json, not msgspec: it writes NaN as NaN, for the service to refuse, not as null.
    return "\n".join(json.dumps(row) for row in samples).encode()


def _unstamped(row: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in row.items() if key != "available"}
