"""RAND(), UUID() and STRUUID() of continuous queries: drawn, and the same when drawn again.

A window that is computed again, after a restart, has to give what it gave
(docs/reference/promises.md, P6). So what these functions give follows from the query, the end of
the window, the call's place in the plan and the row. Oxigraph draws anew each time: a query that
only it can evaluate has no chance.
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
"""Functions that have another value each time."""
_DOUBLE: Final = NamedNode(XSD + "double")
_BITS: Final = 53
"""Of a double's fraction."""


def is_volatile(expression: Expression) -> bool:
    """Whether the value is another one each time that it is asked for."""
    if not isinstance(expression, Call):
        return False
    return expression.name in VOLATILE or any(map(is_volatile, expression.arguments))


def has_chance(plan: Plan) -> bool:
    """Whether an expression in the plan is volatile."""
    return any(is_volatile(e) for node in walk(plan) for e in expressions_of(node))


def with_seeds(plan: Plan, seed: str) -> Plan:
    """``plan`` with an argument for each volatile call, by which it is drawn (`drawn`): of the same
    ``seed`` it is the same, and another one at each place of the plan."""
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


def drawn(call: Call, rows: int) -> Iterator[Term]:
    """What a call with a seed gives, row by row. Cost: a hash a row."""
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


def names_chance(tree: ast.Query) -> bool:
    """Whether a volatile function stands anywhere in a query."""
    return any(isinstance(node, ast.Call) and node.name in VOLATILE for node in ast.walk(tree))
