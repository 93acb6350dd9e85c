"""How long the service waits for the body of a request: 408 for one that does not come to its end
in time, or trickles.

One look at all that wait, a few times a second, in place of a timer each: that would cost as much
as the decoding of a small batch. Of live bodies service/runtime/live_ingest sees to it that
something comes.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from starlette.types import Message, Receive

from .problems import Problem

GRACE = 5.0
"""Seconds before it is asked how fast a body comes."""
LOOKS = 20
"""So often the waiting are looked at within the time that a body has."""


class Wait:
    """One body that is waited for: since when, and how much of it has come."""

    def __init__(self, begun: float) -> None:
        self.begun = begun
        self.size = 0
        self.is_late = False
        self.task: asyncio.Task[Any] | None = None


class SlowBodies:
    """Bodies must be there within ``timeout`` seconds, and come with ``rate`` bytes a second on
    average (0: at any). ``refused`` counts refusals by their title."""

    def __init__(self, timeout: float, rate: int, refused: Callable[[str], None]) -> None:
        self._refused = refused
        self._timeout = timeout
        self._rate = rate
        self._waiting: set[Wait] = set()
        self._looking: asyncio.TimerHandle | None = None

    def in_time(self, receive: Receive, method: str) -> Receive:
        """``receive`` of a request, which raises a 408 `Problem` when its body takes too long. A
        GET whose body nobody asked for is over then: the answer may have begun."""
        wait: Wait | None = None
        is_over = False

        async def timed() -> Message:
            nonlocal wait, is_over
            if is_over:  # what is waited for now is that the client goes
                return await receive()
            if wait is None:
                wait = Wait(asyncio.get_running_loop().time())
            try:
                message = await self._next(wait, receive)
            except Problem as problem:
                self._refused(problem.title)
                if method != "GET":
                    raise
                return {"type": "http.disconnect"}
            is_over = not message.get("more_body", False)
            return message

        return timed

    async def _next(self, wait: Wait, receive: Receive) -> Message:
        task = asyncio.current_task()
        assert task is not None
        wait.task = task
        cancelling = task.cancelling()
        self._waiting.add(wait)
        if self._looking is None:
            self._look_later()
        try:
            message = await receive()
        except asyncio.CancelledError:
            # As asyncio.timeout does: a cancellation of somebody else's goes on.
            if wait.is_late and task.uncancel() <= cancelling:
                raise self._problem() from None
            raise
        finally:
            self._waiting.discard(wait)
        wait.size += len(message.get("body", b""))
        return message

    def deadline(self, wait: Wait) -> float:
        """When a body must be there, or more of it have come, in the loop's time."""
        allowed = self._timeout
        if self._rate:
            allowed = min(allowed, GRACE + wait.size / self._rate)
        return wait.begun + allowed

    def _look_later(self) -> None:
        loop = asyncio.get_running_loop()
        self._looking = loop.call_later(min(self._timeout / LOOKS, 0.5), self._look)

    def _look(self) -> None:
        self._looking = None
        now = asyncio.get_running_loop().time()
        for wait in self._waiting:
            if now > self.deadline(wait) and not wait.is_late and wait.task is not None:
                wait.is_late = True
                wait.task.cancel()
        if self._waiting:
            self._look_later()

    def _problem(self) -> Problem:
        rate = f", or at less than {self._rate} bytes a second" if self._rate else ""
        return Problem(
            408,
            "slow body",
            f"the body did not come within {self._timeout:g} seconds{rate}",
            hint="send smaller bodies, or live samples to /streams/{name}/samples/live",
            # What of the body still comes is no request.
            headers={"Connection": "close"},
        )
