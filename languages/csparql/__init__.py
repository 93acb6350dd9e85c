"""Continuous queries in C-SPARQL and RSP-QL, event templates ([Events14 §III-IV], SPEC §5)."""

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
from .body import algebra, bind, body_sparql, group_keys, nested_parameters, with_streams
from .functions import TIMESTAMP, VALID_TIME
from .parser import parse_query, parse_template, required_parameters
from .printer import format_query
from .requests import parse_argument, parse_event_request
from .terms import term_text

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
    "algebra",
    "bind",
    "body_sparql",
    "format_query",
    "group_keys",
    "nested_parameters",
    "parse_argument",
    "parse_event_request",
    "parse_query",
    "parse_template",
    "required_parameters",
    "term_text",
    "with_streams",
]
