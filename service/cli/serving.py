"""What ``dyknow serve`` does: settings, engine and workers are made, then the service runs."""

from __future__ import annotations

import gc
import json
import signal
import sys
import threading
import time
from collections.abc import Mapping
from typing import Any

import typer

from ...engine.durability.durable_engine import RecordedEngine
from ...engine.engine import Engine
from ...journal.errors import JournalError, is_full
from ...ontology.errors import OntologyError
from ..admission.tokens import Scope, Tokens, TokensError
from ..app import create_app
from ..config.file_limits import raise_limit
from ..config.logs import configure, log
from ..config.settings import Settings
from ..config.version import __version__
from ..runtime.context import Service
from ..runtime.gc_policy import CollectionSchedule
from ..runtime.process_watchdog import Watchdog
from ..runtime.warm_up import WarmUp
from ..server import bind, run, url_of
from ..workers.services import Windows
from .loading import Say, load, say_to_people
from .output import JSON_WANTED, fail
from .recordings.demonstration import STREAM
from .recordings.demonstration import flights as play_flights


def start(given: Mapping[str, Any], *, flights: bool) -> None:
    """Run the service with these settings, and those of the environment, until it is stopped."""
    settings = Settings(**given)
    # What is imported stays for good: a start makes much, and would have it looked through often.
    gc.freeze()
    configure(settings.log_level, settings.log_json)
    say = _say_in_the_log if settings.log_json else say_to_people
    JSON_WANTED.set(settings.log_json)
    try:
        known = Tokens.of(settings)
    except TokensError as error:
        raise fail(error.message, error.hint) from error
    load(settings.processes, say)
    if settings.tokens_file is not None and hasattr(signal, "SIGHUP"):
        # Until there is somebody to hear it: what changes meanwhile is noticed then.
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        listener = bind(settings)
    except OSError as error:
        raise fail(
            f"cannot listen at {settings.host}:{settings.port}: {error.strerror or error}",
            "choose another --port",
        ) from error
    raise_limit()
    # What works beside the event loop has the interpreter for so long before the loop may go on.
    sys.setswitchinterval(0.001)
    watchdog = Watchdog()
    token = known.issue("flights", Scope.ADMIN) if flights and known.required else ""
    windows = Windows(settings)
    warming = WarmUp()
    warming.loops()
    warming.workers("windows", windows.pool)
    try:
        engine = _engine(settings, watchdog, windows, say)
        windows.begin()
    except BaseException:
        listener.close()
        windows.close()
        warming.end()
        raise
    app = create_app(engine, settings, time.time_ns, known, windows)
    url = url_of(listener)
    say(f"DyKnow serves at {url} (documentation: {url}/docs)")
    service: Service = app.state.service
    service.warming = warming
    collector = service.collector = CollectionSchedule()
    collector.begin()
    warming.workers("sparql", service.isolation.pools["sparql"])
    warming.application(app)
    _reload_on_hangup(service, settings)
    stopping = threading.Event()
    if flights:
        playing = (url, stopping.is_set, token)
        player = threading.Thread(target=play_flights, args=playing, daemon=True)
        player.start()
        say(f"The recorded flights play into stream {STREAM}, as if they flew now.")
    # By way of JSON, which has no infinity.
    values = json.loads(settings.model_dump_json(exclude_defaults=True))
    log().info("serving", version=__version__, url=url, epoch=service.engine.epoch, settings=values)
    try:
        by_force = run(app, listener)
    finally:
        stopping.set()
        watchdog.close()
        for isolated in (windows, service.isolation):
            isolated.close()
        warming.end()
        collector.end()
    log().info("stopped", by_force=by_force)
    if by_force:
        raise typer.Exit(1)


def _reload_on_hangup(service: Service, settings: Settings) -> None:
    """SIGHUP reads the file of tokens again; without one it ends the service, as it always does."""
    file = service.token_file
    if file is not None and settings.tokens_file is not None and hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, lambda *_: file.ask())


def _say_in_the_log(text: str) -> None:
    """Where programs read standard error, every line is one of the log."""
    log().info(text)


def _engine(
    settings: Settings, watchdog: Watchdog, windows: Windows, say: Say
) -> Engine | RecordedEngine:
    """A new engine in memory, or that of the data directory as it was."""
    if settings.data is None:
        return Engine(
            now=time.time_ns(),
            runner=watchdog,
            stopwatch=time.perf_counter_ns,
            budget=windows.budget,
            turns=windows.turns,
        )

    def progress(done: int, count: int) -> None:
        say(f"  {done:,} of {count:,} commands done again")

    try:
        engine = RecordedEngine(
            settings.data,
            now=time.time_ns(),
            runner=watchdog,
            stopwatch=time.perf_counter_ns,
            budget=windows.budget,
            turns=windows.turns,
            durability=settings.durability,
            progress=progress,
        )
    except (JournalError, OntologyError) as error:
        raise fail(error.message, error.hint) from error
    except OSError as error:
        hint = "--data says which directory is used; the service reads and writes in it"
        if is_full(error):
            hint = "make room on the disk, and start again"
        raise fail(f"{settings.data} cannot be used: {error.strerror or error}", hint) from error
    recovery = engine.recovery
    for note in recovery.notes:
        if settings.log_json:
            log().warning("start", note=note)
        else:
            say(f"note: {note}")
    say(
        f"{settings.data}: state of command {recovery.position:,}, "
        f"{recovery.replayed:,} done again since"
    )
    return engine
