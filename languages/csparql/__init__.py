"""Continuous queries and event templates in C-SPARQL ([Events14 §III-IV], SPEC §5)."""

from .ast import (
    Aggregation,
    ContinuousQuery,
    EventRequest,
    Form,
    StreamClause,
    Template,
    TimeWindow,
)
from .body import algebra, bind, body_sparql, group_keys, nested_parameters, with_streams
from .parser import parse_query, parse_template, required_parameters
from .printer import format_query
from .requests import parse_argument, parse_event_request
from .terms import term_text

__all__ = [
    "Aggregation",
    "ContinuousQuery",
    "EventRequest",
    "Form",
    "StreamClause",
    "Template",
    "TimeWindow",
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
