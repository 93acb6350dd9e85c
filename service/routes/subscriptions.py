"""Subscriptions to a stream under a policy ([DyKnow10 Def. 4.8])."""

from __future__ import annotations

from fastapi import APIRouter, Depends, Query, Request, Response

from ..context import Context
from ..models import SubscriptionIn, SubscriptionModel
from ..problems import responses
from .streams import EVENTS, follow, json_only

router = APIRouter(tags=["subscriptions"])


@router.post(
    "/subscriptions",
    status_code=201,
    dependencies=[Depends(json_only)],
    responses=responses(404, 413, 415, 422),
)
async def subscribe(
    wanted: SubscriptionIn, response: Response, service: Context
) -> SubscriptionModel:
    """Subscribe to a stream under a policy, from now on or from the start of what is kept.

    Equal subscriptions share one adapted stream. 400 with line and column for a policy that is
    none; 404 for an unknown stream.
    """
    view = service.engine.subscribe(wanted.stream, wanted.policy, wanted.unit, wanted.since)
    response.headers["Location"] = f"/subscriptions/{view.id}"
    return SubscriptionModel.of(view)


@router.get("/subscriptions")
async def list_subscriptions(service: Context) -> list[SubscriptionModel]:
    """The subscriptions that run."""
    return [SubscriptionModel.of(view) for view in service.engine.subscriptions()]


@router.get("/subscriptions/{id}", responses=responses(404))
async def read_subscription(id: str, service: Context) -> SubscriptionModel:
    """One subscription, with what became of the samples under its policy."""
    return SubscriptionModel.of(service.engine.subscription(id))


@router.delete("/subscriptions/{id}", status_code=204, responses=responses(404))
async def cancel_subscription(id: str, service: Context) -> Response:
    """Give a subscription up. Its stream goes with the last of those that share it."""
    service.engine.unsubscribe(id)
    service.feeds.review()
    return Response(status_code=204)


@router.get("/subscriptions/{id}/events", responses={**EVENTS, **responses(404, 406)})
async def follow_subscription(
    id: str,
    request: Request,
    service: Context,
    since: str | None = Query(None, description="`start` of what is kept, or the id of a sample"),
) -> Response:
    """The samples as server-sent events; see `/streams/{name}/events`."""
    return follow(service, request, service.engine.subscription(id).stream, since)
