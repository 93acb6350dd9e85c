"""RAND(), UUID() and STRUUID() in continuous queries, with reproducible values.

A window that is computed again after a restart must give the same result
(docs/reference/promises.md, P6). So the values of these functions are hashes of the query, the end
of the window, the call's place in the plan and the row. Oxigraph draws new values each time, so a
query that only Oxigraph can evaluate may not call them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from itertools import count
from typing import Final
from uuid import UUID

from pyoxigraph import Literal, NamedNode

from ...rdf.dictionary import Term
from ...rdf.namespaces import XSD
from ...sparql import ast
from .expressions import Call, Const, Expression
from .plan import Plan, expressions_of, walk, with_expressions, with_inputs

VOLATILE: Final = frozenset({"RAND", "UUID", "STRUUID"})
"""Functions with a new value per call."""
_DOUBLE: Final = NamedNode(XSD + "double")
_BITS: Final = 53
"""The bits of a double's fraction."""


def is_volatile(expression: Expression) -> bool:
    """Whether the expression has a new value each time it is evaluated."""
    if not isinstance(expression, Call):
        return False
    return expression.name in VOLATILE or any(map(is_volatile, expression.arguments))


def has_volatile(plan: Plan) -> bool:
    """Whether an expression in the plan is volatile."""
    return any(is_volatile(e) for node in walk(plan) for e in expressions_of(node))


def with_seeds(plan: Plan, seed: str) -> Plan:
    """Add an argument to each volatile call, its seed (see `draw_values`). It depends on ``seed``
    and the place in the plan."""
    places = count()

    def seeded(expression: Expression) -> Expression:
        if not isinstance(expression, Call):
            return expression
        if expression.name in VOLATILE:
            return Call(expression.name, (Const(Literal(f"{seed} {next(places)}")),))
        return Call(expression.name, tuple(map(seeded, expression.arguments)))

    def go(plan: Plan) -> Plan:
        return with_expressions(with_inputs(plan, go), seeded)

    return go(plan)


def draw_values(call: Call, rows: int) -> Iterator[Term]:
    """Yield the values of a seeded call, row by row. Cost: a hash per row."""
    (seed,) = call.arguments
    assert isinstance(seed, Const)
    for row in range(rows):
        digest = hashlib.blake2b(f"{seed.term.value} {row}".encode(), digest_size=16).digest()
        if call.name == "RAND":
            fraction = int.from_bytes(digest[:8]) >> (64 - _BITS)
            yield Literal(repr(fraction / (1 << _BITS)), datatype=_DOUBLE)
            continue
        text = str(UUID(bytes=digest, version=4))
        yield NamedNode(f"urn:uuid:{text}") if call.name == "UUID" else Literal(text)


def calls_volatile(tree: ast.Query) -> bool:
    """Whether a query contains a volatile function."""
    return any(isinstance(node, ast.Call) and node.name in VOLATILE for node in ast.walk(tree))
