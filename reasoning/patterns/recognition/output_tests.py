"""Tests of the outputs of matches (`query.Test`), in columns."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, assert_never

import numpy as np
from numpy.typing import NDArray

from ..plans.plan import NO_VALUE
from ..plans.query import AllOf, AnyOf, OutputComparison, OutputTerm, Test

Flags = NDArray[np.bool_]


def hold(test: Test, outputs: Mapping[str, NDArray[Any]], count: int) -> Flags:
    """For which of ``count`` matches a test holds; shape ``(count,)``."""
    match test:
        case OutputComparison(left, operator, right):
            return _compared(values_of(left, outputs), operator, values_of(right, outputs))
        case AllOf(tests):
            found = np.ones(count, np.bool_)
            for each in tests:
                found &= hold(each, outputs, count)
            return found
        case AnyOf(tests):
            found = np.zeros(count, np.bool_)
            for each in tests:
                found |= hold(each, outputs, count)
            return found
        case _:
            assert_never(test)


def values_of(term: OutputTerm, outputs: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
    """The values of an output, or of a calculation, of each match; shape ``(count,)``."""
    if isinstance(term, str):
        return outputs[term]
    left, right = values_of(term.left, outputs), values_of(term.right, outputs)
    known = ~(_is_missing(left) | _is_missing(right))
    if term.operator in "+-" and left.dtype == right.dtype == np.int64:
        # A time or duration beyond 64 bits is no value.
        sign = 1.0 if term.operator == "+" else -1.0
        known &= np.abs(left.astype(np.float64) + sign * right) < 2.0**63
    with np.errstate(all="ignore"):
        match term.operator:
            case "+":
                found = left + right
            case "-":
                found = left - right
            case "*":
                found = left * right
            case _:
                found, known = left / right, known & (right != 0)
    return np.where(known, found, np.nan if found.dtype == np.float64 else NO_VALUE)


def _compared(left: NDArray[Any], operator: str, right: NDArray[Any]) -> Flags:
    known = ~(_is_missing(left) | _is_missing(right))
    match operator:
        case "<":
            found = left < right
        case "<=":
            found = left <= right
        case ">":
            found = left > right
        case ">=":
            found = left >= right
        case "=":
            found = left == right
        case _:
            found = left != right
    return np.asarray(found & known, np.bool_)


def _is_missing(values: NDArray[Any]) -> Flags:
    if values.dtype == np.float64:
        return np.asarray(np.isnan(values), np.bool_)
    return np.asarray(values == NO_VALUE, np.bool_)


def print_test(test: Test) -> str:
    """Return a test as text."""
    match test:
        case OutputComparison(left, operator, right):
            return f"{_printed(left)} {operator} {_printed(right)}"
        case AllOf(tests):
            return f"({' and '.join(map(print_test, tests))})"
        case AnyOf(tests):
            return f"({' or '.join(map(print_test, tests))})"
        case _:
            assert_never(test)


def _printed(term: OutputTerm) -> str:
    if isinstance(term, str):
        return term
    return f"({_printed(term.left)} {term.operator} {_printed(term.right)})"
