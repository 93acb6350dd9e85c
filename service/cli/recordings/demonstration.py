"""The work of ``dyknow demo``: [Events14 §V.C] on recorded flights, from nothing to events.

It starts a service of its own in memory and talks to it over HTTP as any client would. The same
recording, played again and again in the present, is what ``dyknow serve --flights`` offers.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.progress import BarColumn, Progress, TextColumn
from rich.syntax import Syntax
from rich.table import Table
from rich.text import Text

from ....converters.recordings.recording import Recording, open_recording
from ....engine.engine import Engine
from ....streams.time import read_time
from ...admission.tokens import Tokens
from ...app import create_app
from ...client.client import Client
from ...config.defaults import URL
from ...config.settings import Settings
from ...server import running
from ..output import clock_of
from .recording_replay import PAUSE, play, span

STREAM = "adsb"
SPEED = 25.0
"""The speed of the demonstration, as a multiple of the recorded one."""
THRESHOLD = 800
SHOWN = 12
"""The number of latest events on the screen."""

WHO_FEEDS = """\
SELECT ?stream ?transformation ?input WHERE {
  ?unit a dyknow-o:ComputationalUnit ;
        dyknow-o:instantiationOf ?transformation ;
        dyknow-o:hasInput ?input ;
        dyknow-o:hasOutput ?stream .
} ORDER BY ?stream"""


@dataclass(slots=True)
class _EventCounts:
    """Events as they arrive, counted by request."""

    counts: dict[str, int] = field(default_factory=dict)
    latest: list[tuple[str, str, str, float]] = field(default_factory=list)
    objects: set[str] = field(default_factory=set)
    first_after: float | None = None
    lock: threading.Lock = field(default_factory=threading.Lock)


@contextmanager
def demo_files() -> Iterator[tuple[Path, str, str]]:
    """Yield the shipped recording, its annotation, and the template."""
    package = files("dyknow")
    template = package.joinpath("templates", "library", "high_speed.rq").read_text()
    annotation = package.joinpath("examples", "adsb.ssl").read_text()
    with as_file(package.joinpath("examples", "adsb.csv.gz")) as path:
        yield path, annotation, template


def show() -> None:
    """Replay five minutes of recorded flights, and find events in them."""
    console = Console(highlight=False, emoji=False, width=None if sys.stdout.isatty() else 100)
    began = time.perf_counter()
    # Only for this machine and process: ignore the environment's settings of a service.
    # The first run compiles loops meanwhile: its requests are slow, and that is no warning.
    settings = Settings(host="127.0.0.1", port=0, slow_request=60)
    with (
        demo_files() as (path, annotation, template),
        running(_application(settings), settings) as url,
        Client(url) as client,
    ):
        recording = open_recording(path)
        console.rule("[bold]DyKnow: say what you want to know")
        console.print(
            f"A service in memory, up after {_since(began)}. Its console: [bold]{url}[/]\n"
            "(until the demo ends; [bold]make serve[/] keeps one open)\n"
        )
        _declare(console, client, recording, annotation)
        console.print("\nAn event template: when does an event occur? [dim](POST /templates)[/]")
        client.register_template(template)
        console.print(_code(template.strip(), "sparql"))
        fastest = "dyknow:3950c8"
        one = _request(console, client, f"dyknow:HighSpeedEvent({fastest}, dyknow:Aircraft, 700)")
        every = _request(
            console, client, f"dyknow:HighSpeedEvent(?o, dyknow:Aircraft, {THRESHOLD})"
        )
        counts, spent = _replay_and_follow(console, client, url, recording, [one, every])
        _introspect(console, client)
        _summary(console, client, counts, spent, began, [one, every])


def _application(settings: Settings) -> FastAPI:
    return create_app(Engine(now=time.time_ns()), settings, time.time_ns, Tokens())


def flights(
    url: str,
    stopping: Callable[[], bool],
    token: str = "",
    *,
    begins: Callable[[], None] = lambda: None,
) -> None:
    """Play the recording into the service at ``url`` again and again, as if it flew now. ``begins``
    is called when its stream and template are there."""
    with demo_files() as (path, annotation, template), Client(url, token=token) as client:
        recording = open_recording(path)
        _put(client, recording)
        client.annotate(annotation)
        if not any(known["local_name"] == "HighSpeedEvent" for known in client.templates()):
            client.register_template(template)
        begins()
        extent = span(recording)
        assert extent is not None
        begin, now = time.monotonic_ns(), time.time_ns()
        last = client.stream(STREAM)["last_available"]
        # After a restart the recording begins again: the pause keeps speeds from spanning the jump.
        start = now if last is None else max(now, read_time(last) + PAUSE)
        shift, begin = start - extent.first, begin + start - now
        while not stopping():
            for part in play(recording, extent.first, speed=1.0, shift=shift):
                while not stopping() and (left := begin + part.due - time.monotonic_ns()) > 0:
                    time.sleep(min(0.5, left / 1e9))
                if stopping():
                    return
                client.publish(STREAM, part.batch)
            shift += extent.period
            begin += extent.period


def _put(client: Client, recording: Recording) -> None:
    client.put_stream(STREAM, {f.name: str(f.type) for f in recording.schema.fields})


def _declare(console: Console, client: Client, recording: Recording, annotation: str) -> None:
    _put(client, recording)
    client.annotate(annotation)
    console.print(
        f"A stream [bold]{STREAM}[/] of recorded ADS-B reports "
        f"({', '.join(recording.schema.names)}), and what it means, in SSL "
        "[dim](POST /annotations)[/].\nThe reported ground speed is left out on purpose:"
    )
    console.print(_code(annotation.strip(), "text"))


def _request(console: Console, client: Client, text: str) -> dict[str, Any]:
    console.print(f"\nI want to know: [bold cyan]{text}[/] [dim](POST /events)[/]")
    answer = client.request_event(text)
    plan = Text(answer["plan"]["text"])
    why = Text(_why(client, text), style="dim")
    console.print(
        Panel(Group(plan, why), title=f"plan → stream {answer['stream']}", title_align="left")
    )
    return answer


def _why(client: Client, request: str) -> str:
    """Return the matching part of the explanation: the choices and the failed alternatives."""
    text = client.explain(event=request)
    start = text.index("semantic matching")
    end = text.index("\n\nquery", start)
    return "\nwhy:\n" + text[start:end].split("\n", 1)[1]


def _replay_and_follow(
    console: Console,
    client: Client,
    url: str,
    recording: Recording,
    requests: list[dict[str, Any]],
) -> tuple[_EventCounts, float]:
    """Publish the recording at its pace, and follow each request on its own connection."""
    extent = span(recording)
    assert extent is not None
    counts = _EventCounts()
    begin = time.perf_counter()
    followers = [
        threading.Thread(
            target=_follow, args=(console, url, answer["stream"], label, counts, begin)
        )
        for label, answer in zip(("one", "all"), requests, strict=True)
    ]
    console.print(f"\nNow the flights of five minutes, {SPEED:.0f} times faster:")
    if not console.is_terminal:
        console.print(f"(the first {SHOWN} events, as they arrive)")
    for follower in followers:
        follower.start()
    progress = Progress(
        TextColumn("[bold]replaying"),
        BarColumn(),
        TextColumn("{task.description}"),
        console=console,
    )
    task = progress.add_task("", total=extent.last - extent.first)
    with (
        Live(console=console, refresh_per_second=8)
        if console.is_terminal
        else nullcontext() as live
    ):
        for part in play(recording, extent.first, speed=SPEED):
            time.sleep(max(0.0, part.due / 1e9 - (time.perf_counter() - begin)))
            client.publish(STREAM, part.batch)
            moment = int(part.batch.valid[-1])
            flown = f"{time.strftime('%H:%M:%S', time.gmtime(moment / 1e9))} UTC, ×{SPEED:.0f}"
            progress.update(task, completed=moment - extent.first, description=flown)
            if live is not None:
                live.update(Group(_events_table(counts), progress))
        client.end(STREAM)
        for follower in followers:
            follower.join(timeout=10)
        if live is not None:
            live.update(Group(_events_table(counts), progress))
    return counts, time.perf_counter() - begin


def _follow(
    console: Console, url: str, stream: str, label: str, counts: _EventCounts, begin: float
) -> None:
    """Show the events of one request until its stream ends."""
    with Client(url) as client:
        for event in client.events(stream, since="start"):
            if event.kind != "sample":
                continue
            moment = clock_of(event.data["valid"]).split("T")[-1]
            line = (moment, label, str(event.values["id"]), float(event.values["speed"]))
            with counts.lock:
                if counts.first_after is None:
                    counts.first_after = time.perf_counter() - begin
                counts.counts[label] = counts.counts.get(label, 0) + 1
                counts.objects.add(line[2])
                counts.latest = [*counts.latest, line][-SHOWN:]
                if not console.is_terminal and sum(counts.counts.values()) <= SHOWN:
                    console.print(f"  {moment}  {label}  {line[2]}  {line[3]:.1f} km/h")


def _events_table(counts: _EventCounts) -> Table:
    table = Table(box=None, header_style="bold", title=None)
    table.add_column("window end (UTC)")
    table.add_column("request")
    table.add_column("aircraft")
    table.add_column("average speed", justify="right")
    with counts.lock:
        latest = list(counts.latest)
    for moment, label, aircraft, speed in latest:
        table.add_row(moment, label, aircraft, f"{speed:.1f} km/h")
    return table


def _introspect(console: Console, client: Client) -> None:
    console.print("\nWhat does the system know of itself? [dim](GET /sparql)[/]")
    console.print(_code(WHO_FEEDS, "sparql"))
    answer = client.sparql(WHO_FEEDS)
    assert isinstance(answer, dict)
    table = Table(box=None, header_style="bold")
    for name in answer["head"]["vars"]:
        table.add_column(name)
    for row in answer["results"]["bindings"]:
        table.add_row(*(row[name]["value"].split("#")[-1] for name in answer["head"]["vars"]))
    console.print(table)


def _summary(
    console: Console,
    client: Client,
    counts: _EventCounts,
    spent: float,
    began: float,
    requests: list[dict[str, Any]],
) -> None:
    counters = client.stream(STREAM)["counters"]
    console.rule("[bold]summary")
    console.print(
        f"{counters['accepted']} samples accepted ({counters['used']} used, "
        f"{counters['late']} late, {counters['duplicate']} duplicate) in {spent:.1f} s: "
        f"{counters['accepted'] / spent:.0f} samples/s at this pace."
    )
    console.print(
        f"{counts.counts.get('one', 0)} events for the one aircraft, "
        f"{counts.counts.get('all', 0)} for all ({len(counts.objects)} aircraft); "
        f"the first {counts.first_after or 0:.1f} s into the replay."
    )
    for answer in requests:
        client.cancel_event(answer["id"])
    left = [s["name"] for s in client.streams() if s["name"].startswith("dyknow_reserved")]
    console.print(
        "Requests cancelled; units and streams without users were removed"
        + (f" but for {', '.join(left)}" if left else "")
        + f". {_since(began)} in all."
    )
    console.print(
        "The speeds are derived from positions; docs/explanation/performance.md compares them with "
        "the ground speeds that the aircraft reported themselves (half of them differ by less than "
        "10 kt)."
    )
    console.print(
        f"Next: [bold]make serve[/] lets them fly on, with a console at {URL}\n"
        "and in a second terminal\n  [bold].venv/bin/dyknow events "
        f"'dyknow:HighSpeedEvent(?o, dyknow:Aircraft, {THRESHOLD})' --since start[/]\n"
        "Your own data: docs/tutorial/your-own-robot.md",
        soft_wrap=True,
    )
    if not counts.counts:
        raise SystemExit(1)


def _code(text: str, language: str) -> Syntax:
    return Syntax(
        text,
        language,
        theme="ansi_dark",
        background_color="default",
        padding=(0, 2),
        word_wrap=True,
    )


def _since(began: float) -> str:
    return f"{time.perf_counter() - began:.1f} s"
