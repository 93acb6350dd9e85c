"""Oxigraph evaluates expressions that columns cannot, once per distinct combination of values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from pyoxigraph import BlankNode, Literal, NamedNode, Quad

from ...languages.csparql import term_text
from ...rdf.dictionary import Term
from ...rdf.timed import ObjectColumn
from ..algebra.expressions import INFIX, Call, Const, Expression, Var, postorder, variables
from ..algebra.volatile_functions import VOLATILE, draw_values
from .oxigraph_port import NO_QUADS, OxigraphPort, SparqlResult, Table
from .relation import Relation, TermValues, key_codes, term_column

_PREFIX: Final = {"!": "!", "NEGATE": "-"}
_VALUE: Final = "urn:dyknow:value:"


def ask(
    expression: Expression, columns: Mapping[str, ObjectColumn], rows: int, terms: TermValues
) -> ObjectColumn:
    """Return the value of ``expression`` for each of ``rows`` rows; null is error or unbound.

    Cost: Python and Oxigraph per distinct combination of values, and a text to parse per call.
    """
    expression, columns = _draw_values(expression, columns, rows, terms)
    if isinstance(expression, Var):
        return columns[expression.name]
    names = sorted(variables(expression))
    relation = Relation({name: columns[name] for name in names if name in columns}, rows)
    if not rows:
        return term_column([], terms.dictionary.transient_id)
    if relation.columns:
        keys = [[column] for column in relation.columns.values()]
        codes = key_codes(keys, terms.dictionary)[0]
        _, first, inverse = np.unique(codes, return_index=True, return_inverse=True)
        inverse = inverse.reshape(-1)
    else:
        first, inverse = np.zeros(1, np.int64), np.zeros(rows, np.int64)
    bound = [name for name in names if name in relation.columns]
    picked = {name: relation.columns[name].take(first) for name in bound}
    columns_of = [(column, column.present) for column in picked.values()]
    table = [
        [
            column.term_at(row, terms.dictionary) if present[row] else None
            for column, present in columns_of
        ]
        for row in terms.budget.paced(range(len(first)))
    ]
    with terms.budget.pauses.released(waits=True):
        answers = _answers(expression, bound, table, terms.budget.oxigraph)
    return term_column(answers, terms.dictionary.transient_id).take(inverse)


def _draw_values(
    expression: Expression, columns: Mapping[str, ObjectColumn], rows: int, terms: TermValues
) -> tuple[Expression, Mapping[str, ObjectColumn]]:
    """Replace each call of RAND() and the like by a variable; add its values to the columns."""
    with_values = dict(columns)

    def go(expression: Expression) -> Expression:
        if not isinstance(expression, Call):
            return expression
        if expression.name in VOLATILE:
            name, values = f"\0r{len(with_values)}", list(draw_values(expression, rows))
            with_values[name] = term_column(values, terms.dictionary.transient_id)
            return Var(name)
        return Call(expression.name, tuple(map(go, expression.arguments)))

    return go(expression), with_values


def _answers(
    expression: Expression,
    names: Sequence[str],
    table: Sequence[Sequence[Term | None]],
    oxigraph: OxigraphPort,
) -> list[Term | None]:
    places = {name: f"v{i}" for i, name in enumerate(names)}
    text = sparql_text(expression, places)
    calls = (one for one in postorder(expression) if isinstance(one, Call))
    base = next((found for call in calls if (found := call.name.rpartition(" ")[0])), "")
    if any(isinstance(term, BlankNode) for row in table for term in row):
        # A query text cannot contain a blank node: put the values into the store.
        return _from_store(base, text, list(places.values()), table, oxigraph)
    lines = (
        " ".join([str(number), *("UNDEF" if term is None else term_text(term) for term in row)])
        for number, row in enumerate(table)
    )
    heads = " ".join(["?row", *(f"?{place}" for place in places.values())])
    values = " ".join(f"({line})" for line in lines)
    query = f"{base} SELECT ?row ({text} AS ?answer) WHERE {{ VALUES ({heads}) {{ {values} }} }}"
    answers = _by_row(oxigraph.ask(query, NO_QUADS, ()))
    return [answers.get(Literal(number)) for number in range(len(table))]


def _from_store(
    base: str,
    text: str,
    places: Sequence[str],
    table: Sequence[Sequence[Term | None]],
    oxigraph: OxigraphPort,
) -> list[Term | None]:
    quads, row_of = [], NamedNode(f"{_VALUE}row")
    for number, row in enumerate(table):
        node = NamedNode(f"{_VALUE}{number}")
        quads.append(Quad(node, row_of, node))
        for place, term in zip(places, row, strict=True):
            if term is not None:
                quads.append(Quad(node, NamedNode(_VALUE + place), term))
    optional = " ".join(f"OPTIONAL {{ ?row <{_VALUE}{place}> ?{place} }}" for place in places)
    query = (
        f"{base} SELECT ?row ({text} AS ?answer) WHERE {{ ?row <{row_of.value}> ?row {optional} }}"
    )
    answers = _by_row(oxigraph.ask(query, NO_QUADS, quads))
    return [answers.get(NamedNode(f"{_VALUE}{number}")) for number in range(len(table))]


def _by_row(result: SparqlResult) -> dict[Term | None, Term | None]:
    assert isinstance(result, Table)
    row, answer = result.variables.index("row"), result.variables.index("answer")
    return {solution[row]: solution[answer] for solution in result.rows}


def sparql_text(expression: Expression, places: Mapping[str, str]) -> str:
    """Print the expression as SPARQL, variables under the names in ``places``, or as unbound."""
    match expression:
        case Var(name):
            return f"?{places.get(name, 'unbound')}"
        case Const(term):
            return term_text(term)
        case Call(name, (left, right)) if name in INFIX:
            return f"({sparql_text(left, places)} {name} {sparql_text(right, places)})"
        case Call(name, (argument,)) if name in _PREFIX:
            return f"({_PREFIX[name]}{sparql_text(argument, places)})"
        case Call(name, arguments):
            shown = ", ".join(sparql_text(argument, places) for argument in arguments)
            # The base of IRI() stands before the query.
            return f"{name.rpartition(' ')[2]}({shown})"
    raise AssertionError(expression)
