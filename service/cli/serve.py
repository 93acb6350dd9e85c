"""``dyknow serve``: the service, until it is stopped."""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from ...engine.engine import Engine
from ...engine.loading import load_processes
from ...streams.compiled import compile_all
from ..app import create_app
from ..isolation.services import Windows
from ..logs import configure
from ..server import bind, run, url_of
from ..settings import Settings
from ..watchdog import Watchdog
from .demo import STREAM
from .demo import flights as play_flights
from .output import err, fail


def serve(
    host: Annotated[str | None, typer.Option(help="Address to listen at.")] = None,
    port: Annotated[int | None, typer.Option(help="Port; 0 takes a free one.", min=0)] = None,
    data: Annotated[
        Path | None, typer.Option(help="Directory of what outlives a restart.", file_okay=False)
    ] = None,
    processes: Annotated[
        list[str] | None,
        typer.Option(help="A module or .py file with user-written processes. May be repeated."),
    ] = None,
    log_level: Annotated[str | None, typer.Option(help="debug, info, warning, error.")] = None,
    flights: Annotated[
        bool, typer.Option("--flights", help="Play the recorded flights, again and again.")
    ] = False,
) -> None:
    """Run the service. Every setting can also be given as DYKNOW_<NAME>."""
    given: dict[str, Any] = {"host": host, "port": port, "data": data, "log_level": log_level}
    given["processes"] = processes or None
    settings = Settings(**{key: value for key, value in given.items() if value is not None})
    configure(settings.log_level, settings.log_json)
    if settings.data is not None:
        settings.data.mkdir(parents=True, exist_ok=True)
    load(settings.processes)
    try:
        listener = bind(settings)
    except OSError as error:
        raise fail(
            f"cannot listen at {settings.host}:{settings.port}: {error.strerror or error}",
            "choose another --port",
        ) from error
    watchdog = Watchdog()
    windows = Windows(settings)
    engine = Engine(settings.data, now=time.time_ns(), runner=watchdog, budget=windows.budget)
    app = create_app(engine, settings, time.time_ns)
    url = url_of(listener)
    err().print(f"DyKnow serves at {url} (documentation: {url}/docs)", markup=False)
    # Beside the start: the first query and the first large batch should not wait for compilers.
    threading.Thread(target=warm, name="warm", daemon=True).start()
    for isolated in (windows, app.state.service.isolation):
        threading.Thread(target=isolated.warm, name="warm-workers", daemon=True).start()
    stopping = threading.Event()
    if flights:
        player = threading.Thread(target=play_flights, args=(url, stopping.is_set), daemon=True)
        player.start()
        err().print(f"The recorded flights play into stream {STREAM}, as if they flew now.")
    try:
        run(app, listener)
    finally:
        stopping.set()
        watchdog.close()
        for isolated in (windows, app.state.service.isolation):
            isolated.close()


def warm() -> None:
    """Compile the loops, then have the garbage collector pass over all that is there by now: it
    stays for good, and a collection that looks at it lets everybody wait for 100 ms."""
    compile_all()
    gc.collect()
    gc.freeze()


def load(processes: Sequence[str]) -> None:
    """Load user-written processes, of installed packages too; a module that is named and cannot be
    loaded is an error, of an installed one it is said and left."""
    for report in load_processes(processes):
        if report.error and report.origin in processes:
            raise fail(f"{report.origin}: {report.error}")
        if report.error:
            err().print(f"not loaded: {report.origin}: {report.error}", markup=False)
