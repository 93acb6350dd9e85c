"""The state of user-written processes, and the parts of it that cannot be pickled
(docs/how-to/write-a-process.md).

The state of a process is its instance, and the state that a call returns for the next call. If a
part cannot be pickled, a checkpoint leaves the state out and the process begins anew at the next
start. The reason names the part, so that the author of the process can repair it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeAlias

import msgspec

from ..units.join import FunctionProcess
from ..units.sampled_source import SampledSource
from ..units.sink import Sink
from ..units.user_transformation import TransformationUnit

PickleCheck: TypeAlias = Callable[[object], Exception | None]
"""Pickles a value and returns the error; None: there is none."""

STATEFUL = (FunctionProcess, TransformationUnit, SampledSource, Sink)
"""The classes that call user-written code and have its state."""
_COMPUTING = (FunctionProcess, TransformationUnit)
_INITIAL: dict[str, Callable[[Any], Any]] = {
    "_state": lambda _: None,
    "_states": lambda _: {},
    "_instances": lambda _: {},
}
"""Makes the initial value of each attribute with state."""
_MAX_DEPTH = 8
_MAX_ERROR = 300


class Unkept(msgspec.Struct, frozen=True):
    """The state of ``process`` (its name) cannot be pickled; ``reason`` names the part and the
    error. ``is_computing``: the process computes a stream, so its output after a restart differs.
    """

    process: str
    reason: str
    is_computing: bool

    def __str__(self) -> str:
        return f"{self.process}: {self.reason}"


def picklable_attributes(owner: Any, check: PickleCheck) -> tuple[dict[str, Any], list[Unkept]]:
    """Return the attributes of an instance of `STATEFUL` that can be pickled, and the reasons
    for leaving others out.

    If a part of the state cannot be pickled, all of it is left out: half a state is not one that
    the process has ever had. The caller leaves out the contents of ``_instance``, to which others
    refer too. Cost: pickles the state once more.
    """
    attributes: dict[str, Any] = dict(vars(owner))
    # Objects of one process usually fail for the same reason: report it once.
    reasons = dict.fromkeys(
        reason
        for name, value in _user_state(attributes)
        if (reason := _reason(name, value, check)) is not None
    )
    if reasons:
        attributes |= {
            name: _INITIAL[name](attributes[name]) for name in _INITIAL if name in attributes
        }
    computing = isinstance(owner, _COMPUTING)
    return attributes, [Unkept(owner.implementation.name, each, computing) for each in reasons]


def _user_state(attributes: Mapping[str, Any]) -> Iterator[tuple[str, object]]:
    """Yield the parts of the state with the names that user-written code has for them."""
    if "_state" in attributes:
        yield "the state", attributes["_state"]
    for state in attributes.get("_states", {}).values():
        yield "the state", state
    instances = [attributes["_instance"]] if "_instance" in attributes else []
    for instance in (*instances, *attributes.get("_instances", {}).values()):
        if instance.is_made:
            yield "self", instance.get()


def _reason(name: str, value: object, check: PickleCheck) -> str | None:
    error = check(value)
    if error is None:
        return None
    path, part, error = _culprit(name, value, error, check)
    text = " ".join(f"{type(error).__name__}: {error}".split())[:_MAX_ERROR]
    return (
        f"{path} is a {type(part).__name__} and cannot be pickled ({text}): leave it out in "
        "__getstate__, and create it again in __setstate__"
    )


def _culprit(
    path: str, value: object, error: Exception, check: PickleCheck
) -> tuple[str, object, Exception]:
    """Find the smallest part of ``value`` that cannot be pickled, at most `_MAX_DEPTH` levels
    down."""
    for _ in range(_MAX_DEPTH):
        for name, part in _parts(value):
            part_error = check(part)
            if part_error is not None:
                path, value, error = path + name, part, part_error
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
