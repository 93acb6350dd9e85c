"""Frames a second that the console draws while events arrive, in headless Chromium.

    python bench/console.py [EVENTS A SECOND]

Needs Chromium. The service is a process of its own; so is this one, which publishes every 0.1 s.
The page Live follows a subscription to the stream. Chromium draws without a graphics card, on the
cores that all three share. *rows* are those in the document, *heap* is that of JavaScript.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import httpx

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "tests" / "support")]

from chromium import Browser  # noqa: E402

SECONDS = 10
SERVE = "from dyknow.service.cli import main; main()"
LINES = {"Content-Type": "application/x-ndjson"}
FOLLOWS = "import('/console/feed.js').then((m) => m.following.value.includes('numbers'))"
FRAMES = f"""new Promise((done) => {{ const begun = performance.now(); let frames = 0;
  const step = () => {{ frames++;
    if (performance.now() - begun < {1000 * SECONDS}) requestAnimationFrame(step);
    else done(frames / {SECONDS}); }};
  requestAnimationFrame(step); }})"""
ARRIVED = "import('/console/feed.js').then((m) => m.arrivals.value.total)"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rate", type=int, nargs="?", default=10_000)
    rate = parser.parse_args().rate
    served = subprocess.Popen(
        [sys.executable, "-c", SERVE, "serve", "--port", "0"], stdout=subprocess.PIPE, text=True
    )
    try:
        assert served.stdout is not None
        found = re.search(r"http://127\.0\.0\.1:\d+", served.stdout.readline())
        assert found is not None, "the service does not name its address"
        measure(found[0], rate)
    finally:
        served.terminate()
        served.wait()


def measure(url: str, rate: int) -> None:
    """Print the line of the table."""
    with (
        httpx.Client(base_url=url, trust_env=False, timeout=60) as http,
        tempfile.TemporaryDirectory() as folder,
    ):
        while http.get("/readyz").status_code != 200:
            time.sleep(0.5)
        http.put("/streams/numbers", json={"fields": {"id": "string", "v": "integer"}})
        http.post("/subscriptions", json={"stream": "numbers"}).raise_for_status()
        browser = Browser(Path(folder))
        try:
            page = browser.page(width=1400, height=900)
            page.open(f"{url}/#live")
            page.wait(FOLLOWS)
            sender = threading.Thread(target=send, args=(http, rate))
            sender.start()
            time.sleep(1)  # the first events are there
            frames, arrived = page.run(FRAMES), page.run(ARRIVED)
            rows = page.run("document.querySelectorAll('.line').length")
            heap = page.run("performance.memory.usedJSHeapSize") / 2**20
            sender.join()
        finally:
            browser.close()
    print(
        f"{rate:,} events/s: {frames:.0f} frames/s (aim 50), {rows} rows (60), {heap:.0f} MiB heap "
        f"(150); {arrived:,} events arrived"
    )


def send(http: httpx.Client, rate: int) -> None:
    """Publish at a steady rate until the measurement is over."""
    begun = time.monotonic()
    for i in range(10 * (SECONDS + 2)):
        now = time.time_ns()
        numbers = range(i * rate // 10, (i + 1) * rate // 10)
        lines = (json.dumps({"valid": now + n, "id": f"o{n % 20}", "v": n}) for n in numbers)
        answer = http.post("/streams/numbers/samples", content="\n".join(lines), headers=LINES)
        answer.raise_for_status()
        time.sleep(max(0.0, begun + (i + 1) / 10 - time.monotonic()))


if __name__ == "__main__":
    main()
