"""Prints EP-SPARQL queries. Law: ``parse_epsparql(format_epsparql(q)) == q``, up to spans."""

from __future__ import annotations

from collections.abc import Iterator
from typing import assert_never

from ...sparql.ast import Triples
from ...sparql.printer import Printer
from ...streams.time import format_duration
from .ast import Bind, EpSparqlQuery, Filter, Graph, Group, Operation, Part

_STEP = "  "


def format_epsparql(query: EpSparqlQuery) -> str:
    """Return the query as text, a line for each part."""
    printer = Printer(query.prefixes)
    lines = [f"PREFIX {prefix}: <{iri}>" for prefix, iri in query.prefixes.items()]
    if query.name:
        name = f"<{query.name}>" if ":" in query.name else query.name
        parameters = f"({', '.join(_parameters(query))})" if query.is_template else ""
        lines.append(f"REGISTER {query.kind} {name}{parameters} AS")
    lines.append(_head(query, printer))
    static, named = query.graphs
    lines += [f"FROM <{iri}>" for iri in static]
    lines += [f"FROM NAMED <{iri}>" for iri in named]
    lines += _group("WHERE ", query.where, "", printer)
    if query.within is not None:
        within = query.within
        lines.append(f"WITHIN {format_duration(within) if isinstance(within, int) else within}")
    if query.max_delay is not None:
        lines.append(f"WITH MAX DELAY {format_duration(query.max_delay)}")
    return "\n".join(lines) + "\n"


def _parameters(query: EpSparqlQuery) -> Iterator[str]:
    for parameter, default in zip(query.parameters, query.defaults, strict=True):
        yield f"{parameter}{f' = {default}' if default else ''}"


def _head(query: EpSparqlQuery, printer: Printer) -> str:
    if query.template is not None:
        return f"CONSTRUCT {{ {printer.triples(query.template)} }}"
    if query.form == "ASK":
        return "ASK"
    items = ["*"] if query.projection is None else map(printer.select_item, query.projection)
    return " ".join(["SELECT", *items])


def _group(before: str, group: Group, margin: str, printer: Printer) -> Iterator[str]:
    if not group.parts:
        yield f"{margin}{before}{{}}"
        return
    yield f"{margin}{before}{{"
    for part in group.parts:
        yield from _part(part, margin + _STEP, printer)
    yield f"{margin}}}"


def _part(part: Part, margin: str, printer: Printer) -> Iterator[str]:
    match part:
        case Triples(triples):
            yield from (f"{margin}{printer.triple(triple)} ." for triple in triples)
        case Filter(condition):
            yield f"{margin}FILTER {printer.in_brackets(condition)}"
        case Bind(expression, variable):
            yield f"{margin}BIND ({printer.expression(expression)} AS {variable})"
        case Graph(name, triples):
            yield f"{margin}GRAPH {printer.place(name)} {{ {printer.triples(triples)} }}"
        case Operation(operator, left, right):
            yield from _part(left, margin, printer)
            yield from _group(f"{operator} ", right, margin, printer)
        case Group():
            yield from _group("", part, margin, printer)
        case _:
            assert_never(part)
