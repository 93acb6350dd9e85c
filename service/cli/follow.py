"""``dyknow follow``: the samples of a stream, or of a feature whatever streams hold it, as they
come; under a policy if one is given."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .events import STRATEGY, show_emptiness, show_events, stoppable
from .output import DEFAULT_URL, Json, Url, connect, err, unless_gone
from .parameters import NOW, Beginning

if TYPE_CHECKING:
    from ..client.client import Client, Event


def follow(
    stream: Annotated[
        str | None, typer.Argument(help="The name of a stream, or a KPL label.")
    ] = None,
    feature: Annotated[
        str | None, typer.Option(help="In place of a stream: whatever streams hold it.")
    ] = None,
    sort: Annotated[
        str | None, typer.Option(help="The feature of every object of this sort.")
    ] = None,
    object: Annotated[
        list[str] | None,
        typer.Option(
            help="The feature of this object. May be repeated: the arguments of an n-ary feature."
        ),
    ] = None,
    strategy: Annotated[str | None, STRATEGY] = None,
    staleness: Annotated[
        str | None,
        typer.Option(
            help="So long a source of the feature may be silent: 5s. Else as its usual gap says."
        ),
    ] = None,
    min_quality: Annotated[
        float | None,
        typer.Option(help="The least quality of the feature that is good enough, 0 to 1."),
    ] = None,
    hold_off: Annotated[
        str | None, typer.Option(help="So long a better source must have been there: 2s.")
    ] = None,
    policy: Annotated[
        str,
        typer.Option(help="As after `with` in KPL: 'sample every 1s, max delay 200'."),
    ] = "",
    since: Beginning = "now",
    count: Annotated[
        int | None, typer.Option("--count", "-n", min=1, help="Stop after so many samples.")
    ] = None,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Follow a stream, under a policy of one's own; or a feature, with a line for each switch."""
    if (stream is None) == (feature is None):
        raise typer.BadParameter("give the name of a stream, or --feature")
    given: dict[str, Any] = {
        "sort": sort,
        "objects": object,
        "strategy": strategy,
        "staleness": staleness,
        "min_quality": min_quality,
        "hold_off": hold_off,
    }
    wanted = {key: value for key, value in given.items() if value is not None}
    if stream is not None and wanted:
        raise typer.BadParameter("only --policy, --since and --count go with a stream")
    with connect(url) as client, stoppable():
        if feature is not None:
            view = client.subscribe_to(feature, policy=policy, since=since, **wanted)
        else:
            view = client.subscribe(stream or "", policy, since=since)
        try:
            show_events(_events(client, view), count, as_json)
        except KeyboardInterrupt:
            err().print("stopped", markup=False)
        finally:
            if stream is not None and not as_json:
                with unless_gone():
                    show_emptiness(_why_empty(client, stream))
            with unless_gone():
                client.unsubscribe(view["id"])


def _why_empty(client: Client, stream: str) -> str | None:
    """Why the query or request behind a stream has never given a sample; None of other streams."""
    known = (*client.queries(), *client.requests())
    return next((each["empty"] for each in known if each["stream"] == stream), None)


def _events(client: Client, view: dict[str, Any]) -> Iterator[Event]:
    if view.get("adaptive") is not None:
        # Its stream began with the request: nothing of it is somebody else's past.
        return client.subscription_events(view["id"], since="start")
    since = view["since"]  # a duration as the time that it means
    return client.events(view["stream"], since=None if since == NOW else since)
