"""Write docs/reference/http.md from the OpenAPI schema and the examples in docs/http_examples.sh.

    .venv/bin/python docs/http_reference.py

tests/service/test_http_reference.py fails while the page is not current, and runs its examples.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.config.settings import Settings

HERE = Path(__file__).parent
PAGE = HERE / "reference" / "http.md"
EXAMPLES = HERE / "http_examples.sh"
SHARED = ("400", "401", "403", "421", "429", "503")
"""Statuses that every route may answer."""
NOT_IN_SCHEMA = {
    ("GET", "/openapi.json"): "the OpenAPI schema, from which this page is made",
    ("GET", "/docs"): "the routes as a page to try them; it loads nothing from elsewhere",
    ("GET", "/"): "the [console](../how-to/use-the-console.md); the list of routes for "
    "`Accept: application/json`",
}
SECTIONS: dict[str, tuple[str, tuple[str, ...], str]] = {
    "Sessions": (
        "session",
        (),
        "A session lets a page of the service use a token; see "
        "[access](access.md#browsers). Programs send `Authorization: Bearer <token>` instead.",
    ),
    "Streams and samples": (
        "streams",
        ("samples", "units", "graph"),
        "[Streams over HTTP](streams.md) explains batches, live samples, retention, history and "
        "server-sent events.",
    ),
    "Subscriptions": (
        "subscriptions",
        (),
        "[Streams over HTTP](streams.md#subscriptions) explains policies, "
        "[matching](../explanation/matching.md#adaptive-subscriptions) subscriptions to features.",
    ),
    "KPL": ("kpl", (), "The language and its behaviour over HTTP are in [KPL](kpl.md)."),
    "Specifications": (
        "specifications",
        (),
        "The XML format and its effects are in [specifications](specifications.md).",
    ),
    "Meaning": (
        "ontologies",
        ("objects", "annotations", "transformations", "matching", "explain", "sparql"),
        "See [ontology](ontology.md), [SSL](ssl.md) and [matching](../explanation/matching.md).",
    ),
    "Events on demand": (
        "templates",
        ("events",),
        "See [write an event template](../how-to/write-an-event-template.md) and "
        "[event requests](queries.md#event-requests).",
    ),
    "Queries": (
        "queries",
        (),
        "See [registered queries](queries.md#registered-queries) for streams, results and states.",
    ),
    "The service": (
        "status",
        ("health",),
        "See [metrics, logs and readiness](metrics.md).",
    ),
}
"""Title of a section: its tags, and where the rest is explained."""


def render() -> str:
    """The page, as the program of this checkout has it."""
    app = create_app(Engine(epoch="e1"), Settings(), lambda: 0)
    schema = app.openapi()
    routes = [
        (method.upper(), path, operation)
        for path, methods in schema["paths"].items()
        for method, operation in methods.items()
    ]
    examples = dict(re.findall(r"^## (.*)\n((?:(?!## ).*\n)+)", EXAMPLES.read_text(), re.MULTILINE))
    assert examples.keys() <= SECTIONS.keys() | {"Start"}, examples.keys()
    parts = [_head(schema, examples["Start"])]
    for title, (first, others, where) in SECTIONS.items():
        tags = (first, *others)
        here = [route for tag in tags for route in routes if tag in route[2]["tags"]]
        parts += [f"## {title}\n", f"{where}\n", *_table(here, title)]
        if title in examples:
            parts.append(f"```sh\n{examples[title].strip()}\n```\n")
        for route in here:
            parts += _details(*route)
    parts.append("## Models\n")
    for name, model in sorted(schema["components"]["schemas"].items()):
        parts += _model(name, model)
    return "\n".join(parts)


def _head(schema: dict[str, Any], start: str) -> str:
    statuses = ", ".join(SHARED[:-1])
    return f"""# HTTP routes

{_line(schema["info"]["description"])}
`/docs` of a running service shows the same routes and lets you try them.
[HTTP conventions](http-conventions.md) has the times, sizes, errors and statuses of all routes.

`docs/http_reference.py` writes this page from the OpenAPI schema. The commands run from top to
bottom on a service that was just started, in the folder of the repository. `3f2a91c0` stands for
the epoch of your service, which `GET /status` reports.

Each route needs the scope that its row names, once the service has [tokens](access.md).
Every route may also answer {statuses} and {SHARED[-1]}.

```sh
{start.strip()}
```
"""


def _table(routes: list[tuple[str, str, dict[str, Any]]], title: str) -> Iterator[str]:
    yield "| route | scope | does |\n|---|---|---|"
    for method, path, operation in routes:
        first = _line(operation["description"]).partition(". ")[0].removesuffix(".")
        yield f"| `{method} {path}` | {_scope(operation)} | {_cell(first)} |"
    if title == "The service":
        for (method, path), does in NOT_IN_SCHEMA.items():
            yield f"| `{method} {path}` | none | {does} |"
    yield ""


def _details(method: str, path: str, operation: dict[str, Any]) -> Iterator[str]:
    yield f"### {method} {path}\n"
    for paragraph in operation["description"].split("\n\n"):
        yield f"{_line(paragraph)}\n"
    given = operation.get("parameters", ())
    parameters = [one for one in given if one["in"] != "path" or _about(one)]
    if parameters:
        yield "| parameter | in | is |\n|---|---|---|"
        for one in parameters:
            about = _about(one)
            default = one["schema"].get("default")
            about += f" (default `{json.dumps(default)}`)" if default is not None else ""
            yield f"| `{one['name']}` | {one['in']} | {_cell(about.strip())} |"
        yield ""
    if "requestBody" in operation:
        yield "Body:\n"
        for kind, content in operation["requestBody"]["content"].items():
            yield f"- `{kind}`: {_type(content['schema'])}"
        yield ""
        for kind, content in operation["requestBody"]["content"].items():
            if "example" in content:
                yield _example(kind, content["example"])
    yield f"{_answers(operation['responses'])}\n"


def _answers(responses: dict[str, Any]) -> str:
    good, bad = [], []
    for status, response in sorted(responses.items()):
        content = response.get("content", {})
        if "application/problem+json" in content:
            bad += [status] if status not in SHARED else []
            continue
        said = response["description"]
        said = "" if said in ("Successful Response", "OK", "Created") else f" ({said})"
        kinds = ", ".join(f"`{kind}`" for kind in content if kind != "application/json")
        schema = content.get("application/json", {}).get("schema")
        types = [_type(schema)] if schema else ["`application/json`"] if schema == {} else []
        good.append(f"{status}{said} {', '.join([*types, kinds] if kinds else types)}".rstrip())
    return _line(f"Answers: {'; '.join(good)}.") + (f" Errors: {', '.join(bad)}." if bad else "")


def _model(name: str, model: dict[str, Any]) -> Iterator[str]:
    yield f"### {name}\n"
    for paragraph in model.get("description", "").split("\n\n"):
        yield f"{_line(paragraph)}\n"
    members = model.get("properties", {})
    if not members:
        return
    required = model.get("required", ())
    yield "| member | type | is |\n|---|---|---|"
    for member, schema in members.items():
        about = _about(schema)
        about += " (required)" if member in required and name.endswith("In") else ""
        yield f"| `{member}` | {_cell(_type(schema, short=True))} | {_cell(about.strip())} |"
    yield ""


def _type(schema: dict[str, Any], *, short: bool = False) -> str:
    """A type in words; a model is a link. ``short`` leaves its description out."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "anyOf" in schema:
        return " or ".join(dict.fromkeys(_type(one, short=short) for one in schema["anyOf"]))
    if not short and "description" in schema:
        return _line(schema["description"])
    if "enum" in schema:
        return " or ".join(f"`{value}`" for value in schema["enum"])
    if "const" in schema:
        return f"`{schema['const']}`"
    kind = schema.get("type", "any")
    if kind == "array":
        return f"list of {_type(schema.get('items', {}), short=short)}"
    if isinstance(kind, list):
        return " or ".join(kind)
    return str(kind)


def _example(kind: str, example: Any) -> str:
    language = {"application/json": "json", "text/turtle": "turtle"}.get(kind, "text")
    text = example if isinstance(example, str) else json.dumps(example, ensure_ascii=False)
    return f"```{language}\n{text.rstrip()}\n```\n"


def _scope(operation: dict[str, Any]) -> str:
    needed = [scope for one in operation.get("security", ()) for scope in one.get("token", ())]
    return ", ".join(f"`{scope}`" for scope in needed) or "none"


def _about(described: dict[str, Any]) -> str:
    return _line(described.get("description", ""))


def _line(text: str) -> str:
    return re.sub(r"\s+", " ", text.replace("``", "`")).strip()


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(render(), encoding="utf-8")
