"""The known objects, and all that is known of one."""

from __future__ import annotations

import asyncio
from heapq import nsmallest
from typing import Annotated

from fastapi import Path, Query

from ....engine.catalog.known_objects import KnownValue, Sorts
from ....engine.catalog.name_resolution import checked_sort
from ....engine.model.errors import UnknownObject
from ...http.problems import responses
from ...http.routers import resource_router
from ...models import ListedObjectsModel, ObjectModel
from ...runtime.context import Context, Service

router = resource_router("objects")

STREAMS = 10
"""Streams that are searched for an object before other requests have their turn."""


@router.get("/objects", responses=responses(404, 422))
async def list_objects(
    service: Context,
    sort: Annotated[
        str | None, Query(description="only objects of this sort and the sorts below it")
    ] = None,
    after: Annotated[
        str | None, Query(description="begin after this IRI: the last one of the page before")
    ] = None,
    limit: Annotated[int, Query(ge=1, le=1000, description="objects of a page")] = 100,
) -> ListedObjectsModel:
    """List the objects that the ontology or kept samples of annotated streams name, by IRI. A
    stream of RDF has no annotation, so an object that only its statements name is not in the list.

    `more`: there are others after these. 404: the ontology has no such sort.
    """
    engine = service.engine
    wanted = None if sort is None else checked_sort(engine.ontology.vocabulary, sort)
    known = await _known(service)
    closed = {sorts: engine.objects.sorts_above(sorts) for sorts in set(known.values())}
    first = "" if after is None else after
    rest = (
        iri
        for iri, sorts in known.items()
        if iri > first and (wanted is None or wanted in closed[sorts])
    )
    page = nsmallest(limit + 1, rest)
    vocabulary = engine.ontology.vocabulary
    return ListedObjectsModel.of(
        {iri: closed[known[iri]] for iri in page[:limit]}, vocabulary, more=len(page) > limit
    )


async def _known(service: Service) -> dict[str, Sorts]:
    """All objects with the sorts that name them. Each page makes them anew, since they change with
    the samples. Cost: some 100 ms for 100,000 objects, in turns."""
    known: dict[str, Sorts] = {}
    for part in service.engine.objects.all():
        for iri, sorts in part.items():
            before = known.setdefault(iri, sorts)
            if not sorts <= before:
                known[iri] = before | sorts
        await asyncio.sleep(0)
    return known


@router.get("/objects/{name:path}", responses=responses(404))
async def read_object(
    name: Annotated[str, Path(description="the object's IRI, prefixed name, or id in samples")],
    service: Context,
) -> ObjectModel:
    """Return what is known of an object now: its sorts, and the newest value of each feature.

    A feature of several streams has a value of each, the newest first. Newest is the greatest valid
    time among the kept samples. Streams of RDF are not searched: they have no annotation. 404:
    neither the ontology nor a kept sample names the object.
    """
    engine = service.engine
    iri = engine.object_iri(name)
    sorts: Sorts = frozenset()
    values: list[KnownValue] = []
    is_known = False
    for number, found in enumerate(engine.objects.of(iri), 1):
        if found is not None:
            is_known = True
            sorts |= found[0]
            values += found[1]
        if number % STREAMS == 0:
            await asyncio.sleep(0)
    if not is_known:
        raise UnknownObject(f"nothing is known of an object <{iri}>")
    vocabulary = engine.ontology.vocabulary
    return ObjectModel.of(iri, engine.objects.sorts_above(sorts), values, vocabulary)
