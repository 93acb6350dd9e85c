"""The OpenAPI schema of the application, with problems, scopes and links."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic.json_schema import models_json_schema

from ..admission.scopes import scope_of_operation
from ..http import problems
from ..models import READ_BY_ROUTES

ASKING = ("/explain", "/match", "/session", "/sparql")
"""Paths whose POST changes nothing that the log keeps."""
MADE = {
    "/streams": "name",
    "/templates": "name",
    "/events": "id",
    "/queries": "name",
    "/subscriptions": "id",
    "/transformations": "name",
}
"""The paths that create things, and the member of an answer, and of paths, that names one."""


def openapi_schema(app: FastAPI) -> dict[str, Any]:
    """The schema of ``app``, cached."""
    if app.openapi_schema is None:
        schema = get_openapi(
            title=app.title,
            version=app.version,
            description=app.description,
            routes=app.routes,
        )
        _say_models(schema.setdefault("components", {}))
        for path, operations in schema["paths"].items():
            for method, operation in operations.items():
                _say_refusals(method, path, operation)
        for path, key in MADE.items():
            _say_links(schema["paths"], path, key)
        app.openapi_schema = schema
    return app.openapi_schema


def _say_models(components: dict[str, Any]) -> None:
    """Replace FastAPI's models of errors by the one of problems, and add the models of bodies."""
    models = components.setdefault("schemas", {})
    for name in ("HTTPValidationError", "ValidationError"):
        models.pop(name, None)
    _, bodies = models_json_schema(
        [(model, "validation") for model in READ_BY_ROUTES],
        ref_template="#/components/schemas/{model}",
    )
    for name, body in bodies["$defs"].items():
        models.setdefault(name, body)
    models["ProblemModel"] = problems.ProblemModel.model_json_schema()
    components["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}


def _say_refusals(method: str, path: str, operation: dict[str, Any]) -> None:
    """Add the scope of an operation, and the problems of bodies, of the log and of values."""
    scope = scope_of_operation(method, path)
    operation["security"] = [] if scope is None else [{"token": [str(scope)]}]
    if "requestBody" in operation:
        for status in ("408", "415"):
            operation["responses"][status] = problems.responses(int(status))[int(status)]
    if method != "get" and path not in ASKING:
        operation["responses"] |= problems.written_responses()
    if "422" in operation["responses"]:
        operation["responses"]["422"] = problems.responses(422)[422]


def _say_links(paths: dict[str, Any], path: str, key: str) -> None:
    """Link the answers that create something to the operations on it."""
    own = f"{path}/{{{key}}}"
    users = [
        (name, operation)
        for name, operations in paths.items()
        if name == own or name.startswith(f"{own}/")
        for operation in operations.values()
    ]
    links = {
        operation["operationId"]: {
            "operationId": operation["operationId"],
            "parameters": {key: f"$response.body#/{key}"},
        }
        for _, operation in users
    }
    for maker in _makers(paths, path, own):
        for status in ("200", "201"):
            if status in maker["responses"]:
                maker["responses"][status]["links"] = links


def _makers(paths: dict[str, Any], path: str, own: str) -> Iterator[dict[str, Any]]:
    if "post" in paths[path]:
        yield paths[path]["post"]
    if "put" in paths.get(own, {}):
        yield paths[own]["put"]
