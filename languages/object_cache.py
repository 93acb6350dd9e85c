"""What was read off an object is remembered as long as that is there: a cache that counted would
hold the algebra of templates that are gone, megabytes each."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import update_wrapper
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar

S = TypeVar("S")
P = ParamSpec("P")
T = TypeVar("T")


class ObjectCache(Generic[S, P, T]):
    """A function of an object, by its identity, and of more that can be compared; it remembers for
    each object what it gave last.

    Contract: nobody changes the object, and what the function gives does not hold it. Cost of what
    is known: a look-up.
    """

    def __init__(self, work: Callable[Concatenate[S, P], T]) -> None:
        self._work = work
        self._known: dict[int, tuple[weakref.ref[Any], tuple[Any, ...], T]] = {}
        update_wrapper(self, work)

    def __call__(self, subject: S, *more: P.args, **named: P.kwargs) -> T:
        assert not named, "arguments are compared by their places"
        known = self._known.get(id(subject))
        if known is not None and known[1] == more:
            return known[2]
        found = self._work(subject, *more, **named)
        key = id(subject)
        gone = weakref.ref(subject, lambda _: self._known.pop(key, None))
        self._known[key] = gone, more, found
        return found

    def __len__(self) -> int:
        """Of how many objects something is remembered."""
        return len(self._known)
