"""Long JSON lists, made in parts, with a turn for other requests between two of them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Sequence
from time import monotonic
from typing import Final, TypeVar

from fastapi import Response
from pydantic import BaseModel

from ....engine.model.errors import UNKNOWN
from ...config.media_types import JSON

T = TypeVar("T")

PART: Final = 0.002
"""Seconds of work on a part. A member may take long by itself."""


async def listed(
    items: Sequence[T],
    told: Callable[[T], BaseModel | None],
    rest: Iterable[BaseModel] = (),
    *,
    members: Iterable[str] | None = None,
) -> Response:
    """A JSON list of the models of ``items`` that ``told`` returns, then of ``rest``, a few models,
    with only these ``members``, if there are any. Items without a model are left out.

    Each model is of the time when it is written; items removed before are left out.
    """
    included = None if members is None else set(members)
    written: list[bytes] = []
    until = monotonic() + PART
    for item in items:
        if monotonic() >= until:
            await asyncio.sleep(0)
            until = monotonic() + PART
        try:
            model = told(item)
        except UNKNOWN:
            continue
        if model is not None:
            written.append(_written(model, included))
    written += [_written(model, included) for model in rest]
    return Response(b"[" + b",".join(written) + b"]", media_type=JSON)


def _written(model: BaseModel, members: set[str] | None) -> bytes:
    return model.model_dump_json(by_alias=True, include=members).encode()
