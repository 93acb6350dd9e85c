"""The work of ``dyknow serve``: make settings, engine and workers, then run the service."""

from __future__ import annotations

import gc
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

from ...converters.recordings.many_streams import has_many_streams
from ...converters.recordings.names import valid_name
from ...engine.durability.durable_engine import RecordedEngine
from ...engine.engine import Engine
from ...journal.errors import JournalError, is_full
from ...ontology.errors import OntologyError
from ..admission.tokens import Scope, Tokens, TokensError
from ..app import create_app
from ..config.defaults import TOKEN
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
from .loading import Say, load, print_note
from .output import JSON_WANTED, fail
from .recordings.demonstration import STREAM
from .recordings.demonstration import flights as play_flights


def start(
    given: Mapping[str, Any], *, flights: bool, recording: Path | None, ssl: str | None
) -> None:
    """Run the service with these settings and the environment's, until it is stopped. It plays the
    ``recording``, of which ``ssl`` says what its streams contain."""
    settings = Settings(**given)
    # Imported objects stay for good. Without freezing, each collection of the start scans them.
    gc.freeze()
    configure(settings.log_level, settings.log_json)
    say = _log_note if settings.log_json else print_note
    JSON_WANTED.set(settings.log_json)
    try:
        accepted_tokens = Tokens.of(settings)
    except TokensError as error:
        raise fail(error.message, error.hint) from error
    load(settings.processes, say)
    if settings.tokens_file is not None and hasattr(signal, "SIGHUP"):
        # Before the handler exists a SIGHUP would end the process. It then reads changes anyway.
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        listener = bind(settings)
    except OSError as error:
        raise fail(
            f"cannot listen at {settings.host}:{settings.port}: {error.strerror or error}",
            "choose another --port",
        ) from error
    raise_limit()
    # How long a thread beside the event loop keeps the interpreter before the loop may go on.
    sys.setswitchinterval(0.001)
    watchdog = Watchdog()
    plays = flights or recording is not None
    needs_token = plays and accepted_tokens.required
    token = accepted_tokens.issue("player", Scope.ADMIN) if needs_token else ""
    windows = Windows(settings)
    warming = WarmUp()
    warming.loops()
    warming.workers("windows", windows.pool)
    try:
        engine = _engine(settings, watchdog, windows, say)
        windows.end_replay()
    except BaseException:
        listener.close()
        windows.close()
        warming.end()
        raise
    app = create_app(engine, settings, time.time_ns, accepted_tokens, windows)
    url = url_of(listener)
    say(f"DyKnow serves at {url} (the console; all routes: {url}/docs)")
    service: Service = app.state.service
    service.warming = warming
    collector = service.collector = CollectionSchedule()
    collector.begin()
    warming.workers("sparql", service.isolation.pools["sparql"])
    warming.application(app)
    _reload_on_hangup(service, settings)
    stopping = threading.Event()
    if flights:
        plays_into = f"The recorded flights play into stream {STREAM}, at the present time."
        player = threading.Thread(
            target=play_flights,
            args=(url, stopping.is_set, token),
            kwargs={"begins": lambda: say(plays_into)},
            daemon=True,
        )
        player.start()
    replay = (
        None
        if recording is None
        else _replay(recording, ssl, url, token, as_json=settings.log_json)
    )
    # Through JSON: the log's format has no infinity.
    values = json.loads(settings.model_dump_json(exclude_defaults=True))
    log().info("serving", version=__version__, url=url, epoch=service.engine.epoch, settings=values)
    try:
        by_force = run(app, listener)
    finally:
        stopping.set()
        if replay is not None:
            replay.terminate()
            replay.wait()
        watchdog.close()
        for isolated in (windows, service.isolation):
            isolated.close()
        warming.end()
        collector.end()
    log().info("stopped", by_force=by_force)
    if by_force:
        raise typer.Exit(1)


def _replay(
    path: Path, ssl: str | None, url: str, token: str, *, as_json: bool
) -> subprocess.Popen[bytes]:
    """Start `dyknow replay`, all of the recording at once: reading it takes a processor."""
    command = [sys.executable, "-c", "from dyknow.service.cli import main; main()", "replay"]
    command += [str(path), "--speed", "max", "--url", url]
    if not has_many_streams(path):
        command += ["--stream", valid_name(path.name.partition(".")[0], "stream")]
    if ssl is not None:
        command += ["--ssl", ssl]
    if as_json:
        command.append("--json")
    # Ctrl-C in the terminal must reach the service only, which ends it.
    return subprocess.Popen(command, env=os.environ | {TOKEN: token}, start_new_session=True)


def _reload_on_hangup(service: Service, settings: Settings) -> None:
    """Let SIGHUP reload the file of tokens; without one it ends the service, as usual."""
    file = service.token_file
    if file is not None and settings.tokens_file is not None and hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, lambda *_: file.ask())


def _log_note(text: str) -> None:
    """Log a note: programs that read standard error expect lines of the log."""
    log().info(text)


def _engine(
    settings: Settings, watchdog: Watchdog, windows: Windows, say: Say
) -> Engine | RecordedEngine:
    """Make a new engine in memory, or recover that of the data directory."""
    if settings.data is None:
        return Engine(
            now=time.time_ns(),
            runner=watchdog,
            stopwatch=time.perf_counter_ns,
            budget=windows.budget,
            turns=windows.turns,
        )

    def progress(done: int, count: int) -> None:
        say(f"  {done:,} of {count:,} commands replayed")

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
        hint = "--data names the directory, in which the service must be able to read and write"
        if is_full(error):
            hint = "free some space on the disk, and start again"
        raise fail(f"{settings.data} cannot be used: {error.strerror or error}", hint) from error
    recovery = engine.recovery
    for note in recovery.notes:
        if settings.log_json:
            log().warning("start", note=note)
        else:
            say(f"note: {note}")
    say(
        f"{settings.data}: state of command {recovery.position:,}, "
        f"{recovery.replayed:,} replayed since"
    )
    return engine
