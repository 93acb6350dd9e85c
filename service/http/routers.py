"""Routers of resources, whose routes an application takes as they are."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter

from .problems import responses


def resource_router(*tags: str, **options: Any) -> APIRouter:
    """Return a router with what all routes have in common; ``options``: those of `APIRouter`.

    An application takes its routes by `list.extend`. `FastAPI.include_router` would make each once
    more for each application, at the first request, which takes as long as hundreds of requests.
    """
    return APIRouter(
        tags=list(tags),
        # All errors are problem documents, so the schema omits FastAPI's default 422.
        responses=responses(400, 401, 403, 421, 429, 503),
        strict_content_type=False,
        **options,
    )
