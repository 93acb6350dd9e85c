"""The page Live of the console beside many events: frames, what is drawn, memory, processor time.

    python bench/service/console.py [EVENTS_A_SECOND]

The service, a headless Chromium and this program, which publishes, share one machine. 1,000 objects
have a sample each many times a second, and a request answers each with an event. Printed are, of
some seconds: the events that the page has taken, frames a second and the longest, rows in the
document, the page's memory, and the parts of a core that the page's main thread and the service
need. Chromium draws without a graphics card, at most 60 frames a second.
"""

from __future__ import annotations

import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / name) for name in ("support", "support/services")]

import httpx  # noqa: E402
from chromium import Browser, Page  # noqa: E402
from latency import cpu_seconds  # noqa: E402
from serving import Serving  # noqa: E402

OBJECTS, WARM, SECONDS = 1_000, 6, 10
SSL = "stream cars contains speed(Car) = v [km.h-1] for every Car = id"
TEMPLATE = """REGISTER TEMPLATE dyknow:Moves(?o) COMPUTE EVERY {step}ms AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT {{?o dyknow:speed ?mean}}
WHERE {{ ?o a dyknow:Car . ?o dyknow:speed ?v . }}
AGGREGATE {{(?mean, AVG, {{?v}}) FILTER (?mean > 0)}}
WINDOW [RANGE {step}ms STEP {step}ms]
"""
COUNT_FRAMES = """window.frames_ = {count: 0, longest: 0, last: 0};
(function next(time) {
  const f = window.frames_;
  if (f.last) { f.count++; f.longest = Math.max(f.longest, time - f.last); }
  f.last = time;
  requestAnimationFrame(next);
})(performance.now());"""
FRAMES = "[frames_.count, frames_.longest, frames_.last]"
TAKEN = "import('/console/feed.js').then((feed) => feed.arrivals.value.total)"
ROWS = "document.querySelectorAll('.line').length"


def main() -> None:
    rate = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    service = Serving(None)
    with tempfile.TemporaryDirectory() as folder:
        browser = Browser(Path(folder))
        try:
            declare(service.http, OBJECTS * 1_000 // rate)
            with publishing(service.url, rate):
                page = browser.page()
                page.open(f"{service.url}/#live")
                page.wait(f"{ROWS} > 8")
                time.sleep(WARM)
                measure(page, service)
        finally:
            browser.close()
            service.stop()


def declare(http: httpx.Client, step: int) -> None:
    """A stream of cars, and a request that says of each sample that it moves."""
    http.put("/streams/cars", json={"fields": {"id": "string", "v": "float"}}).raise_for_status()
    text = {"Content-Type": "text/plain"}
    for path, content in (
        ("annotations", SSL),
        ("templates", TEMPLATE.format(step=step)),
        ("events", "dyknow:Moves(?o)"),
    ):
        http.post(f"/{path}", content=content, headers=text).raise_for_status()


@contextmanager
def publishing(url: str, rate: int) -> Iterator[None]:
    """Publish in a thread."""
    stopped = threading.Event()
    publisher = threading.Thread(target=publish, args=(url, rate, stopped))
    publisher.start()
    try:
        yield
    finally:
        stopped.set()
        publisher.join()


def publish(url: str, rate: int, stopped: threading.Event) -> None:
    """A sample of each object, so many times a second that ``rate`` samples come."""
    every, number = OBJECTS / rate, 0
    with httpx.Client(base_url=url, trust_env=False, timeout=60) as http:
        begun = time.time()
        while not stopped.is_set():
            number += 1
            time.sleep(max(0.0, begun + number * every - time.time()))
            at = time.time_ns()
            lines = (
                f'{{"available":{at},"valid":{at},"id":"c{i}","v":{50 + i % 70}.5}}'
                for i in range(OBJECTS)
            )
            http.post(
                "/streams/cars/samples",
                content="\n".join(lines),
                headers={"Content-Type": "application/x-ndjson"},
            ).raise_for_status()


def measure(page: Page, service: Serving) -> None:
    """Print what `SECONDS` of the page have."""
    process = service.process.pid
    page.call("Performance.enable")
    page.run(COUNT_FRAMES)
    events, busy, used = page.run(TAKEN), main_thread(page), cpu_seconds(process)
    begun = time.monotonic()
    time.sleep(SECONDS)
    count, longest, _ = page.run(FRAMES)
    taken, passed = page.run(TAKEN) - events, time.monotonic() - begun
    busy, used = main_thread(page) - busy, cpu_seconds(process) - used
    print(f"{taken / passed:8,.0f} events a second that the page has taken")
    print(f"{count / passed:8.1f} frames a second; the longest took {longest:.0f} ms")
    print(f"{page.run(ROWS):8,} rows in the document")
    print(f"{page.run('performance.memory.usedJSHeapSize') / 1e6:8.0f} MB of the page's heap")
    print(f"{busy / passed:8.0%} of a core: the page's main thread")
    print(f"{used / passed:8.0%} of a core: the service")
    assert page.complaints == [], page.complaints


def main_thread(page: Page) -> float:
    """Seconds that the page's main thread has worked."""
    metrics = page.call("Performance.getMetrics")["metrics"]
    return next(each["value"] for each in metrics if each["name"] == "TaskDuration")


if __name__ == "__main__":
    main()
