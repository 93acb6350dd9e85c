"""Subscriptions to a stream under a policy ([DyKnow10 Def. 4.8]), and to a feature of any streams
([Introspection15 §4.4])."""

from __future__ import annotations

from typing import Any

from fastapi import Depends, Request, Response

from ...engine.durability.accepted_commands import SUBSCRIPTION
from ...engine.durability.commands import (
    Subscribe,
    SubscribeToFeature,
    Unsubscribe,
)
from ...engine.engine import Engine
from ..config.media_types import EVENT_STREAM
from ..http.encodings.json_lists import listed
from ..http.problems import Problem, responses
from ..http.routers import resource_router
from ..models import RematchModel, SubscriptionIn, SubscriptionModel
from ..runtime.context import Context
from .follow import Parameters, follow
from .json_body import JsonRoute
from .streams import json_only

router = resource_router("subscriptions", route_class=JsonRoute)

FORM = 'send "stream" with a policy, or "feature" with "sort" or "objects"'
OF_A_FEATURE = {"sort", "objects", "strategy", "staleness", "min_quality", "hold_off"}
SUBSCRIPTION_EVENTS: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "server-sent events: sample, rematched, gap, end",
        "content": {EVENT_STREAM: {"schema": {"type": "string"}}},
    }
}


@router.post(
    "/subscriptions",
    status_code=201,
    dependencies=[Depends(json_only)],
    responses=responses(404, 410, 413, 415, 422),
)
async def subscribe(
    wanted: SubscriptionIn, response: Response, service: Context
) -> SubscriptionModel:
    """Subscribe to a stream or a feature, from now on or from the start of the history.

    Equal subscriptions to a stream share one adapted stream. A subscription to a feature has its
    own stream. Its sources change when one ends, falls silent or is not good enough; it waits while
    no stream gives the feature. 400 with line and column: a malformed policy; 404: an unknown
    stream, feature or sort.
    """
    view = await service.do(_command(wanted, service.engine))
    response.headers["Location"] = f"/subscriptions/{view.id}"
    return SubscriptionModel.of(view)


@router.get("/subscriptions", response_model=list[SubscriptionModel])
async def list_subscriptions(service: Context) -> Response:
    """List the running subscriptions, then the waiting ones of earlier runs (``state``)."""
    engine = service.engine
    deferred = service.commands.deferred_by_name(SUBSCRIPTION).values()
    waiting = [SubscriptionModel.waiting(each) for each in deferred]
    return await listed(
        engine.subscription_ids(), lambda id: SubscriptionModel.of(engine.subscription(id)), waiting
    )


@router.get("/subscriptions/{id}", responses=responses(404))
async def read_subscription(id: str, service: Context) -> SubscriptionModel:
    """Return one subscription, with the counters of its policy."""
    if (waiting := service.commands.deferred_by_name(SUBSCRIPTION).get(id)) is not None:
        return SubscriptionModel.waiting(waiting)
    return SubscriptionModel.of(service.engine.subscription(id))


@router.delete("/subscriptions/{id}", status_code=204, responses=responses(404))
async def cancel_subscription(id: str, service: Context) -> Response:
    """Cancel a subscription; clients that follow it get `end`.

    Its stream ends with the last subscription that shares it.
    """
    await service.do(Unsubscribe(id))
    service.feeds.review()
    return Response(status_code=204)


@router.get("/subscriptions/{id}/rematches", responses=responses(404))
async def list_rematches(id: str, service: Context) -> list[RematchModel]:
    """List the latest switches of a subscription to a feature, oldest first."""
    return [RematchModel.of(switch) for switch in service.engine.rematches(id)]


@router.get(
    "/subscriptions/{id}/events",
    responses={**SUBSCRIPTION_EVENTS, **responses(404, 406, 410, 429, 503)},
)
async def follow_subscription(
    id: str,
    request: Request,
    service: Context,
    parameters: Parameters,
) -> Response:
    """Send the samples as server-sent events; see `/streams/{name}/events`.

    A subscription to a feature also sends `rematched`, without an id, after sample `position` and
    before the next one. A client that resumes gets the switches since its last sample again.
    """
    view = service.engine.subscription(id)
    switches = None if view.adaptive is None else service.engine.rematches(id)
    delivery = parameters.delivery(service, [view.stream])
    return await follow(service, request, view.stream, delivery, switches)


def _command(wanted: SubscriptionIn, engine: Engine) -> Subscribe | SubscribeToFeature:
    """Return the command. Raises a 400 `Problem` unless exactly one of the two forms is there."""
    if (wanted.stream is None) == (wanted.feature is None):
        which = "neither" if wanted.stream is None else "both"
        detail = f"a subscription is to a stream or to a feature, and this body has {which}"
        raise Problem(400, "wrong arguments", detail, hint=FORM)
    if wanted.stream is not None:
        more = sorted(wanted.model_fields_set & OF_A_FEATURE)
        if more:
            detail = f"{', '.join(more)}: only with a feature"
            raise Problem(400, "wrong arguments", detail, hint=FORM)
        return Subscribe(wanted.stream, wanted.policy, wanted.unit, wanted.since, keyed=True)
    assert wanted.feature is not None
    return SubscribeToFeature(
        wanted.feature,
        sort=wanted.sort,
        objects=tuple(map(engine.object_name, wanted.objects)),
        strategy=wanted.strategy,
        policy=wanted.policy,
        unit=wanted.unit,
        since=wanted.since,
        staleness=wanted.staleness,
        quality=wanted.min_quality,
        hold_off=wanted.hold_off,
        keyed=True,
    )
