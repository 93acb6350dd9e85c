"""``dyknow follow``: the samples of a stream as they come, under a policy if one is given."""

from __future__ import annotations

from contextlib import suppress
from typing import Annotated

import httpx
import typer

from ...engine.views import Since
from ..client import ServiceError
from .events import show_events, stoppable
from .output import DEFAULT_URL, Json, Url, connect, err


def follow(
    stream: Annotated[str, typer.Argument(help="The name of a stream, or a KPL label.")],
    policy: Annotated[
        str,
        typer.Option(help="As after `with` in KPL: 'sample every 1s, max delay 200'."),
    ] = "",
    since: Annotated[
        Since, typer.Option(help="Begin with what comes, or with what the stream keeps.")
    ] = Since.NOW,
    count: Annotated[
        int | None, typer.Option("--count", "-n", min=1, help="Stop after so many samples.")
    ] = None,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Follow a stream, under a policy of one's own."""
    with connect(url) as client, stoppable():
        view = client.subscribe(stream, policy, since=since.value)
        try:
            begin = "start" if since is Since.START else None
            show_events(client.events(view["stream"], since=begin), count, as_json)
        except KeyboardInterrupt:
            err().print("stopped", markup=False)
        finally:
            # The service may be gone already; then there is nothing to give up.
            with suppress(ServiceError, httpx.TransportError):
                client.unsubscribe(view["id"])
