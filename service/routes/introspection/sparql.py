"""SPARQL 1.1 Protocol queries over the ontology and the live stream space.

The dataset of a query is the one that the request chooses (``default-graph-uri``,
``named-graph-uri``), else that of its FROM clauses, else all graphs and their merge. A parameter
``$name`` is a term for the variable of that name (`sparql/parameters`). The service checks a query
(no SERVICE, no updates, bounded size). Worker processes then evaluate it, a few at a time, with
limits of time, memory, rows and bytes (`service/workers`). Without a query the answer is the
Service Description.
"""

from __future__ import annotations

from typing import Annotated, Any, Final
from urllib.parse import parse_qsl

from fastapi import Query, Request, Response
from pyoxigraph import Literal, NamedNode

from ....languages.csparql.requests import parse_argument
from ....languages.errors import LanguageError
from ....ontology.errors import QueryRefused
from ....ontology.texts.query_guard import LONGEST_TEXT, read_query
from ....ontology.texts.turtle import ALL_PREFIXES
from ....sparql import ast
from ....sparql.parameters import with_terms
from ....sparql.printer import print_query
from ...admission.gate import client_key
from ...config.media_types import FORM, SPARQL_QUERY
from ...http.encodings.service_description import KINDS, PREFIXES, describe
from ...http.encodings.sparql_results import (
    BOOLEANS,
    GRAPHS,
    RESULTS,
    answer,
    graph_answer,
    result_too_large,
)
from ...http.negotiation import accepted, content_type, utf8
from ...http.problems import Problem, responses
from ...http.routers import resource_router
from ...runtime.context import Context, Service
from ...workers.messages import Failed, GraphNames, Refused, TooMuch, Truth, Written
from ...workers.route_calls import while_connected

router = resource_router("sparql")

EXAMPLE = """PREFIX dyknow-o: <http://www.dyknow.eu/ontology#>
SELECT ?name WHERE { ?stream a dyknow-o:Stream ; dyknow-o:hasName ?name }"""
_LONGEST_FORM: Final = 4 * LONGEST_TEXT
"""Bytes of a form: percent-encoding makes a query at most three times as long."""
_LONGEST_TERM: Final = 1024
"""Characters of a parameter, which a query may repeat some thousand times."""
_DEFAULT_GRAPHS: Final = "default-graph-uri"
_NAMED_GRAPHS: Final = "named-graph-uri"
_OF_OTHERS: Final = ("query", "format", "output", "results")
"""What the protocol and its clients send beside the parameters of a query."""
DefaultGraphs = Annotated[
    list[str] | None,
    Query(
        alias=_DEFAULT_GRAPHS,
        description="a graph of the default graph, instead of FROM; may be repeated",
    ),
]
NamedGraphs = Annotated[
    list[str] | None,
    Query(
        alias=_NAMED_GRAPHS,
        description="a graph that GRAPH reads, instead of FROM NAMED; may be repeated",
    ),
]
TEXT_SCHEMA = {"type": "string", "description": "SELECT, ASK, CONSTRUCT or DESCRIBE"}
GRAPHS_SCHEMA = {"type": "array", "items": {"type": "string"}}
BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            SPARQL_QUERY: {"schema": TEXT_SCHEMA, "example": EXAMPLE},
            FORM: {
                "schema": {
                    "type": "object",
                    "required": ["query"],
                    "properties": {
                        "query": TEXT_SCHEMA,
                        _DEFAULT_GRAPHS: GRAPHS_SCHEMA,
                        _NAMED_GRAPHS: GRAPHS_SCHEMA,
                    },
                }
            },
        },
    }
}
CONTENT: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "bindings or a boolean for SELECT and ASK, triples for the others",
        "content": {kind: {"schema": {}} for kind in (*RESULTS, *GRAPHS)},
    }
}


@router.get(
    "/sparql",
    response_class=Response,
    responses=CONTENT | responses(406, 422, 503),
    name="sparql_get",
)
async def query_by_get(
    request: Request,
    service: Context,
    query: Annotated[
        str | None, Query(description=TEXT_SCHEMA["description"], examples=[EXAMPLE])
    ] = None,
    default_graphs: DefaultGraphs = None,
    named_graphs: NamedGraphs = None,
) -> Response:
    """Answer a query. JSON, XML, CSV, TSV for SELECT; JSON, XML for ASK; Turtle, N-Triples,
    JSON-LD, RDF/XML, TriG, N-Quads for CONSTRUCT and DESCRIBE.

    A parameter ``$name`` is a term that stands for the variable ``?name``: ``$name="gps"``,
    ``$sort=dyknow:UAV``, ``$limit=100``. Without parameters the answer is the Service Description,
    in Turtle, N-Triples, JSON-LD or RDF/XML.
    """
    if not request.query_params:
        kind = accepted(request, KINDS)
        graphs = service.engine.ontology.named_graphs()
        return graph_answer(describe(_endpoint(request), graphs), kind, PREFIXES)
    return await _answer(service, request, list(request.query_params.multi_items()))


@router.post(
    "/sparql",
    response_class=Response,
    openapi_extra=BODY,
    responses=CONTENT | responses(406, 413, 415, 422, 503),
    name="sparql_post",
)
async def query_by_post(
    request: Request,
    service: Context,
    default_graphs: DefaultGraphs = None,
    named_graphs: NamedGraphs = None,
) -> Response:
    """Answer a query in the body or in a form; parameters ``$name`` as in the other route."""
    kind = content_type(request, (SPARQL_QUERY, FORM), is_required=True)
    parameters = list(request.query_params.multi_items())
    sent = await request.body()
    if kind == FORM and len(sent) > _LONGEST_FORM:
        raise Problem(
            413,
            "body too large",
            f"a form has at most {_LONGEST_FORM} bytes, and this one {len(sent)}",
            hint=f"send the query as {SPARQL_QUERY}: it may have {LONGEST_TEXT} bytes, unencoded",
        )
    body = utf8(sent)
    if kind == FORM:
        try:
            parameters += parse_qsl(body, keep_blank_values=True, max_num_fields=100)
        except ValueError as error:
            raise Problem(400, "bad form", str(error)) from error
    else:
        parameters.append(("query", body))
    return await _answer(service, request, parameters)


def _text(parameters: list[tuple[str, str]]) -> str:
    """Return the query among the protocol's parameters. Raises a `Problem` for those of updates."""
    for key, _ in parameters:
        if key in ("update", "using-graph-uri", "using-named-graph-uri"):
            raise Problem(
                400,
                "query refused",
                f"updates are not supported, and {key} belongs to them",
                hint="change ontology, templates and streams by their own routes",
            )
    texts = [value for key, value in parameters if key == "query"]
    if len(texts) != 1:
        raise Problem(
            400,
            "wrong arguments",
            f"a request has exactly one query, and this one has {len(texts)}",
            hint="GET /sparql?query=..., or POST it as application/sparql-query",
        )
    return texts[0]


def _dataset(parameters: list[tuple[str, str]]) -> GraphNames | None:
    """Return the dataset among the protocol's parameters, None if they choose none. Raises a
    `Problem`."""
    chosen: GraphNames = ([], [])
    for key, value in parameters:
        if key not in (_DEFAULT_GRAPHS, _NAMED_GRAPHS):
            continue
        try:
            NamedNode(value)
        except ValueError as error:
            raise Problem(
                400,
                "query refused",
                f"{key} is no absolute IRI: {value}",
                hint="GET /sparql without parameters lists the graphs",
            ) from error
        chosen[key == _NAMED_GRAPHS].append(value)
    return chosen if any(chosen) else None


def _terms(query: ast.Query, parameters: list[tuple[str, str]]) -> dict[str, NamedNode | Literal]:
    """Return the terms that the request gives to variables. Raises a `Problem`."""
    found: dict[str, NamedNode | Literal] = {}
    used = ast.variables_of(query)
    for key, value in parameters:
        if not key.startswith("$"):
            if key in used and key not in _OF_OTHERS:
                raise _wrong_parameter(
                    f"{key} is a variable of the query, and no parameter of the request",
                    f"write ${key}={value} to give it a term",
                )
            continue
        if len(value) > _LONGEST_TERM:
            raise _wrong_parameter(f"{key} has more than {_LONGEST_TERM} characters")
        try:
            term = parse_argument(value, ALL_PREFIXES)
        except LanguageError as error:
            raise _wrong_parameter(f"{key} is no term: {error.message}", error.hint) from error
        if not isinstance(term, NamedNode | Literal):
            raise _wrong_parameter(f"{key} is no IRI and no literal: {value}")
        if key[1:] in found:
            raise _wrong_parameter(f"{key} is given twice")
        found[key[1:]] = term
    return found


def _wrong_parameter(detail: str, hint: str = "") -> Problem:
    example = '$name="gps", $sort=dyknow:UAV, $limit=100'
    return Problem(400, "wrong arguments", detail, hint=hint or f"write for example {example}")


def _endpoint(request: Request) -> str:
    """Return the address of the endpoint: the base of a query's relative IRIs (RFC 3986 §5.1.3)."""
    return str(request.url.replace(query="", fragment=""))


async def _answer(
    service: Service, request: Request, parameters: list[tuple[str, str]]
) -> Response:
    text, dataset, base = _text(parameters), _dataset(parameters), _endpoint(request)
    query, stated = read_query(text, base)
    if terms := _terms(query, parameters):
        try:
            text = print_query(with_terms(query, terms))
        except ValueError as error:
            raise _wrong_parameter(str(error)) from error
        if dataset is None and stated is not None:
            # The text of a tree has no FROM clauses.
            default, named = stated
            dataset = [graph.value for graph in default], [graph.value for graph in named]
    offered = {ast.Form.SELECT: RESULTS, ast.Form.ASK: BOOLEANS}.get(query.form, GRAPHS)
    try:
        kind, not_acceptable = accepted(request, tuple(offered)), None
    except Problem as problem:
        # A syntax error in the query goes before an unacceptable format.
        kind, not_acceptable = "", problem
    service.engine.measure()
    queries, sender = service.isolation.queries, client_key(request)
    result = await while_connected(
        request, lambda: queries.answer(text, kind, sender, dataset=dataset, base=base)
    )
    match result:
        case Written(body):
            return answer(body, kind)
        case Truth() if not_acceptable is not None:
            raise not_acceptable
        case Refused():
            raise QueryRefused(result.message, result.line or 1, result.column or 1, result.hint)
        case Failed(message):
            raise Problem(400, "query failed", message)
        case TooMuch(what, limit):
            raise result_too_large(f"{limit} {what}")
    raise AssertionError(f"no answer to a query: {type(result).__name__}")
