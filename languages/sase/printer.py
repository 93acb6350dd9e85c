"""Prints SASE+ patterns. Law: ``parse_sase(format_sase(p)) == p``, up to spans."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from ...streams.time import format_duration
from ..mtl.printer import format_formula, format_slot
from . import ast

_SUM, _PRODUCT, _FACTOR = range(3)
_STRENGTHS: Final = {"+": _SUM, "-": _SUM, "*": _PRODUCT, "/": _PRODUCT, "%": _PRODUCT}


def format_sase(pattern: ast.Pattern) -> str:
    """Return the pattern as text, a line a clause. Law: `parse_sase` reads it back."""
    name = pattern.name if pattern.name.isidentifier() else f"<{pattern.name}>"
    head = f"REGISTER STREAM {name} AS\n" if pattern.name else ""
    return head + "\n".join(_clauses(pattern))


def format_sase_template(template: ast.PatternTemplate) -> str:
    """Return the template as text. Law: `parse_sase_template` reads it back."""
    slots = ", ".join(map(format_slot, template.slots))
    body = "\n".join(_clauses(template.pattern))
    return f"REGISTER TEMPLATE <{template.name}>({slots}) AS\n{body}"


def _clauses(pattern: ast.Pattern) -> Iterator[str]:
    if pattern.stream is not None:
        yield f"FROM {pattern.stream.text}"
    yield f"PATTERN SEQ({', '.join(map(_part, pattern.parts))})"
    if pattern.strategy or pattern.where:
        strategy = [pattern.strategy.value] if pattern.strategy else []
        conditions = [f"{{ {_conditions(pattern.where)} }}"] if pattern.where else []
        yield " ".join(["WHERE", *strategy, *conditions])
    if pattern.within is not None:
        within = pattern.within
        text = format_duration(within) if isinstance(within, int) else format_term(within)
        yield f"WITHIN {text}"
    if pattern.having:
        yield f"HAVING {_conditions(pattern.having)}"
    if pattern.items:
        yield f"RETURN {', '.join(map(_item, pattern.items))}"
    if pattern.limit is not None:
        yield f"LIMIT {pattern.limit}"
    if pattern.max_delay is not None:
        yield f"WITH MAX DELAY {format_duration(pattern.max_delay)}"


def _part(part: ast.Part) -> str:
    types = ", ".join(each.text for each in part.types)
    # A type with the name `not` is no keyword in a list.
    is_list = len(part.types) > 1 or types.lower() == "not"
    text = f"ANY({types})" if is_list else types
    repeated = f"{text}+ {part.name}[]" if part.is_kleene else f"{text} {part.name}"
    return f"~{repeated}" if part.is_negated else repeated


def _conditions(conditions: tuple[ast.Condition, ...]) -> str:
    return " and ".join(map(_condition, conditions))


def _condition(condition: ast.Condition) -> str:
    match condition:
        case ast.Equivalence(name, None):
            return f"[{name}]"
        case ast.Equivalence(name, value):
            assert value is not None
            return f"[{name} = {format_term(value)}]"
        case ast.Comparison(operator, left, right):
            return f"{format_term(left)} {operator} {format_term(right)}"


def _item(item: ast.Item) -> str:
    return format_term(item.term) + (f" AS {item.name}" if item.name else "")


def format_term(term: ast.Term, strength: int = _SUM) -> str:
    """Return a value as text, in parentheses if it binds less than ``strength``."""
    match term:
        case ast.Arithmetic(operator, left, right):
            own = _STRENGTHS[operator]
            text = f"{format_term(left, own)} {operator} {format_term(right, own + 1)}"
            return text if own >= strength else f"({text})"
        case ast.Negative(operand):
            return f"-{format_term(operand, _FACTOR)}"
        case ast.Attribute(part, index, name):
            return f"{part}{_index(part, index)}.{name}"
        case ast.Aggregate(function, part, index, name):
            return f"{function}({part}{_index(part, index)}{f'.{name}' if name else ''})"
        case ast.CountMatches():
            return "count(*)"
        case ast.Duration(value):
            return format_duration(value)
        case _:
            return format_formula(term)


def _index(part: str, index: ast.Index) -> str:
    return f"[{part}.LEN]" if index is ast.Index.LAST else index.value
