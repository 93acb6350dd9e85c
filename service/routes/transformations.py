"""Transformations ([Introspection15 §3.1, Listing 3]): register, read, replace, remove."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from fastapi import Depends, Path, Request, Response

from ...engine.catalog.iri_annotations import DescribedTransformation
from ...engine.catalog.transformation_turtle import read_transformations
from ...engine.durability.commands import (
    ChangeTransformation,
    RegisterAnnotatedTransformation,
    RegisterTransformations,
    RemoveTransformation,
)
from ...engine.model.errors import UnknownTransformation
from ...languages.ssl import parse_ssl
from ..config.media_types import JSON, TURTLE
from ..http.encodings.json_lists import listed
from ..http.negotiation import content_type, json_value, utf8
from ..http.problems import Problem, responses
from ..http.routers import resource_router
from ..http.text_limits import check_number, read_ssl
from ..models import (
    TransformationIn,
    TransformationModel,
    WorthIn,
    schema_of,
    text_schema,
)
from ..runtime.context import Context, Service
from ..workers.route_calls import while_connected
from .json_body import JsonRoute
from .streams import json_only

router = resource_router("transformations", route_class=JsonRoute)

EXAMPLE = {
    "annotation": "compunit coordinatesToSpeed10s transforms latitude:latitude [deg], "
    "longitude:longitude [deg] to speed:speed [m.s-1]",
    "implementation": "coordinatesToSpeed",
    "parameters": {"baseline": "10s"},
    "cost": 2,
    "quality": 0.9,
}
LISTING = """@prefix : <http://www.dyknow.eu/ontology#> .
@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
:coordinatesToSpeed10s a :Transformation ;
    :hasAnnotation [
        :hasInputAnnotation [ :describesFeature dyknow:latitude ;
            :nextSegment [ :hasInputAnnotation [ :describesFeature dyknow:longitude ] ] ] ;
        :hasOutputAnnotation [ :describesFeature dyknow:speed ; :hasUnit "m.s-1" ] ] ;
    :hasImplementation [ :hasName "coordinatesToSpeed" ] ;
    :hasParameter [ :hasName "baseline" ; :hasText "10s" ] ;
    :hasCost 2 ; :hasQuality 0.9 ."""
BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            JSON: {"schema": schema_of(TransformationIn), "example": EXAMPLE},
            TURTLE: text_schema("transformations in the form of Listing 3", LISTING),
        },
    }
}
FORM = 'send "annotation" with one compunit or source in SSL, or "name", "inputs" and "output"'
Name = Annotated[str, Path(max_length=200)]
Wanted = TransformationIn | Sequence[DescribedTransformation]


@router.post(
    "/transformations",
    status_code=201,
    openapi_extra=BODY,
    responses=responses(403, 404, 409, 413, 415, 422, 503),
)
async def register_transformations(
    request: Request, response: Response, service: Context
) -> TransformationModel | list[TransformationModel]:
    """Register a transformation in JSON, or one or several in Turtle, as a whole or not at all.

    Matching uses it at once. An equal registration changes nothing. 400 with line and column:
    malformed SSL or Turtle; 404: an unknown feature or implementation; 409: the name is taken, or
    the code has other inputs or another output. The response to Turtle is a list.
    """
    wanted = await _read(request, service)
    service.gate.quotas.check_transformations(_names(wanted))
    views = await service.do(_command(wanted))
    if len(views) == 1:
        response.headers["Location"] = f"/transformations/{views[0].name}"
    models = [TransformationModel.of(view) for view in views]
    return models[0] if isinstance(wanted, TransformationIn) else models


@router.get("/transformations", response_model=list[TransformationModel])
async def list_transformations(service: Context) -> Response:
    """List all transformations, in the order of registration."""
    return await listed(service.engine.transformations.views(), TransformationModel.of)


@router.get("/transformations/{name}", responses=responses(404))
async def read_transformation(name: Name, service: Context) -> TransformationModel:
    """Return one transformation; `lacks` is the reason why no unit can be made of it."""
    return TransformationModel.of(service.engine.transformations.view(name))


@router.put(
    "/transformations/{name}",
    openapi_extra=BODY,
    responses={
        201: {"model": TransformationModel},
        **responses(403, 404, 409, 413, 415, 422, 503),
    },
)
async def put_transformation(
    name: Name, request: Request, response: Response, service: Context
) -> TransformationModel:
    """Register the transformation of this name, or replace it. Running units stay as they are."""
    wanted = await _read(request, service)
    names = _names(wanted)
    if names != [name]:
        raise Problem(
            409,
            "conflict",
            f"the body describes {', '.join(names)}, but the address names {name}",
            hint="PUT one transformation to the address of its name",
        )
    is_new = not _is_known(service, name)
    (view,) = await service.do(_command(wanted, replace=True))
    if is_new:
        response.status_code = 201
        response.headers["Location"] = f"/transformations/{name}"
    return TransformationModel.of(view)


@router.patch(
    "/transformations/{name}",
    dependencies=[Depends(json_only)],
    responses=responses(404, 413, 415, 422),
)
async def change_transformation(
    name: Name, worth: WorthIn, service: Context
) -> TransformationModel:
    """Change the cost or quality of a transformation; readers of its units may switch."""
    command = ChangeTransformation(name, worth.cost, worth.quality)
    return TransformationModel.of(await service.do(command))


@router.delete("/transformations/{name}", status_code=204, responses=responses(404, 409))
async def remove_transformation(name: Name, service: Context) -> Response:
    """Remove a transformation. 409: a unit of it runs, or it is the system's."""
    await service.do(RemoveTransformation(name))
    return Response(status_code=204)


async def _read(request: Request, service: Service) -> Wanted:
    """Parse the body. Raises a 400 `Problem` for JSON of neither or both forms."""
    kind = content_type(request, (JSON, TURTLE))
    body = await request.body()
    if kind == TURTLE:
        text, documents = utf8(body), service.isolation.documents
        parsed = await while_connected(
            request, lambda: documents.run(lambda: read_transformations(text, documents))
        )
        check_number(parsed)
        return parsed
    wanted: TransformationIn = await json_value(body, TransformationIn)
    if wanted.annotation is not None:
        await read_ssl(wanted.annotation)
    described = (wanted.name, wanted.output) != (None, None) or bool(wanted.inputs)
    if described == (wanted.annotation is not None):
        forms = "both forms" if described else "neither form"
        raise Problem(400, "wrong arguments", f"the body has {forms}", hint=FORM)
    if described and (wanted.name is None or wanted.output is None):
        lacks = "name" if wanted.name is None else "output"
        raise Problem(400, "wrong arguments", f"the body has no {lacks}", hint=FORM)
    return wanted


def _command(
    wanted: Wanted, *, replace: bool = False
) -> RegisterTransformations | RegisterAnnotatedTransformation:
    if not isinstance(wanted, TransformationIn):
        return RegisterTransformations(tuple(wanted), replace)
    if wanted.annotation is None:
        return RegisterTransformations((wanted.described(),), replace)
    return RegisterAnnotatedTransformation(
        wanted.annotation,
        wanted.implementation,
        wanted.texts,
        wanted.cost,
        wanted.quality,
        replace,
    )


def _names(wanted: Wanted) -> list[str]:
    if not isinstance(wanted, TransformationIn):
        return [described.name for described in wanted]
    if wanted.annotation is None:
        return [wanted.name or ""]
    return [declaration.name for declaration in parse_ssl(wanted.annotation)]


def _is_known(service: Service, name: str) -> bool:
    try:
        service.engine.transformations.get(name)
    except UnknownTransformation:
        return False
    return True
