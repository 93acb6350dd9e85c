"""What an object keeps, and where: to find what becomes more and more."""

from __future__ import annotations

import gc
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from functools import cache
from types import CodeType, FunctionType, ModuleType

ATOMS = frozenset({type(None), bool, int, float, str, bytes})
"""They lead to nothing. Most of what there is is one."""
PROGRAM = (type, ModuleType, FunctionType, CodeType)
_NAMES = 6
"""A place is told by so many names, from its end."""


def entries(root: object, *outside: type) -> Counter[str]:
    """How much dictionaries, sets and lists have that can be reached from ``root``, by where they
    are: attributes and keys on the way. Nothing is looked for in what is of a type ``outside``, nor
    in the program.

    What two ways lead to is counted once, and told by any of them. Other threads may go on: what
    they change meanwhile is told as before or after.
    """
    excluded = (*PROGRAM, *outside)
    seen: dict[int, object] = {}
    waiting: deque[tuple[object, tuple[str, ...]]] = deque([(root, ())])
    found: Counter[str] = Counter()
    while waiting:
        each, place = waiting.popleft()
        if id(each) in seen or isinstance(each, excluded):
            continue
        seen[id(each)] = each
        if isinstance(each, dict | list | set | frozenset | deque):
            found[".".join(place)] += len(each)
        waiting += [(one, (*place, name)[-_NAMES:]) for name, one in _parts(each)]
    return found


def _parts(each: object) -> Iterator[tuple[str, object]]:
    named: dict[int, str] = {}
    if isinstance(each, dict):
        # A copy, made at once: another thread may put something there.
        pairs = list(each.items())
        texts = [(key, value) for key, value in pairs if isinstance(key, str)]
        named = {id(value): key for key, value in texts if key.isidentifier()}
    else:
        named = {id(getattr(each, name, None)): name for name in _slots(type(each))}
    for one in gc.get_referents(each):
        if type(one) not in ATOMS:
            yield named.get(id(one), type(one).__name__), one


@cache
def _slots(kind: type) -> tuple[str, ...]:
    return tuple(name for each in kind.__mro__ for name in getattr(each, "__slots__", ()))


def grown(before: Sequence[Counter[str]], after: Sequence[Counter[str]]) -> int:
    """How many entries more there are ``after`` than ``before``, of several looks each. Of each
    kind the least counts: what goes on just now is in some looks, and what is forgotten in jumps
    rises and falls."""
    return _least(after) - _least(before)


def _least(looks: Sequence[Counter[str]]) -> int:
    return sum(min(look[kind] for look in looks) for kind in looks[0])


def growth(before: Counter[str], after: Counter[str]) -> list[tuple[str, int]]:
    """Where the most of what has come is."""
    return (after - before).most_common(10)
