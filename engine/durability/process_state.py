"""What user-written processes remember, and which of it cannot be written down
(docs/how-to/write-a-process.md).

A process remembers by its instance, and by the state that it gives back for its next call. What of
that cannot be pickled is left out of a checkpoint: the process begins without it at the next start.
Who wrote the process is told which part of it that is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeAlias

import msgspec

from ..units.join import FunctionProcess
from ..units.sampled_source import SampledSource
from ..units.sink import Sink
from ..units.user_transformation import TransformationUnit

Why: TypeAlias = Callable[[object], Exception | None]
"""Why a value cannot be written; None: it can."""

REMEMBERING = (FunctionProcess, TransformationUnit, SampledSource, Sink)
"""What runs user-written code."""
_COMPUTING = (FunctionProcess, TransformationUnit)
_FORGOTTEN: dict[str, Callable[[Any], Any]] = {
    "_state": lambda _: None,
    "_states": lambda _: {},
    "_instances": lambda _: {},
}
"""Attributes, and what they are when all is forgotten."""
_DEPTH = 8
_LONGEST = 300


class Unkept(msgspec.Struct, frozen=True):
    """What ``process`` (its name) remembers cannot be written: ``reason`` says what of it, and why.
    ``is_computing``: what it makes is computed again at a start, and depends on it."""

    process: str
    reason: str
    is_computing: bool

    def __str__(self) -> str:
        return f"{self.process}: {self.reason}"


def kept_of(owner: Any, why: Why) -> tuple[dict[str, Any], list[Unkept]]:
    """The attributes of one of `REMEMBERING`, as far as they can be written; what is left out.

    One that cannot keep all that it remembers keeps nothing of it: of its ``_instance``, which
    others know, too, the caller leaves out what is made. Cost: all of that is written once more.
    """
    found: dict[str, Any] = dict(vars(owner))
    # Of each object the same is to be said: once is enough.
    reasons = dict.fromkeys(
        reason
        for name, value in _remembered(found)
        if (reason := _reason(name, value, why)) is not None
    )
    if reasons:
        found |= {name: _FORGOTTEN[name](found[name]) for name in _FORGOTTEN if name in found}
    computing = isinstance(owner, _COMPUTING)
    return found, [Unkept(owner.implementation.name, each, computing) for each in reasons]


def _remembered(attributes: Mapping[str, Any]) -> Iterator[tuple[str, object]]:
    """What user-written code remembers, as it calls it."""
    if "_state" in attributes:
        yield "the state", attributes["_state"]
    for state in attributes.get("_states", {}).values():
        yield "the state", state
    instances = [attributes["_instance"]] if "_instance" in attributes else []
    for instance in (*instances, *attributes.get("_instances", {}).values()):
        if instance.is_made:
            yield "self", instance.get()


def _reason(name: str, value: object, why: Why) -> str | None:
    error = why(value)
    if error is None:
        return None
    path, part, error = _culprit(name, value, error, why)
    text = " ".join(f"{type(error).__name__}: {error}".split())[:_LONGEST]
    return (
        f"{path} is a {type(part).__name__} and cannot be pickled ({text}): leave it out by "
        "__getstate__, and make it anew in __setstate__"
    )


def _culprit(path: str, value: object, error: Exception, why: Why) -> tuple[str, object, Exception]:
    """The smallest part of ``value`` that cannot be written, as far as it has known parts."""
    for _ in range(_DEPTH):
        for name, part in _parts(value):
            found = why(part)
            if found is not None:
                path, value, error = path + name, part, found
                break
        else:
            break
    return path, value, error


def _parts(value: object) -> Iterator[tuple[str, object]]:
    if isinstance(value, Mapping):
        yield from ((f"[{key!r}]", each) for key, each in value.items())
    elif isinstance(value, list | tuple):
        yield from ((f"[{i}]", each) for i, each in enumerate(value))
    else:
        yield from ((f".{name}", each) for name, each in getattr(value, "__dict__", {}).items())
