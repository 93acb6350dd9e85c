"""A headless Chromium for tests, spoken to through the DevTools protocol on two pipes.

Neither a driver nor a package is needed. Tests skip where there is no Chromium.
"""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser")
MISSING = "there is no chromium: install Debian's package"
PATIENCE = 60.0
"""Seconds that a call or a condition may take on a busy machine."""


class BrowserError(AssertionError):
    """The browser refused a call, or a script raised an error."""


class Browser:
    """One process of Chromium, whose pages each have a context (storage, cookies) of their own."""

    def __init__(self, folder: Path) -> None:
        assert PROGRAM is not None, MISSING
        ours_in, theirs_out = os.pipe()
        theirs_in, ours_out = os.pipe()
        flags = [
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            f"--user-data-dir={folder}",
            "--remote-debugging-pipe",
        ]
        # Chromium reads from descriptor 3 and writes to 4.
        script = f'exec "$@" 3<&{theirs_in} 4>&{theirs_out}'
        self._process = subprocess.Popen(
            ["bash", "-c", script, "bash", PROGRAM, *flags],
            pass_fds=(theirs_in, theirs_out),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(theirs_in)
        os.close(theirs_out)
        self._in, self._out = ours_in, ours_out
        self._rest = b""
        self._number = 0
        self._answers: dict[int, dict[str, Any]] = {}
        self._pages: dict[str, Page] = {}

    def page(self, *, width: int = 1400, height: int = 900) -> Page:
        """A new page of this size."""
        context = self.call("Target.createBrowserContext")["browserContextId"]
        target = self.call(
            "Target.createTarget",
            url="about:blank",
            browserContextId=context,
            width=width,
            height=height,
        )["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        page = Page(self, session, target)
        self._pages[session] = page
        page.begin(width, height)
        return page

    def call(self, method: str, session: str | None = None, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol; return its result. Raises `BrowserError`."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if session is not None:
            message["sessionId"] = session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        own, until = self._number, time.monotonic() + PATIENCE
        while own not in self._answers:
            self.read(until - time.monotonic())
            if time.monotonic() > until:
                raise BrowserError(f"{method} has no answer after {PATIENCE} s")
        answer = self._answers.pop(own)
        if "error" in answer:
            raise BrowserError(f"{method}: {answer['error']['message']}")
        result: dict[str, Any] = answer.get("result", {})
        return result

    def read(self, seconds: float) -> None:
        """Take what the browser says within some seconds."""
        ready, _, _ = select.select([self._in], [], [], max(0.0, seconds))
        if not ready:
            return
        data = os.read(self._in, 1 << 20)
        if not data:
            raise BrowserError("chromium has ended")
        *messages, self._rest = (self._rest + data).split(b"\0")
        for message in map(json.loads, messages):
            if "id" in message:
                self._answers[message["id"]] = message
            elif (page := self._pages.get(message.get("sessionId", ""))) is not None:
                page.heard(message["method"], message["params"])

    def forget(self, session: str) -> None:
        """Forget a closed page."""
        del self._pages[session]

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        self._process.wait(PATIENCE)
        os.close(self._in)
        os.close(self._out)


class Page:
    """A page. ``complaints`` are errors, warnings and violations of the policy; ``requested`` are
    the addresses that it asked for."""

    def __init__(self, browser: Browser, session: str, target: str) -> None:
        self._browser = browser
        self._session = session
        self._target = target
        self.complaints: list[str] = []
        self.requested: list[str] = []

    def begin(self, width: int, height: int) -> None:
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )
        violation = "addEventListener('securitypolicyviolation', (event) => "
        violation += "console.error('policy', event.violatedDirective, event.blockedURI))"
        self.call("Page.addScriptToEvaluateOnNewDocument", source=violation)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        return self._browser.call(method, self._session, **parameters)

    def heard(self, method: str, about: dict[str, Any]) -> None:
        """Note what the browser reports of the page."""
        if method == "Runtime.exceptionThrown":
            details = about["exceptionDetails"]
            thrown = details.get("exception", {}).get("description", details["text"])
            self.complaints.append(thrown)
        elif method == "Runtime.consoleAPICalled" and about["type"] in ("error", "warning"):
            self.complaints.append(" ".join(str(each.get("value")) for each in about["args"]))
        elif method == "Log.entryAdded" and about["entry"]["level"] in ("error", "warning"):
            entry = about["entry"]
            self.complaints.append(f"{entry['text']} {entry.get('url', '')}")
        elif method == "Network.requestWillBeSent":
            self.requested.append(about["request"]["url"])

    def open(self, url: str) -> None:
        self.call("Page.navigate", url=url)

    def run(self, expression: str) -> Any:
        """The value of an expression, awaited. Raises `BrowserError` for what it throws."""
        answer = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in answer:
            details = answer["exceptionDetails"]
            raise BrowserError(details.get("exception", {}).get("description", details["text"]))
        return answer["result"].get("value")

    def wait(self, expression: str, seconds: float = PATIENCE) -> Any:
        """Wait until an expression is true, and return its value."""
        return self._until(lambda: self.run(expression), expression, seconds)

    def wait_text(self, text: str, seconds: float = PATIENCE) -> None:
        """Wait until the page shows a text."""
        wanted = json.dumps(text)
        self.wait(f"document.body?.innerText.includes({wanted})", seconds)

    def click(self, selector: str, text: str = "") -> None:
        """Click the first element of a selector that has a text, as soon as there is one."""
        find = f"[...document.querySelectorAll({json.dumps(selector)})]"
        find += f".find((each) => each.textContent.includes({json.dumps(text)}) && !each.disabled)"
        self.wait(f"Boolean({find})")
        self.run(
            f"{find}.dispatchEvent(new MouseEvent('click', {{bubbles: true, cancelable: true}}))"
        )

    def choose(self, selector: str, value: str) -> None:
        """Give a field a value, as a person would."""
        field = f"document.querySelector({json.dumps(selector)})"
        self.wait(f"Boolean({field})")
        self.run(
            f"(() => {{ const field = {field}; field.value = {json.dumps(value)};"
            " for (const kind of ['input', 'change'])"
            " field.dispatchEvent(new Event(kind, {bubbles: true})); })()"
        )

    def press(self, key: str) -> None:
        """Press a key where the focus is."""
        for kind in ("keyDown", "keyUp"):
            text = {"text": key} if len(key) == 1 and kind == "keyDown" else {}
            self.call("Input.dispatchKeyEvent", type=kind, key=key, **text)

    def picture(self, path: Path) -> None:
        """Write a screenshot as PNG."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot")["data"]))

    def close(self) -> None:
        self._browser.call("Target.closeTarget", targetId=self._target)
        self._browser.forget(self._session)

    def _until(self, found: Callable[[], Any], what: str, seconds: float) -> Any:
        until = time.monotonic() + seconds
        while not (value := found()):
            if time.monotonic() > until:
                shown = str(self.run("document.body.innerText"))[:2000]
                raise BrowserError(f"not within {seconds} s: {what}\n{self.complaints}\n{shown}")
            self._browser.read(0.1)
        return value
