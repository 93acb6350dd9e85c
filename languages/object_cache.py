"""A cache of values computed from an object, for as long as the object lives.

A cache of the last n values would keep the algebra of removed templates in memory, megabytes each.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import update_wrapper
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar

S = TypeVar("S")
P = ParamSpec("P")
T = TypeVar("T")


class ObjectCache(Generic[S, P, T]):
    """Decorates a function of an object, by identity, and of more comparable arguments. It caches
    the last result for each object.

    Contract: the object does not change, and the result does not refer to it. Cost of a cached
    result: a look-up.
    """

    def __init__(self, work: Callable[Concatenate[S, P], T]) -> None:
        self._work = work
        self._known: dict[int, tuple[weakref.ref[Any], tuple[Any, ...], T]] = {}
        update_wrapper(self, work)

    def __call__(self, subject: S, *more: P.args, **keywords: P.kwargs) -> T:
        assert not keywords, "pass the arguments by position"
        cached = self._known.get(id(subject))
        if cached is not None and cached[1] == more:
            return cached[2]
        found = self._work(subject, *more, **keywords)
        key = id(subject)
        reference = weakref.ref(subject, lambda _: self._known.pop(key, None))
        self._known[key] = reference, more, found
        return found

    def __len__(self) -> int:
        """Return the number of objects with a cached result."""
        return len(self._known)
