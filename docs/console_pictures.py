"""Take the pictures of the console that README and docs show, from services of its own.

    pip install pillow
    python docs/console_pictures.py

It needs Chromium (Debian's package). Look at what it wrote before you commit it.
"""

from __future__ import annotations

import io
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from PIL import Image

HERE = Path(__file__).parent
ROOT = HERE.parent
sys.path[:0] = [str(ROOT / "tests" / name) for name in ("support", "support/services")]

from chromium import Browser, Page  # noqa: E402
from launching import SERVICE  # noqa: E402
from serving import Serving  # noqa: E402

FRAMES = 24
INTERVAL = 0.5
"""Seconds between two frames of the moving picture."""
WIDTH = 900


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        browser = Browser(Path(folder))
        try:
            with_service(lambda service: flights(browser, service), "--flights")
            with_service(lambda service: robots(browser, service))
        finally:
            browser.close()


def with_service(work: Callable[[Serving], None], *options: str) -> None:
    service = Serving(None, *options)
    try:
        work(service)
    finally:
        service.stop()


def flights(browser: Browser, service: Serving) -> None:
    """The page Live with fast aircraft: a picture, and a moving one."""
    service.until(lambda: service.http.get("/templates/HighSpeedEvent").is_success)
    for text in (
        "HighSpeedEvent(?o, dyknow:Aircraft, 800)",
        "HighSpeedEvent(?o, dyknow:Aircraft, 400)",
    ):
        asked = {"Content-Type": "text/plain"}
        service.http.post("/events?since=start", content=text, headers=asked).raise_for_status()
    page = opened(browser, service, "live")
    page.wait("document.querySelectorAll('.line .who').length > 8")
    page.click(".ask-row", "400")
    time.sleep(20)
    page.picture(HERE / "how-to" / "console.png")
    frames = []
    for _ in range(FRAMES):
        path = Path(tempfile.gettempdir()) / "frame.png"
        page.picture(path)
        frames.append(Image.open(io.BytesIO(path.read_bytes())).convert("RGB"))
        path.unlink()
        time.sleep(INTERVAL)
    size = (WIDTH, frames[0].height * WIDTH // frames[0].width)
    palette = frames[0].quantize(64)
    small = [f.resize(size, Image.Resampling.LANCZOS).quantize(palette=palette) for f in frames]
    small[0].save(
        HERE / "how-to" / "console.gif",
        save_all=True,
        append_images=small[1:],
        duration=int(INTERVAL * 1000),
        loop=0,
        optimize=True,
    )


def robots(browser: Browser, service: Serving) -> None:
    """The page Graph with the stream of the robots' tutorial."""
    ssl = (HERE / "tutorial" / "your-own-robot.md").read_text().split("```ssl robots.ssl\n")[1]
    ssl = ssl.partition("```")[0]
    for words in (
        ["ontology", "add-sort", "Robot"],
        ["ontology", "add-feature", "battery", "--sort", "Robot", "--unit", "percent"],
        ["ontology", "add-feature", "velocity", "--sort", "Robot", "--unit", "m.s-1"],
        ["ontology", "add-feature", "motorTemperature", "--sort", "Robot", "--unit", "degC"],
        ["replay", "examples/robots.csv", "--stream", "robots", "--speed", "max", "--ssl", ssl],
    ):
        command = [sys.executable, "-c", SERVICE, *words, "--url", service.url]
        subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    page = opened(browser, service, "graph/robots")
    page.wait_text("stream robots contains")
    time.sleep(3)
    page.picture(HERE / "tutorial" / "robots.png")


def opened(browser: Browser, service: Serving, name: str) -> Page:
    page = browser.page(width=1280, height=800)
    page.open(f"{service.url}/#{name}")
    return page


if __name__ == "__main__":
    main()
