"""Continuous queries in C-SPARQL and RSP-QL, event templates ([Events14 §III-IV], SPEC §5)."""

from ...sparql.terms import term_text
from .ast import (
    Aggregation,
    ContinuousQuery,
    CountWindow,
    Dialect,
    EventRequest,
    Form,
    LandmarkWindow,
    StreamClause,
    StreamOperator,
    Template,
    TimeWindow,
    Window,
)
from .body import (
    bind,
    body_sparql,
    body_tree,
    body_with_rows,
    group_keys,
    with_streams,
)
from .functions import TIMESTAMP, VALID_TIME
from .parser import parse_query, parse_template, required_parameters
from .printer import format_query
from .requests import parse_argument, parse_event_request, request_of

__all__ = [
    "TIMESTAMP",
    "VALID_TIME",
    "Aggregation",
    "ContinuousQuery",
    "CountWindow",
    "Dialect",
    "EventRequest",
    "Form",
    "LandmarkWindow",
    "StreamClause",
    "StreamOperator",
    "Template",
    "TimeWindow",
    "Window",
    "bind",
    "body_sparql",
    "body_tree",
    "body_with_rows",
    "format_query",
    "group_keys",
    "parse_argument",
    "parse_event_request",
    "parse_query",
    "parse_template",
    "request_of",
    "required_parameters",
    "term_text",
    "with_streams",
]
