"""``dyknow events``: request an event and follow what comes, or list the requests that run."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from enum import StrEnum
from typing import Annotated

import httpx
import typer

from ...engine.views import Since
from ..client import Client, Event, ServiceError
from .output import (
    DEFAULT_URL,
    Json,
    Url,
    clock_of,
    connect,
    err,
    show_json,
    show_lines,
    show_table,
    show_text,
    show_values,
)


class Strategy(StrEnum):
    """How a plan is chosen when there are several."""

    FAST = "fast"
    COST = "cost"
    QUALITY = "quality"


def events(
    request: Annotated[
        str | None,
        typer.Argument(help="Such as 'dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)'."),
    ] = None,
    strategy: Annotated[Strategy, typer.Option(help="How a plan is chosen.")] = Strategy.FAST,
    since: Annotated[
        Since, typer.Option(help="Begin with what comes, or with what the streams keep.")
    ] = Since.NOW,
    count: Annotated[
        int | None, typer.Option("--count", "-n", min=1, help="Stop after so many events.")
    ] = None,
    follow: Annotated[bool, typer.Option(help="Follow the events as they come.")] = True,
    keep: Annotated[bool, typer.Option(help="Leave the request running afterwards.")] = False,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Request an event and follow it; without an argument, list the requests that run."""
    with connect(url) as client:
        if request is None:
            _list(client, as_json)
            return
        view = client.request_event(request, strategy=strategy.value, since=since.value)
        if as_json and not follow:
            show_json(view)
        elif not as_json:
            err().print(f"request {view['id']} on stream {view['stream']}", markup=False)
            err().print(view["plan"]["text"].rstrip(), markup=False)
        if not follow:
            return
        try:
            seen = _show(client.events(view["stream"], since="start"), count, as_json)
            if not seen and since is Since.NOW and not as_json:
                # It ends at once when what it reads has ended; nothing new will come.
                hint = "the recording has ended; --since start begins with its past"
                err().print(f"hint: {hint}", markup=False)
        except KeyboardInterrupt:
            err().print("stopped", markup=False)
        finally:
            if not keep:
                # The service may be gone already; then there is nothing to give up.
                with suppress(ServiceError, httpx.TransportError):
                    client.cancel_event(view["id"])


def _list(client: Client, as_json: bool) -> None:
    found = client.requests()
    if as_json:
        show_lines(found)
        return
    show_table(
        ["id", "event", "arguments", "strategy", "stream"],
        [(e["id"], e["event"], e["arguments"], e["strategy"], e["stream"]) for e in found],
        empty="no requests run",
    )


def _show(messages: Iterable[Event], count: int | None, as_json: bool) -> int:
    """Show the events until the stream's end, at most ``count``; returns how many."""
    seen = 0
    for message in messages:
        if as_json:
            show_json({"event": message.kind, "id": message.id, **message.data})
        elif message.kind == "sample":
            show_text(f"{clock_of(str(message.data['valid']))}  {show_values(message.values)}")
        elif message.kind == "gap":
            first, last = message.data.get("from"), message.data.get("to")
            reason = message.data.get("reason", "")
            err().print(f"gap: samples {first} to {last or '?'}: {reason}", markup=False)
        else:
            err().print(f"end: the stream has {message.data.get('reason')}", markup=False)
        seen += message.kind == "sample"
        if count is not None and seen >= count:
            break
    return seen
