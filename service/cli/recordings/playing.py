"""The work of ``dyknow replay``: publish recordings (`opening`) at their pace, await the readers,
and report."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from math import inf
from pathlib import Path
from typing import Any

import httpx
import typer
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
)

from ....converters.recordings.recording import Recording
from ....converters.recordings.table_options import TableOptions
from ....converters.recordings.time_order import TimeOrder
from ....converters.wire import Rounded
from ....streams.sample import SampleBatch
from ....streams.time import (
    FOREVER,
    HOUR,
    SECOND,
    TIME_MAX,
    format_time,
    parse_duration,
    read_time,
)
from ...client.client import Client, ServiceError
from ...config.defaults import AHEAD
from ..output import (
    connect,
    err,
    fail,
    show_json,
    show_text,
    show_values,
)
from ..parameters import show_losses, show_order, warn_of_annotations
from ..streams import text_or_file
from .opening import Track, declare, open_file, open_piped
from .piped import check_once, is_pipe, reading, show_piped
from .recording_replay import PAUSE, Span, play_all, span

_LOOK = 0.2
"""Seconds between two checks whether all samples have been evaluated."""
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
        return read_time(text)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error


def _bound(text: str | None) -> int | None:
    if text is None:
        return None
    try:
        return FOREVER if text == "oo" else parse_duration(text)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """The options of the command, unparsed."""

    file: Path
    stream: list[str] | None
    speed: str
    rebase: str | None
    loop: bool
    ssl: str | None
    lateness: str | None
    idle: str | None
    ahead: str | None
    tables: TableOptions
    utc: bool
    sort: bool | None
    url: str
    as_json: bool


def play(options: ReplayOptions) -> None:
    """Declare the streams of a recording, publish it, and report the end."""
    factor, begin, bound = _speed(options.speed), _begin(options.rebase), _bound(options.ahead)
    check_once(options.file, sort=options.sort, loop=options.loop)
    with ExitStack() as open_files:
        client = open_files.enter_context(connect(options.url))
        pipe = open_files.enter_context(reading(options.file)) if is_pipe(options.file) else None
        # Find errors in tables and texts before any declaration.
        meaning = None if options.ssl is None else text_or_file(options.ssl)
        declared = () if meaning is None else _declared(meaning)
        wanted = options.stream or []
        opened = (
            open_file(client, options.file, wanted, options.tables, options.utc)
            if pipe is None
            else open_piped(client, pipe, wanted, options.tables)
        )
        piped = opened.piped
        warn_of_annotations(declared, opened.tracks, "played")
        tracks = opened.tracks
        if piped is None:
            tracks = {name: track.in_time_order(options.sort) for name, track in tracks.items()}
            for name, track in tracks.items():
                show_order(name, track.order)
        now = time.time_ns()
        latest = min(now + _ahead(bound, tracks.values()), TIME_MAX)
        extents: dict[str, Span | None] = {
            name: span(track.recording) if piped is None else Span(piped.first, piped.first)
            for name, track in tracks.items()
        }
        if not any(extents.values()):
            show_text("the recording is empty")
            raise typer.Exit(0)
        beginning = min(each.first for each in extents.values() if each is not None)
        if begin is not None:
            # A recording of the future that is moved back is not ahead of the clock.
            latest = min(latest + max(0, beginning - begin), TIME_MAX)
        for name, whole in extents.items():
            if piped is None and whole is not None and whole.last > latest:
                extents[name] = span(tracks[name].recording, latest)
        known = [extent for extent in extents.values() if extent is not None]
        if not known:
            raise fail(
                f"every sample is ahead of the clock: the first is of {format_time(beginning)}, "
                f"and now it is {format_time(now)}",
                "move it with --rebase now, or take it as it is with --ahead oo",
            )
        extent = Span(min(e.first for e in known), max(e.last for e in known))
        shift = 0 if begin is None else begin - extent.first
        if begin is not None and factor != 1:
            # By itself it gets as far ahead as it is long, each round anew.
            is_endless = options.loop or piped is not None
            length = FOREVER if is_endless else extent.last - extent.first
            bound = min(_ahead(bound, tracks.values()) + length, FOREVER)
        recordings = {name: track.recording for name, track in tracks.items()}
        readers = _Readers(client)
        player = _Player(client, readers, recordings, extent, factor, shift, latest)
        begun = time.monotonic()
        before = {name: dict.fromkeys(_FATES, 0) for name in tracks}
        try:
            for name, track in tracks.items():
                declare(client, name, track, options.lateness, options.idle, bound)
            if meaning is not None:
                client.annotate(meaning)
            before = {name: client.stream(name)["counters"] for name in tracks}
            readers.begin(tracks)
            player.run(loop=options.loop, quiet=options.as_json)
        except KeyboardInterrupt:
            err().print("stopped", markup=False)
        except Exception:
            for name, track in tracks.items():
                if track.there is None and not player.sent.get(name):
                    # The service says why it failed; that it cannot be undone would hide it.
                    with suppress(ServiceError, httpx.TransportError):
                        client.remove_stream(name)
            raise
        seconds = time.monotonic() - begun
        for name in tracks:
            after = client.stream(name)["counters"]
            counts = {fate: after[fate] - before[name][fate] for fate in _FATES}
            counts["ahead"] = player.left_out.get(name, 0)
            counts["evaluated"] = readers.evaluated(name)
            its = extents[name] or extent
            order = tracks[name].order
            if piped is not None:
                its, order = Span(piped.first, piped.last), show_piped(name, piped)
            _summary(
                name,
                counts,
                its,
                seconds,
                options.rebase is not None,
                options.as_json,
                opened.dropouts,
                order,
                tracks[name].recording.rounding.rounded,
            )
        failed = readers.failed()
    if not options.as_json:
        show_losses(opened.dropouts, opened.lost, opened.notes)
    for each in failed:
        whom = ", ".join(each["asked"]) or f"what makes stream {each['stream']}"
        err().print(f"failed: {whom}: {each['failure']}", markup=False, highlight=False)
    if failed:
        raise typer.Exit(1)


class _Readers:
    """The readers of the played streams: their progress, and new failures."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._begun: dict[str, int] = {}
        """The number of each stream's last sample before the replay."""
        self._before: set[str] = set()
        """Units that failed before the replay."""

    def begin(self, streams: Iterable[str]) -> None:
        """Note the state of ``streams`` before the replay."""
        for name in streams:
            found = self._client.evaluation(name)
            self._begun[name] = found["last"]
            self._before.update(each["unit"] for each in found["failed"])

    def wait(self, show: Callable[[], None]) -> None:
        """Return when all readers have evaluated all present samples of the streams; call ``show``
        now and then."""
        for name in self._begun:
            last = self._client.evaluation(name)["last"]
            while self._client.evaluation(name)["evaluated"] < last:
                show()
                time.sleep(_LOOK)

    def behind(self, name: str) -> int:
        """Return the number of published samples that some reader has not evaluated yet."""
        found = self._client.evaluation(name)
        count: int = found["last"] - found["evaluated"]
        return max(0, count)

    def evaluated(self, name: str) -> int:
        """Return the number of replayed samples that all readers have evaluated."""
        found: int = self._client.evaluation(name)["evaluated"]
        return max(0, found - self._begun.get(name, found))

    def failed(self) -> list[dict[str, Any]]:
        """Return the units that have failed since `begin`, each once."""
        found = {
            each["unit"]: each
            for name in self._begun
            for each in self._client.evaluation(name)["failed"]
        }
        return [each for unit, each in found.items() if unit not in self._before]


def _ahead(bound: int | None, tracks: Iterable[Track]) -> int:
    """Return how far ahead of the clock (ns) rows may be: by the option, or by the streams."""
    if bound is not None:
        return bound
    said = [_bound(track.there["ahead"]) for track in tracks if track.there is not None]
    return max((each for each in said if each is not None), default=HOUR)


@dataclass(slots=True)
class _Player:
    """Publishes the parts of recordings when they are due.

    The service makes it wait while the readers are behind (back-pressure), so that a recording is
    published as fast as it is evaluated.
    """

    client: Client
    readers: _Readers
    recordings: Mapping[str, Recording]
    extent: Span
    speed: float | None
    shift: int
    latest: int
    """No recorded time is later (ns), but for rows that are left out where the stream's bound says
    so: nothing waits until they are due."""
    left_out: dict[str, int] = field(default_factory=dict)
    """Samples of each stream that were left out, as they were ahead of the clock."""
    sent: dict[str, int] = field(default_factory=dict)
    """Samples of each stream that were accepted so far."""
    looked: float = -inf
    """When the progress of the readers was looked at last."""

    def run(self, *, loop: bool, quiet: bool) -> None:
        """Play once, end the streams and return when all samples are evaluated; or play in a loop,
        each round of which continues where the last one ended."""
        progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("published, {task.fields[evaluated]:,} evaluated"),
            TextColumn("{task.fields[rate]:,.0f} samples/s"),
            TimeElapsedColumn(),
            console=err(),
            disable=quiet,
        )
        with progress:
            tasks = {
                name: progress.add_task(name, total=recording.rows or None, rate=0.0, evaluated=0)
                for name, recording in self.recordings.items()
            }
            for turn in itertools.count():
                shift = self.shift + turn * self.extent.period
                for name, task in tasks.items():
                    progress.reset(task, total=self.recordings[name].rows or None)
                self._once(shift, progress, tasks)
                if not loop:
                    break
                if self.speed is not None:
                    time.sleep(PAUSE / SECOND / self.speed)
            for name in tasks:
                self.client.end(name)
            self.readers.wait(partial(self._show_evaluated, progress, tasks))
            self._show_evaluated(progress, tasks)

    def _show_evaluated(self, progress: Progress, tasks: Mapping[str, TaskID]) -> None:
        """Show how many samples of these streams all readers have evaluated, unless the bar is off:
        it costs a request for each stream."""
        if progress.disable:
            return
        self.looked = time.monotonic()
        for name, task in tasks.items():
            published = int(progress.tasks[task].completed)
            progress.update(task, evaluated=max(0, published - self.readers.behind(name)))

    def _once(self, shift: int, progress: Progress, tasks: Mapping[str, TaskID]) -> None:
        begun = time.monotonic()
        sent = dict.fromkeys(tasks, 0)
        parts = play_all(self.recordings, self.extent.first, speed=self.speed, shift=shift)
        for name, part in parts:
            wait = part.due / SECOND - (time.monotonic() - begun)
            if wait > 0 and int(part.batch.available.min()) - shift <= self.latest:
                time.sleep(wait)
            accepted = self._publish(name, part.batch)
            self.sent[name] = self.sent.get(name, 0) + accepted
            sent[name] += accepted
            elapsed = max(1e-9, time.monotonic() - begun)
            progress.update(tasks[name], advance=len(part.batch), rate=sent[name] / elapsed)
            if time.monotonic() >= self.looked + _LOOK:
                self._show_evaluated(progress, {name: tasks[name]})

    def _publish(self, name: str, batch: SampleBatch) -> int:
        """Publish a part without the samples that are ahead of the clock, and report these; return
        the number of accepted samples."""
        try:
            return self.client.publish(name, batch)
        except ServiceError as error:
            if error.title != AHEAD:
                raise
            is_ahead = batch.available > read_time(str(error.problem["latest"]))
            refused = error
        left_out = batch.take(is_ahead)
        self.left_out[name] = self.left_out.get(name, 0) + len(left_out)
        _, _, values = next(left_out.rows())
        more = f" and {len(left_out) - 1:,} more" if len(left_out) > 1 else ""
        err().print(
            f"{name}: left out {show_values(values)}{more}: {refused.args[0]}\n"
            "      --ahead oo takes such rows, where replay declares the stream",
            markup=False,
            highlight=False,
        )
        kept = batch.take(~is_ahead)
        return self.client.publish(name, kept) if len(kept) else 0


def _declared(meaning: str) -> tuple[str, ...]:
    """Return the streams that an SSL text annotates."""
    from ....languages.ssl import parse_ssl
    from ....languages.ssl.ast import StreamDeclaration

    return tuple(one.name for one in parse_ssl(meaning) if isinstance(one, StreamDeclaration))


def _summary(
    stream: str,
    counts: dict[str, int],
    extent: Span,
    seconds: float,
    rebased: bool,
    as_json: bool,
    dropouts: int | None,
    order: TimeOrder | None,
    rounded: Rounded | None,
) -> None:
    if as_json:
        told = {"stream": stream, **counts, "seconds": round(seconds, 3)}
        if order is not None and order.out_of_order:
            told |= {"out_of_order": order.out_of_order, "sorted": order.is_sorted}
        if rounded is not None:
            told["rounded"] = asdict(rounded)
        show_json(told if dropouts is None else {**told, "dropouts": dropouts})
        return
    rate = counts["accepted"] / max(seconds, 1e-9)
    show_text(
        f"{stream}: {counts['accepted']:,} samples accepted, {counts['evaluated']:,} evaluated in "
        f"{seconds:.1f} s ({rate:,.0f}/s), recorded {format_time(extent.first)} to "
        f"{format_time(extent.last)}"
    )
    rest = [f"{fate} {counts[fate]:,}" for fate in _FATES[1:] if counts[fate] or fate == "used"]
    if counts["ahead"]:
        rest.append(f"left out {counts['ahead']:,}, ahead of the clock")
    show_text("  " + ", ".join(rest))
    if rounded is not None:
        show_text(
            f"  rounded {rounded.count:,} numbers to the nearest double, "
            f"the first in line {rounded.line}, field {rounded.field!r}"
        )
    unused = counts["late"] + counts["duplicate"]
    if unused > counts["accepted"] / 2:
        # The usual cause: available times only grow, and the stream had later samples before.
        much = "everything" if unused == counts["accepted"] else "most"
        show_text(
            f"hint: {much} was late: the stream has later samples already, perhaps of the "
            "same recording.\n      "
            + (
                "Wait, or use another stream."
                if rebased
                else f"Forget them first (dyknow streams --remove {stream}), or add --rebase now."
            )
        )
