"""``dyknow query``: continuous queries in a running service."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from ...streams.time import format_time
from .events import STRATEGY, show_emptiness
from .introspection import show_bindings
from .output import (
    DEFAULT_URL,
    Json,
    Url,
    clock_of,
    connect,
    show_json,
    show_lines,
    show_table,
    show_text,
)
from .parameters import (
    MEDIA_TYPES,
    Beginning,
    Bounds,
    BoundsWord,
    Origin,
    Report,
    ReportWord,
    ResultFormat,
    Semantics,
    origin_of,
)
from .streams import text_or_file

if TYPE_CHECKING:
    from ..client.client import Client

query = typer.Typer(
    help="Queries, monitors and patterns: add, list, show, results, why, partial, remove.",
    no_args_is_help=True,
)

Name = Annotated[str, typer.Argument(help="The query's name.")]
NameOrId = Annotated[
    str, typer.Argument(help="The name of a monitor or pattern, or the id of a requested event.")
]


@query.command()
def add(
    source: Annotated[
        str, typer.Argument(help="REGISTER STREAM|QUERY or monitor text, its file, or - .")
    ],
    semantics: Semantics = None,
    bounds: Bounds = BoundsWord.LATER,
    origin: Origin = "0",
    report: Report = ReportWord.NON_EMPTY,
    strategy: Annotated[str, STRATEGY] = "fast",
    since: Beginning = "now",
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Register a query; its results are a stream of its name."""
    text = text_or_file(source)
    with connect(url) as client:
        found = client.register_query(
            text,
            semantics=None if semantics is None else semantics.value,
            bounds=bounds.value,
            origin=origin_of(origin),
            report=report.value,
            strategy=strategy,
            since=since,
        )
    if as_json:
        show_json(found)
        return
    if found["users"] > 1:
        show_text(f"{found['name']} exists already; it is shared by {found['users']} registrations")
    else:
        show_text(f"registered {found['name']}")
    show_text(found["plan"]["text"].rstrip())
    # What is there already comes only to a reader that asks for it.
    past = "" if since == "now" else " --since start"
    show_text(f"follow it: dyknow follow {found['stream']}{past}")


@query.command("list")
def list_queries(url: Url = DEFAULT_URL, as_json: Json = False) -> None:
    """List the registered queries."""
    with connect(url) as client:
        found = client.queries()
    if as_json:
        show_lines(found)
        return
    show_table(
        ["query", "form", "state", "reads", "last window", "users"],
        [
            (
                each["name"],
                each["form"] or each["dialect"],
                each["state"],
                each["reads"],
                clock_of(each["last_window"]) or "-",
                each["users"],
            )
            for each in found
        ],
        unfolded=["query"],
        empty="no queries yet: dyknow query add FILE",
    )


@query.command()
def show(
    name: Name,
    explain: Annotated[bool, typer.Option(help="Print each stage of the running query.")] = False,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Print a query's text and state."""
    with connect(url) as client:
        found = client.query(name, explain=explain)
    if as_json:
        show_json(found)
    elif explain:
        show_text(found["explanation"])
    else:
        show_text(found["source"])
        show_text("")
        show_text(_state(found))


@query.command()
def results(
    name: Name,
    start: Annotated[
        str | None, typer.Option("--from", help="Windows that end at this time or later.")
    ] = None,
    end: Annotated[
        str | None, typer.Option("--to", help="Windows that end at this time or earlier.")
    ] = None,
    limit: Annotated[
        int | None,
        typer.Option(min=1, help="This number of the newest windows; with --from the oldest."),
    ] = None,
    format: ResultFormat = None,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Print the result of the last window, or of several."""
    wanted: dict[str, Any] = {"start": start, "end": end, "limit": limit}
    with connect(url) as client:
        if format is not None:
            print(client.query_results_text(name, MEDIA_TYPES[format], **wanted), end="")
            return
        found = client.query_results(name, **wanted)
        query = client.query(name)
    if as_json:
        show_json(found if isinstance(found, dict) else {"turtle": found})
        return
    if start is None and end is None and limit is None:
        show_text(f"window that ends {query['last_window']}")
    if isinstance(found, str):
        show_text(found or "(no triple)")
    else:
        show_bindings(found)
    show_emptiness(query["empty"])


@query.command()
def remove(name: Name, url: Url = DEFAULT_URL, as_json: Json = False) -> None:
    """Remove one registration of a query; it stops with the last."""
    with connect(url) as client:
        client.remove_query(name)
        left = next((each["users"] for each in client.queries() if each["name"] == name), 0)
    if as_json:
        show_json({"removed": name, "users": left})
    elif left:
        show_text(f"removed a registration of {name}; it runs on for {left} more")
    else:
        show_text(f"removed {name}")


@query.command()
def why(
    name: NameOrId,
    start: Annotated[str, typer.Argument(help="The result's valid time, as `follow` shows it.")],
    object: Annotated[
        list[str] | None,
        typer.Option(help="The object of each parameter, in order. May be repeated."),
    ] = None,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Explain a verdict by its states and the parts of the formula, or a match by its samples."""
    from ..http.encodings.match_tables import matches_table
    from ..http.encodings.verdict_tables import why_table

    with connect(url) as client:
        ask = client.event_why if _is_request(client, name) else client.why
        found = ask(name, start, object or [])
    if as_json:
        show_json(found)
    else:
        show_text(matches_table(found) if "matches" in found else why_table(found))


@query.command()
def partial(
    name: NameOrId,
    object: Annotated[
        list[str] | None, typer.Option(help="An object of the match. May be repeated.")
    ] = None,
    limit: Annotated[int, typer.Option(min=1, max=1000, help="At most so many.")] = 20,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Show the partial matches of a pattern: what has come, and when the rest may come."""
    from ..http.encodings.match_tables import partial_table

    with connect(url) as client:
        is_request = _is_request(client, name)
        ask = client.event_partial_matches if is_request else client.partial_matches
        found = ask(name, object or [], limit)
    if as_json:
        show_json(found)
    else:
        show_text(partial_table(found))


def _is_request(client: Client, name: str) -> bool:
    """Whether this is the id of a request; a query of the same name goes before it."""
    queries = {each["name"] for each in client.queries()}
    return name not in queries and name in {each["id"] for each in client.requests()}


def _state(found: dict[str, Any]) -> str:
    """Format state and options in a line or two."""
    options = found["options"]
    words = [found["state"] + (f": {found['failure']}" if found["failure"] else "")]
    says_so = found["empty"] is not None and set(found["waits_for"]) == set(found["reads"])
    if found["waits_for"] and not says_so:
        words.append(f"waits for {', '.join(found['waits_for'])}")
    elif len(found["reads"]) > 1 and found["held_back_by"]:
        words.append(f"held back by {', '.join(found['held_back_by'])}")
    if found["last_window"] is not None:
        words.append(f"last window ended {found['last_window']}, {found['windows']} kept")
    if found["empty"] is not None:
        words.append(f"nothing came: {found['empty']}")
    if found["late"]:
        words.append(f"{found['late']} samples came too late")
    if found["kind"] in ("MONITOR", "PATTERN"):
        if found["late"] and "max delay" not in found["source"].lower():
            words.append("others were valid later, and `max delay` waits for such samples")
        return "; ".join(words) + f"\nsince {options['since']}"
    options_text = f"{options['semantics']} semantics, windows {options['bounds']}"
    if options["origin"] != format_time(0):
        options_text += f" at {options['origin']} and so on"
    options_text += f", report {options['report']}, since {options['since']}"
    return "; ".join(words) + "\n" + options_text
