"""``dyknow follow``: the samples of a stream, or of a feature of any streams, as they come, with an
optional policy."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .events import (
    STRATEGY,
    show_emptiness,
    show_events,
    stoppable,
    stream_units,
)
from .output import DEFAULT_URL, Json, Url, connect, err, ignore_gone
from .parameters import NOW, Beginning

if TYPE_CHECKING:
    from ..client.client import Client, Event
    from ..client.event_streams import Delivery


def follow(
    stream: Annotated[
        str | None, typer.Argument(help="The name of a stream, or a KPL label.")
    ] = None,
    feature: Annotated[
        str | None, typer.Option(help="A feature of any streams, instead of one stream.")
    ] = None,
    sort: Annotated[
        str | None, typer.Option(help="The feature of all objects of this sort.")
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
            help="How long a source of the feature may be silent: 5s. Default: by its usual gap."
        ),
    ] = None,
    min_quality: Annotated[
        float | None,
        typer.Option(help="The least sufficient quality of the feature, 0 to 1."),
    ] = None,
    hold_off: Annotated[
        str | None, typer.Option(help="How long a better source must exist before its use: 2s.")
    ] = None,
    policy: Annotated[
        str,
        typer.Option(help="A policy as after `with` in KPL: 'sample every 1s, max delay 200'."),
    ] = "",
    since: Beginning = "now",
    last: Annotated[
        int | None, typer.Option(min=1, help="Begin with so many of the stream's newest samples.")
    ] = None,
    fields: Annotated[
        str | None, typer.Option(help="Only these fields: id,spd.", metavar="FIELD,...")
    ] = None,
    every: Annotated[
        str | None,
        typer.Option(
            help="At most one sample of each object in this time, its newest: 1s.",
            metavar="DURATION",
        ),
    ] = None,
    count: Annotated[
        int | None, typer.Option("--count", "-n", min=1, help="Stop after this number of samples.")
    ] = None,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Follow a stream, optionally under a policy; or a feature, with a line for each switch."""
    if (stream is None) == (feature is None):
        raise typer.BadParameter("name a stream, or a feature with --feature")
    options: dict[str, Any] = {
        "sort": sort,
        "objects": object,
        "strategy": strategy,
        "staleness": staleness,
        "min_quality": min_quality,
        "hold_off": hold_off,
    }
    wanted = {key: value for key, value in options.items() if value is not None}
    if stream is not None and wanted:
        raise typer.BadParameter(
            "a stream takes only --policy, --since, --last, --fields, --every and --count"
        )
    if last is not None and since != NOW:
        raise typer.BadParameter("--last and --since both say where to begin; give one of them")
    if last is not None and (feature is not None or policy):
        what = "a feature" if feature is not None else "a policy"
        raise typer.BadParameter(f"{what} has no samples yet; begin in the past with --since")
    delivery: Delivery = {}
    if last is not None:
        delivery["last"] = last
    if fields is not None:
        delivery["fields"] = fields.split(",")
    if every is not None:
        delivery["every"] = every
    with connect(url) as client, stoppable():
        if feature is not None:
            view = client.subscribe_to(feature, policy=policy, since=since, **wanted)
        else:
            view = client.subscribe(stream or "", policy, since=since)
        try:
            units = None if as_json else stream_units(client, _carrier(view))
            show_events(_events(client, view, delivery), count, as_json, units)
        except KeyboardInterrupt:
            err().print("stopped", markup=False)
        finally:
            if stream is not None and not as_json:
                with ignore_gone():
                    show_emptiness(_why_empty(client, stream))
            with ignore_gone():
                client.unsubscribe(view["id"])


def _why_empty(client: Client, stream: str) -> str | None:
    """Why the query or request behind a stream has never given a sample; None of other streams."""
    known = (*client.queries(), *client.requests())
    return next((each["empty"] for each in known if each["stream"] == stream), None)


def _carrier(view: dict[str, Any]) -> str:
    """Return the stream whose annotation holds for a subscription: a policy keeps the fields of
    its source."""
    carrier: str = view["source"] if view.get("adaptive") is None else view["stream"]
    return carrier


def _events(client: Client, view: dict[str, Any], delivery: Delivery) -> Iterator[Event]:
    if view.get("adaptive") is not None:
        # The stream is this subscription's own, so "start" brings no older samples.
        return client.subscription_events(view["id"], since="start", **delivery)
    since = view["since"]  # the service has replaced a duration by a time
    return client.events(view["stream"], since=None if since == NOW else since, **delivery)
