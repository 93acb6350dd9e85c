"""``dyknow events``: request an event and follow it, or list the requests."""

from __future__ import annotations

import signal
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .output import (
    DEFAULT_URL,
    Json,
    Url,
    clock_of,
    connect,
    err,
    ignore_gone,
    show_json,
    show_lines,
    show_table,
    show_text,
    show_values,
)
from .parameters import NOW, Beginning

if TYPE_CHECKING:
    from ..client.client import Client, Event

NO_UNIT = "no_unit"
"""The unit of plain counts and ratios."""
STRATEGY: Any = typer.Option(
    help="The strategy that chooses a plan: fast, cost, quality, weighted; with parameters: "
    "weighted:cost=1,quality=10, cost:subscribers=0.1."
)


def events(
    request: Annotated[
        str | None,
        typer.Argument(help="Such as 'dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)'."),
    ] = None,
    strategy: Annotated[str, STRATEGY] = "fast",
    since: Beginning = "now",
    count: Annotated[
        int | None, typer.Option("--count", "-n", min=1, help="Stop after this number of events.")
    ] = None,
    follow: Annotated[
        bool,
        typer.Option(help="Follow the events; otherwise leave the request running."),
    ] = True,
    keep: Annotated[bool, typer.Option(help="Leave the request running afterwards.")] = False,
    cancel: Annotated[
        str | None, typer.Option(help="Cancel the request of this id.", metavar="ID")
    ] = None,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Request an event and follow it; without an argument, list the requests that run."""
    if cancel is not None and request is not None:
        raise typer.BadParameter("--cancel takes the id of a request, and no further argument")
    with connect(url) as client, stoppable():
        if cancel is not None:
            client.cancel_event(cancel)
            if as_json:
                show_json({"cancelled": cancel})
            else:
                show_text(f"cancelled {cancel}")
            return
        if request is None:
            _list(client, as_json)
            return
        view = client.request_event(request, strategy=strategy, since=since)
        if not follow:
            if as_json:
                show_json(view)
            else:
                _show_request(view)
            return
        try:
            if not as_json:
                _show_request(view)
                err().print("waiting for events; Ctrl-C ends", markup=False)
            # An earlier equal request may share the stream: skip the events before this one.
            begin = view["position"] if since == NOW else "start"
            units = None if as_json else stream_units(client, view["stream"])
            messages = client.events(view["stream"], since=begin)
            seen = show_events(messages, count, as_json, units)
            if not seen and since == NOW and not as_json:
                # The streams that it reads have ended, so it ends at once.
                hint = "the recording has ended; --since start begins with its past"
                err().print(f"hint: {hint}", markup=False)
            elif not seen and not as_json:
                _say_why_empty(client, view["id"])
        except KeyboardInterrupt:
            err().print("stopped", markup=False)
            if not as_json:
                with ignore_gone():
                    _say_why_empty(client, view["id"])
        finally:
            if not keep:
                with ignore_gone():
                    client.cancel_event(view["id"])


def _say_why_empty(client: Client, id: str) -> None:
    show_emptiness(client.request(id)["empty"])


def show_emptiness(why: str | None) -> None:
    """Say why a stream has never had a sample; nothing of one that has."""
    if why is not None:
        err().print(f"nothing came: {why}", markup=False)


@contextmanager
def stoppable() -> Iterator[None]:
    """Let SIGTERM, and SIGHUP of a closing terminal, stop a command as Ctrl-C does, so that it
    cancels its request."""

    def stop(number: int, frame: FrameType | None) -> None:
        for handled in before:
            # A second signal must not interrupt the cancellation.
            signal.signal(handled, signal.SIG_IGN)
        raise KeyboardInterrupt

    numbers = [getattr(signal, name, None) for name in ("SIGTERM", "SIGHUP")]
    # An ignored signal stays ignored: that is the purpose of nohup.
    before = {
        number: signal.getsignal(number)
        for number in numbers
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN
    }
    for number in before:
        signal.signal(number, stop)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _show_request(view: dict[str, Any]) -> None:
    err().print(f"request {view['id']} on stream {view['stream']}", markup=False)
    err().print(view["plan"]["text"].rstrip(), markup=False)


def _list(client: Client, as_json: bool) -> None:
    from ...rdf.namespaces import shorten

    found = client.requests()
    if as_json:
        show_lines(found)
        return
    show_table(
        ["id", "event", "arguments", "stream"],
        [
            (
                e["id"],
                shorten(e["event"]),
                e["arguments"],
                _stream_and_state(e),
            )
            for e in found
        ],
        unfolded=["id", "stream"],
        empty="no requests run",
    )
    for each in found:
        if each["failure"]:
            show_text(f"{each['id']} {each['state']}: {each['failure']}")


def _stream_and_state(request: Mapping[str, Any]) -> str:
    """The stream that answers a request, or why there is none."""
    match request["state"]:
        case "running":
            return str(request["stream"])
        case "ended":
            return f"{request['stream']} (ended)"
        case state:
            return str(state)


def stream_units(client: Client, stream: str) -> dict[str, str]:
    """Return the units of a stream's fields, by its annotation."""
    ports = client.stream(stream)["ports"]
    return {port["field"]: port["unit"] for port in ports if port["unit"] not in (None, NO_UNIT)}


def show_events(
    messages: Iterable[Event],
    count: int | None,
    as_json: bool,
    units: Mapping[str, str] | None = None,
) -> int:
    """Show the events until the stream's end, at most ``count``, with the ``units`` of fields for
    people; returns their number. Raises ``typer.Exit(1)`` if the stream ends because its source
    failed."""
    seen, has_failed = 0, False
    for message in messages:
        has_failed |= message.kind == "end" and message.data.get("reason") == "failed"
        if as_json:
            show_json({"event": message.kind, "id": message.id, **message.data})
        elif message.kind == "sample":
            line = sample_line(str(message.data["valid"]), message.values, units)
            # With --every it stands for others, too.
            show_text(line if message.count == 1 else f"{line}  ({message.count} samples)")
        elif message.kind == "gap":
            first, last = message.data.get("from"), message.data.get("to")
            reason = message.data.get("reason", "")
            err().print(f"gap: samples {first} to {last or '?'}: {reason}", markup=False)
        elif message.kind == "rematched":
            err().print(_switch_words(message.data), markup=False)
        else:
            why = f": {message.data['failure']}" if "failure" in message.data else ""
            err().print(f"end: the stream has {message.data.get('reason')}{why}", markup=False)
        seen += message.kind == "sample"
        if count is not None and seen >= count:
            break
    if has_failed:
        raise typer.Exit(1)
    return seen


def sample_line(
    valid: str, values: Mapping[str, Any], units: Mapping[str, str] | None = None
) -> str:
    """Format a sample: ``19:12:55Z  name=value unit``."""
    return f"{clock_of(valid)}  {show_values(values, units)}"


def _switch_words(switch: Mapping[str, Any]) -> str:
    """``19:12:55Z  s1 → s2: s1 ended``."""
    before, after = (", ".join(switch[key]) or "nothing" for key in ("before", "after"))
    lost = " (samples between them are lost)" if switch["lost"] else ""
    return f"{clock_of(str(switch['time']))}  {before} → {after}: {switch['why']}{lost}"
