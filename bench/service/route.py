"""The way of one sample: each file and function of the house that it passes, from its request to an
SSE message.

    python bench/service/route.py [--data] [--list]

In memory, or with a data directory; ``--list`` prints each call.

A high-speed event is requested for all aircraft of a stream of positions, so the sample passes a
unit that computes speeds, a window that its time closes, a filter, and the output stream.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from types import FrameType
from typing import Any

import httpx

from dyknow.continuous.columns.budget import Budget
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.config.settings import Settings
from dyknow.service.server import running
from dyknow.service.turns.window_turns import WindowTurns

HOUSE = Path(__file__).resolve().parents[2]
TEMPLATE = (HOUSE / "templates/library/high_speed.rq").read_text()
ANNOTATION = """
stream positions contains latitude(Aircraft) = lat [deg], longitude(Aircraft) = lon [deg]
  for every Aircraft = id
"""
START = 1_700_000_000
WARM = 8


class Route:
    """Records calls of functions of the house while it is switched on."""

    def __init__(self) -> None:
        self.is_on = False
        self.calls: list[tuple[str, str, str]] = []
        """Thread, file, function, in order."""

    def __call__(self, frame: FrameType, event: str, _: Any) -> None:
        if not self.is_on or event != "call":
            return
        path = Path(frame.f_code.co_filename)
        name = frame.f_code.co_qualname
        # Comprehensions and lambdas are parts of their functions.
        is_ours = path.is_relative_to(HOUSE) and not path.is_relative_to(HOUSE / ".venv")
        if is_ours and path != Path(__file__) and not name.endswith(">"):
            thread = threading.current_thread().name
            self.calls.append((thread, str(path.relative_to(HOUSE)), name))


@contextmanager
def serving(directory: Path | None) -> Iterator[tuple[str, Any]]:
    """A service in this process, in memory or over ``directory``."""
    settings = Settings(port=0)
    clock = time.time_ns
    turns = WindowTurns(settings.query_seconds, settings.query_behind)
    budget = Budget(pauses=turns)
    if directory is None:
        engine: Engine | RecordedEngine = Engine(now=clock(), budget=budget, turns=turns)
    else:
        engine = RecordedEngine(directory, now=clock(), budget=budget, turns=turns)
    app = create_app(engine, settings, clock)
    with running(app, settings) as url:
        yield url, app.state.service


def line(second: int) -> str:
    at = (START + second) * 10**9
    return json.dumps(
        {"available": at, "valid": at, "id": "a1", "lat": 48.0 + 0.003 * second, "lon": 2.0}
    )


def trace(directory: Path | None, route: Route) -> None:
    with (
        serving(directory) as (url, _),
        httpx.Client(base_url=url, trust_env=False, timeout=60) as http,
    ):
        assert http.post("/templates", content=TEMPLATE).status_code == 201
        assert http.post("/annotations", content=ANNOTATION).status_code == 201
        found = http.post(
            "/events",
            json={"event": "dyknow:HighSpeedEvent", "arguments": ["?o", "dyknow:Aircraft", "100"]},
        )
        assert found.status_code == 201, found.text
        with http.stream("GET", found.json()["events"]) as events:
            lines = events.iter_lines()
            for second in range(WARM + 2):
                route.is_on = second == WARM
                kind = {"Content-Type": "application/x-ndjson"}
                answer = http.post("/streams/positions/samples", content=line(second), headers=kind)
                assert answer.status_code == 202, answer.text
                if second >= 3:  # a speed needs two positions, a window the next sample
                    next(each for each in lines if each.startswith("data:"))
                route.is_on = False


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", action="store_true", help="with a data directory")
    parser.add_argument("--list", action="store_true", help="print each call")
    options = parser.parse_args()
    route = Route()
    threading.setprofile(route)
    sys.setprofile(route)
    with tempfile.TemporaryDirectory() if options.data else nullcontext() as directory:
        trace(None if directory is None else Path(directory) / "data", route)
    sys.setprofile(None)
    if options.list:
        for thread, file, name in route.calls:
            print(f"{thread:18} {file}: {name}")
    files = {file for _, file, _ in route.calls}
    functions = {(file, name) for _, file, name in route.calls}
    print(f"{len(files)} files, {len(functions)} functions, {len(route.calls)} calls")


if __name__ == "__main__":
    main()
