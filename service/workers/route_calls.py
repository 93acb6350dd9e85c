"""Isolated work for a request: what became of it as a `Problem`; its end when the client goes."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import TypeVar

import anyio
from fastapi import Request

from ..http.problems import Problem
from .pool import Busy
from .sparql import NotUpToDate
from .worker import Died, TookTooLong, WorkerError

T = TypeVar("T")
_RETRY = {"Retry-After": "10"}


async def while_connected(request: Request, work: Callable[[], Awaitable[T]]) -> T:
    """What ``work`` gives; it is cancelled when the client goes. Its body has been read.

    Raises `Problem`: 503 when there is no worker or it takes too long, 422 when it needs too much.
    """
    found: list[T] = []
    errors: list[Exception] = []

    async with anyio.create_task_group() as tasks:

        async def watch() -> None:
            while (await request.receive())["type"] != "http.disconnect":
                pass
            tasks.cancel_scope.cancel()

        tasks.start_soon(watch)
        try:
            found.append(await work())
        except Exception as error:  # noqa: BLE001  raised below, alone and not in a group
            errors.append(error)
        tasks.cancel_scope.cancel()
    if found:
        return found[0]
    raise _problem(errors[0]) if errors else Problem(503, "client gone", "nobody waits any more")


def _problem(error: Exception) -> Exception:
    match error:
        case Busy():
            return Problem(
                503,
                "too many queries",
                "all workers are busy, and many wait for them",
                hint="send it again after the seconds in Retry-After",
                headers=_RETRY,
            )
        case TookTooLong():
            return Problem(
                503,
                "query too slow",
                "no answer within the time that one may take",
                hint="ask for less: name the graph patterns that join, add a LIMIT",
                headers=_RETRY,
            )
        case Died():
            return Problem(
                422,
                "query needs too much",
                f"it was stopped: {error}",
                hint="ask for less: name the graph patterns that join, add a LIMIT",
            )
        case NotUpToDate():
            return Problem(
                503,
                "no worker",
                str(error),
                hint="start the service with more DYKNOW_WORKER_MEMORY",
                headers=_RETRY,
            )
        case WorkerError():
            return Problem(503, "no worker", str(error), headers=_RETRY)
    return error
