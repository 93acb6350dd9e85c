"""Prints specifications as XML text.

Law: ``parse_specification(format_specification(s)) == s``, up to spans.
"""

from __future__ import annotations

from typing import Final, TypeAlias, assert_never

from .ast import (
    Parameter,
    Removal,
    Specification,
    StreamReference,
    UnitSpecification,
)
from .decoding import is_character
from .markup import NAMESPACE

_Part: TypeAlias = UnitSpecification | StreamReference | Parameter | Removal
# XML turns tabs and line ends in attributes into spaces (XML 1.0 §3.3.3), so they become
# references.
_ESCAPES: Final = str.maketrans(
    {
        "&": "&amp;",
        "<": "&lt;",
        ">": "&gt;",
        '"': "&quot;",
        "\t": "&#9;",
        "\n": "&#10;",
        "\r": "&#13;",
    }
)


def format_specification(specification: Specification) -> str:
    """Return the specification as XML text in the form of Listing 1, without empty parts.

    Raises `ValueError` for a value with a character that XML does not allow, such as U+0000.
    """
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', "<spec:specification"]
    insertions = _section("insertions", specification.insertions)
    removals = _section("removals", specification.removals)
    namespace = f'  xmlns:spec="{NAMESPACE}"'
    if not insertions and not removals:
        return "\n".join([*lines, f"{namespace} />", ""])
    lines += [f"{namespace}>", *insertions, *removals, "</spec:specification>", ""]
    return "\n".join(lines)


def format_element(part: UnitSpecification | Removal) -> str:
    """Return a single `cu` with its contents and the namespace. Raises as
    `format_specification`."""
    first, *others = (line.removeprefix("    ") for line in _lines((part,)))
    declared = f'<spec:cu xmlns:spec="{NAMESPACE}"'
    return "\n".join([first.replace("<spec:cu", declared, 1), *others])


def _section(name: str, parts: tuple[UnitSpecification, ...] | tuple[Removal, ...]) -> list[str]:
    if not parts:
        return []
    return [f"  <spec:{name}>", *_lines(parts), f"  </spec:{name}>"]


def _lines(parts: tuple[_Part, ...]) -> list[str]:
    """Return the lines of each part and its contents. An explicit stack replaces recursion."""
    lines: list[str] = []
    rest: list[tuple[int, _Part | str]] = [(2, part) for part in reversed(parts)]
    while rest:
        depth, part = rest.pop()
        indent = "  " * depth
        if isinstance(part, str):
            lines.append(f"{indent}{part}")
            continue
        children: tuple[_Part, ...] = ()
        if isinstance(part, UnitSpecification):
            children = (*part.parameters, *part.inputs)
        if not children:
            lines.append(f"{indent}<{_tag(part)} />")
            continue
        lines.append(f"{indent}<{_tag(part)}>")
        rest.append((depth, "</spec:cu>"))
        rest += [(depth + 1, inner) for inner in reversed(children)]
    return lines


def _tag(part: _Part) -> str:
    match part:
        case UnitSpecification() | Removal():
            return f"spec:cu{_attribute('name', part.name)}{_attribute('type', part.type)}"
        case StreamReference():
            return f"spec:stream{_attribute('name', part.name)}"
        case Parameter():
            return f"spec:parameter{_attribute('name', part.name)}{_attribute('value', part.value)}"
        case _:
            assert_never(part)


def _attribute(name: str, value: str | None) -> str:
    if value is None:
        return ""
    if not is_character(value):
        raise ValueError(f"{name} {value!r} has a character that XML cannot hold")
    return f' {name}="{value.translate(_ESCAPES)}"'
