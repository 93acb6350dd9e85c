"""Make a failing case small: take parts away while it fails."""

from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass, replace
from typing import Any

from differential_cases import Case
from differential_queries import (
    Aggregate,
    Call,
    Exists,
    Filter,
    Group,
    InWindow,
    Minus,
    Optional,
    Path,
    Select,
    Term,
    Union,
    parts_of,
)  # fmt: skip

EXPRESSIONS = (Term, Call, Exists, Aggregate)


def shrink(case: Case, fails: Callable[[Case], bool], tries: int = 600) -> Case:
    """A case from which no part can be taken, or the smallest that was found within the tries."""
    going = True
    while going and tries > 0:
        going = False
        for smaller in smaller_cases(case):
            tries -= 1
            if tries < 0:
                break
            if fails(smaller):
                case, going = smaller, True
                break
    return case


def smaller_cases(case: Case) -> Iterator[Case]:
    for name in ("elements", "static"):
        for part in without_some(getattr(case, name)):
            yield replace(case, **{name: part})
    for query in smaller(case.query):
        yield replace(case, query=query)
    for name, simple in (
        ("every", 0),
        ("origin", 0),
        ("bounds", "(]"),
        ("lateness", None),
        ("operator", "RSTREAM"),
        ("report", "non-empty"),
    ):
        if getattr(case, name) != simple:
            yield replace(case, **{name: simple})
    asked = {part.name for part in parts_of(case.query) if isinstance(part, InWindow)}
    for place, window in enumerate(case.windows):
        if len(case.windows) > 1 and window.name not in asked:
            rest = case.windows[:place] + case.windows[place + 1 :]
            streams = {window.stream for window in rest}
            kept = tuple(element for element in case.elements if element.stream in streams)
            yield replace(case, windows=rest, elements=kept)


def without_some(parts: tuple[Any, ...]) -> Iterator[tuple[Any, ...]]:
    size = len(parts) // 2
    while size:
        for start in range(0, len(parts), size):
            yield parts[:start] + parts[start + size :]
        size //= 2


def smaller(tree: Any) -> Iterator[Any]:
    """Trees of the same kind with one part less."""
    if isinstance(tree, Group):
        for place, element in enumerate(tree.elements):
            before, after = tree.elements[:place], tree.elements[place + 1 :]
            yield Group(before + after)
            for inner in groups_in(element):
                yield Group(before + inner.elements + after)
    if isinstance(tree, EXPRESSIONS):
        for field in fields(tree):
            value = getattr(tree, field.name)
            for part in value if isinstance(value, tuple) else (value,):
                if isinstance(part, EXPRESSIONS):
                    yield part
        if tree != Term("1"):
            yield Term("1")
    if isinstance(tree, Path):
        yield from tree.parts
    if isinstance(tree, Select) and tree.distinct:
        yield replace(tree, distinct=False)
    if isinstance(tree, tuple):
        for place, part in enumerate(tree):
            if is_dataclass(part) or isinstance(part, tuple):
                for less in smaller(part):
                    yield (*tree[:place], less, *tree[place + 1 :])
    elif is_dataclass(tree):
        for field in fields(tree):
            value = getattr(tree, field.name)
            if isinstance(tree, Select) and tree.classic and field.name == "items":
                continue  # an AGGREGATE clause has one aggregate
            if field.name in ("items", "keys", "having", "template", "rows") and len(value) > 0:
                for place in range(len(value)):
                    yield replace(tree, **{field.name: value[:place] + value[place + 1 :]})
            if is_dataclass(value) or isinstance(value, tuple):
                for less in smaller(value):
                    yield replace(tree, **{field.name: less})


def groups_in(element: Any) -> tuple[Group, ...]:
    match element:
        case Optional() | Minus() | InWindow():
            return (element.group,)
        case Union():
            return element.sides
        case Group():
            return (element,)
        case Filter(Exists() as exists):
            return (exists.group,)
        case Select():
            return (element.where,)
    return ()
