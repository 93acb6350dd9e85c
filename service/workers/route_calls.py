"""Isolated work for a request: it ends when the client disconnects; errors become a `Problem`."""

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
    """Return the result of ``work``, and cancel it if the client disconnects. Contract: the body
    has been read.

    Raises `Problem`: 503 if there is no worker or the time is over, 422 if the work exceeds another
    limit.
    """
    results: list[T] = []
    errors: list[Exception] = []

    async with anyio.create_task_group() as tasks:

        async def watch() -> None:
            while (await request.receive())["type"] != "http.disconnect":
                pass
            tasks.cancel_scope.cancel()

        tasks.start_soon(watch)
        try:
            results.append(await work())
        except Exception as error:  # noqa: BLE001  raised below, not in an exception group
            errors.append(error)
        tasks.cancel_scope.cancel()
    if results:
        return results[0]
    raise (
        _problem(errors[0])
        if errors
        else Problem(503, "client gone", "the client has disconnected")
    )


def _problem(error: Exception) -> Exception:
    match error:
        case Busy():
            return Problem(
                503,
                "too many queries",
                "all workers are busy, and many requests wait for them",
                hint="send the request again after the seconds in Retry-After",
                headers=_RETRY,
            )
        case TookTooLong():
            return Problem(
                503,
                "query too slow",
                "there was no answer within the time limit",
                hint="reduce the result: join the graph patterns, add a LIMIT",
                headers=_RETRY,
            )
        case Died():
            return Problem(
                422,
                "query needs too much",
                f"the service stopped it: {error}",
                hint="reduce the result: join the graph patterns, add a LIMIT",
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
