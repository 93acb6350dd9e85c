"""``dyknow replay``: a recorded table comes again as a stream."""

from __future__ import annotations

import itertools
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import httpx
import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from ...converters.recording import Recording, open_recording
from ...languages.ssl import parse_ssl
from ...streams.sample import FieldType
from ...streams.time import SECOND, format_time, parse_time
from ..client import Client, ServiceError
from ..replay import Span, play, span
from .output import DEFAULT_URL, Json, Url, connect, err, show_json, show_text
from .streams import text_or_file

_FATES = ("accepted", "used", "late", "duplicate", "expired", "pending")


def _speed(text: str) -> float | None:
    if text == "max":
        return None
    try:
        speed = float(text.removesuffix("x"))
    except ValueError:
        speed = 0.0
    if not 0 < speed < float("inf"):
        raise typer.BadParameter("a speed is max, or a number above 0 such as 1 or 10")
    return speed


def _begin(text: str | None) -> int | None:
    if text is None or text == "now":
        return None if text is None else time.time_ns()
    try:
        return parse_time(text)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error


def replay(
    file: Annotated[
        Path,
        typer.Argument(help="CSV, CSV.gz, NDJSON or Arrow.", exists=True, dir_okay=False),
    ],
    stream: Annotated[str, typer.Option(help="The stream to publish to.", metavar="NAME")],
    speed: Annotated[
        str, typer.Option(help="1 is as recorded, 10 ten times faster, max as fast as it goes.")
    ] = "1",
    rebase: Annotated[
        str | None, typer.Option(help="Let the recording begin now, or at a time.", metavar="now")
    ] = None,
    loop: Annotated[bool, typer.Option(help="Begin again at the end, until stopped.")] = False,
    ssl: Annotated[
        str | None, typer.Option(help="What the stream is about: SSL text or its file.")
    ] = None,
    lateness: Annotated[
        str, typer.Option(help="How far behind the newest a sample may be, such as 5s.")
    ] = "0s",
    time_column: Annotated[
        str | None, typer.Option(help="The column of valid times; else by its name.")
    ] = None,
    time_unit: Annotated[
        str | None, typer.Option(help="s, ms, us or ns; else by the size of the numbers.")
    ] = None,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Play a recorded table into a stream: declares it, publishes, says when it has ended."""
    factor, begin = _speed(speed), _begin(rebase)
    with connect(url) as client:
        # All that can be wrong with table and text is found before anything is made.
        meaning = None if ssl is None else text_or_file(ssl)
        if meaning is not None:
            parse_ssl(meaning)
        there = _fields(client, stream)
        recording = _open(file, time_column, time_unit, there or {})
        extent = span(recording)
        if extent is None:
            show_text("the recording is empty")
            return
        shift = 0 if begin is None else begin - extent.first
        player = _Player(client, stream, recording, extent, factor, shift)
        begun = time.monotonic()
        before = dict.fromkeys(_FATES, 0)
        try:
            _declare(client, stream, recording, there, lateness)
            if meaning is not None:
                client.annotate(meaning)
            before = client.stream(stream)["counters"]
            player.run(loop=loop, quiet=as_json)
        except KeyboardInterrupt:
            err().print("stopped", markup=False)
        except Exception:
            if there is None and not player.sent:
                # The service says why it failed; that it cannot be undone would hide it.
                with suppress(ServiceError, httpx.TransportError):
                    client.remove_stream(stream)
            raise
        else:
            client.end(stream)
        after = client.stream(stream)["counters"]
    counts = {fate: after[fate] - before[fate] for fate in _FATES}
    _summary(stream, counts, extent, time.monotonic() - begun, rebase is not None, as_json)


def _fields(client: Client, stream: str) -> dict[str, FieldType] | None:
    """The fields that the stream has already; None if there is no such stream."""
    try:
        return {f["name"]: FieldType(f["type"]) for f in client.stream(stream)["fields"]}
    except ServiceError as error:
        if error.status != 404:
            raise
        return None


def _open(
    file: Path, time_column: str | None, time_unit: str | None, there: Mapping[str, FieldType]
) -> Recording:
    """The table; fields that the stream has already keep their types: it is read by them."""
    recording = open_recording(file, time_column, time_unit)
    types = {name: kind for name, kind in there.items() if name in recording.schema.names}
    return open_recording(file, time_column, time_unit, types) if types else recording


def _declare(
    client: Client,
    stream: str,
    recording: Recording,
    there: Mapping[str, FieldType] | None,
    lateness: str,
) -> None:
    """Make the stream's fields the table's columns, unless they are."""
    if there is None or set(there) != set(recording.schema.names):
        fields = [{"name": f.name, "type": f.type.value} for f in recording.schema.fields]
        client.put_stream(stream, fields, lateness=lateness)


@dataclass(slots=True)
class _Player:
    """Publishes the parts of a recording when they are due."""

    client: Client
    stream: str
    recording: Recording
    extent: Span
    speed: float | None
    shift: int
    sent: int = 0
    """Samples that were accepted so far."""

    def run(self, *, loop: bool, quiet: bool) -> None:
        """Once, or again and again: then each round continues where the one before ended."""
        progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]:,.0f} samples/s"),
            TimeElapsedColumn(),
            console=err(),
            disable=quiet,
        )
        with progress:
            task = progress.add_task(self.stream, total=self.recording.rows, rate=0.0)
            for turn in itertools.count():
                shift = self.shift + turn * self.extent.period
                progress.reset(task, total=self.recording.rows)
                self._once(shift, progress, task)
                if not loop:
                    return
                if self.speed is not None:
                    time.sleep(1 / self.speed)

    def _once(self, shift: int, progress: Progress, task: Any) -> None:
        begun = time.monotonic()
        sent = 0
        for part in play(self.recording, self.extent.first, speed=self.speed, shift=shift):
            wait = part.due / SECOND - (time.monotonic() - begun)
            if wait > 0:
                time.sleep(wait)
            accepted = self.client.publish(self.stream, part.batch)
            self.sent += accepted
            sent += accepted
            elapsed = max(1e-9, time.monotonic() - begun)
            progress.update(task, advance=len(part.batch), rate=sent / elapsed)


def _summary(
    stream: str,
    counts: dict[str, int],
    extent: Span,
    seconds: float,
    rebased: bool,
    as_json: bool,
) -> None:
    if as_json:
        show_json({"stream": stream, **counts, "seconds": round(seconds, 3)})
        return
    rate = counts["accepted"] / max(seconds, 1e-9)
    show_text(
        f"{stream}: {counts['accepted']:,} samples accepted in {seconds:.1f} s ({rate:,.0f}/s), "
        f"recorded {format_time(extent.first)} to {format_time(extent.last)}"
    )
    rest = (f"{fate} {counts[fate]:,}" for fate in _FATES[1:] if counts[fate] or fate == "used")
    show_text("  " + ", ".join(rest))
    if counts["accepted"] and counts["late"] + counts["duplicate"] == counts["accepted"]:
        # The usual cause: a stream's available times only grow, and these were there before.
        show_text(
            "hint: everything was late: the stream has later samples already, perhaps of the "
            "same recording.\n      "
            + ("Wait, or use another stream." if rebased else "Play it with --rebase now.")
        )
