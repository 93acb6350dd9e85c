"""The declarations of user-written processes, and their registry
([DyKnow10 Def. 5.9, 5.10, 5.15, 5.16, 5.28]).

A registry is a knowledge process specification K_C: it maps the names that KPL declares to
functions. The decorators `computational_unit`, `source` and `sink` fill `PROCESSES`; an engine gets
a registry. This module runs no user-written code.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias, TypeVar, cast

from ...streams.time import parse_duration
from ..model.errors import AlreadyExists, BadArguments, UnknownFeature
from .parameters import bind_parameters, defaults_of
from .supervision import ErrorRule, OnError

Code: TypeAlias = Callable[..., Any]
"""A function, or a class with callable instances, one for each process."""
C = TypeVar("C", bound=Code)
Kind = TypeVar("Kind", bound="Implementation")
ErrorText: TypeAlias = Literal["restart", "skip", "stop"]

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


@dataclass(frozen=True, slots=True)
class Implementation:
    """The declarations of every process. Value sorts are KPL names, as text."""

    name: str
    code: Code
    rule: ErrorRule

    @property
    def parameters(self) -> Mapping[str, str | None]:
        """Each parameter of the code with its default as text; None: it has no default."""
        return defaults_of(self.code)

    def make(self, parameters: Mapping[str, str] | None = None) -> Callable[..., Any]:
        """Return the callable with its parameters: the function, or a new instance of the class.

        Raises `BadArguments` for wrong parameters.
        """
        code = bind_parameters(self.code, parameters or {})
        if isinstance(self.code, type):
            return cast("Callable[..., Any]", code())
        return code


@dataclass(frozen=True, slots=True)
class UnitImplementation(Implementation):
    """``compunit output name(inputs)`` (Def. 5.16).

    ``code(time, samples, state) -> (sample, state)``, or with ``batch``
    ``code(tuples, state) -> (samples, state)``; see docs/how-to/write-a-process.md.
    """

    output: str
    inputs: tuple[str, ...]
    batch: bool = False


@dataclass(frozen=True, slots=True)
class SourceImplementation(Implementation):
    """``source sort name`` (Def. 5.15), called every ``period`` ns: ``code(time) -> sample``."""

    sort: str
    period: int


@dataclass(frozen=True, slots=True)
class SinkImplementation(Implementation):
    """A process without output: ``code(sample)``, or with ``batch`` ``code(batch)``. With several
    inputs, the number of the input (from 0) is a second argument."""

    inputs: tuple[str, ...]
    batch: bool = False


AnyImplementation: TypeAlias = UnitImplementation | SourceImplementation | SinkImplementation


@dataclass(slots=True)
class Processes:
    """A registry. Names are distinct over all kinds, as KPL's symbols are (Def. 5.13)."""

    _by_name: dict[str, AnyImplementation] = field(default_factory=dict)

    def add(self, implementation: AnyImplementation) -> None:
        """Register a process; repeating it changes nothing. Raises `AlreadyExists` for another one
        of the same name."""
        name = implementation.name
        existing = self._by_name.setdefault(name, implementation)
        if existing != implementation:
            raise AlreadyExists(
                f"there is a process called {name!r} already, {_origin(existing)}; "
                f"this one is {_origin(implementation)}",
                f"give it another name: name='{name}2'",
            )

    def remove(self, name: str) -> None:
        """Remove a process; running ones go on. Raises `UnknownFeature`."""
        self._get(name)
        del self._by_name[name]

    def all(self) -> tuple[AnyImplementation, ...]:
        """Return all processes, in the order of registration."""
        return tuple(self._by_name.values())

    @property
    def units(self) -> Mapping[str, UnitImplementation]:
        """The computational units by name."""
        return self._of(UnitImplementation)

    @property
    def sources(self) -> Mapping[str, SourceImplementation]:
        """The sample-based sources by name."""
        return self._of(SourceImplementation)

    @property
    def sinks(self) -> Mapping[str, SinkImplementation]:
        """The sinks by name."""
        return self._of(SinkImplementation)

    def unit(self, name: str) -> UnitImplementation:
        """Return a computational unit by name. Raises `UnknownFeature`."""
        found = self._get(name)
        if not isinstance(found, UnitImplementation):
            raise UnknownFeature(f"{name!r} is not a computational unit", f"it is {_origin(found)}")
        return found

    def source(self, name: str) -> SourceImplementation:
        """Return a sample-based source by name. Raises `UnknownFeature`."""
        found = self._get(name)
        if not isinstance(found, SourceImplementation):
            raise UnknownFeature(f"{name!r} is not a source", f"it is {_origin(found)}")
        return found

    def sink(self, name: str) -> SinkImplementation:
        """Return a sink by name. Raises `UnknownFeature`."""
        found = self._get(name)
        if not isinstance(found, SinkImplementation):
            raise UnknownFeature(f"{name!r} is not a sink", f"it is {_origin(found)}")
        return found

    def __contains__(self, name: object) -> bool:
        return name in self._by_name

    def computational_unit(
        self,
        output: str,
        inputs: Sequence[str],
        *,
        name: str | None = None,
        batch: bool = False,
        on_error: ErrorText = "restart",
        restarts: int = 3,
        deadline: str | None = "2s",
    ) -> Callable[[C], C]:
        """Decorator: register a function or class as a computational unit, and return it unchanged.

        ``output`` and ``inputs`` are value sorts. ``on_error``, ``restarts`` and ``deadline`` are
        the rule for its failures; ``deadline=None``: no deadline. Raises `BadArguments` and
        `AlreadyExists`.
        """
        rule = _rule(on_error, restarts, deadline)
        _check_name(output, "a value sort")
        sorts = _sorts(inputs)

        def register(code: C) -> C:
            self.add(UnitImplementation(_name_of(code, name), code, rule, output, sorts, batch))
            return code

        return register

    def sampled(
        self,
        sort: str,
        period: str,
        *,
        name: str | None = None,
        on_error: ErrorText = "restart",
        restarts: int = 3,
        deadline: str | None = "2s",
    ) -> Callable[[C], C]:
        """Decorator: register a function of time as a source that is called every ``period``.

        Raises `BadArguments` and `AlreadyExists`.
        """
        rule = _rule(on_error, restarts, deadline)
        _check_name(sort, "a value sort")
        length = _duration(period, "period")

        def register(code: C) -> C:
            self.add(SourceImplementation(_name_of(code, name), code, rule, sort, length))
            return code

        return register

    def consumer(
        self,
        inputs: Sequence[str],
        *,
        name: str | None = None,
        batch: bool = False,
        on_error: ErrorText = "restart",
        restarts: int = 3,
        deadline: str | None = "2s",
    ) -> Callable[[C], C]:
        """Decorator: register a function that is called with each sample and returns nothing.

        Raises `BadArguments` and `AlreadyExists`.
        """
        rule = _rule(on_error, restarts, deadline)
        sorts = _sorts(inputs)

        def register(code: C) -> C:
            self.add(SinkImplementation(_name_of(code, name), code, rule, sorts, batch))
            return code

        return register

    def _of(self, kind: type[Kind]) -> Mapping[str, Kind]:
        return {name: each for name, each in self._by_name.items() if isinstance(each, kind)}

    def _get(self, name: str) -> AnyImplementation:
        found = self._by_name.get(name)
        if found is None:
            names = ", ".join(sorted(self._by_name)) or "none yet"
            raise UnknownFeature(
                f"there is no process called {name!r}",
                f"register it with a decorator and load its module; there are: {names}",
            )
        return found


PROCESSES = Processes()
"""The registry that the decorators fill."""

computational_unit = PROCESSES.computational_unit
source = PROCESSES.sampled
sink = PROCESSES.consumer


def _origin(implementation: AnyImplementation) -> str:
    code = implementation.code
    kind = {
        UnitImplementation: "a computational unit",
        SourceImplementation: "a source",
        SinkImplementation: "a sink",
    }[type(implementation)]
    return f"{kind}, {code.__module__}.{getattr(code, '__qualname__', type(code).__name__)}"


def _name_of(code: Code, name: str | None) -> str:
    """Return the name of a process. Raises `BadArguments` for code that cannot be called as one."""
    if not callable(code):
        raise BadArguments(f"a process is a function or a class, got {code!r}")
    called: Any = code
    if isinstance(code, type):
        if not any("__call__" in base.__dict__ for base in code.__mro__):
            raise BadArguments(
                f"the instances of class {code.__name__} cannot be called",
                "give the class a method __call__ with the arguments of the function form",
            )
        called = code.__dict__.get("__call__")
    if inspect.iscoroutinefunction(called) or inspect.isgeneratorfunction(called):
        raise BadArguments(
            f"{code!r} is asynchronous or a generator",
            "a process is an ordinary function, called once for each answer",
        )
    own = name if name is not None else getattr(code, "__name__", "")
    _check_name(own, "the name of a process")
    return own


def _check_name(text: object, what: str) -> None:
    if not isinstance(text, str) or _NAME.fullmatch(text) is None:
        raise BadArguments(
            f"{what} must be a name of KPL, not {text!r}",
            "use letters, digits and _, with a letter first",
        )


def _sorts(inputs: Sequence[str]) -> tuple[str, ...]:
    if isinstance(inputs, str) or not inputs:
        raise BadArguments(
            f"inputs must be a list of one or more value sorts, not {inputs!r}",
            'write inputs=["pos"]',
        )
    for sort in inputs:
        _check_name(sort, "a value sort")
    return tuple(inputs)


def _rule(on_error: str, restarts: int, deadline: str | None) -> ErrorRule:
    if on_error not in list(OnError):
        raise BadArguments(f"on_error must be one of {', '.join(OnError)}, not {on_error!r}")
    if isinstance(restarts, bool) or not isinstance(restarts, int) or restarts < 0:
        raise BadArguments(f"restarts must be a number, 0 or more, not {restarts!r}")
    length = None if deadline is None else _duration(deadline, "deadline")
    return ErrorRule(OnError(on_error), restarts, length)


def _duration(text: str, what: str) -> int:
    try:
        length = parse_duration(text)
    except (TypeError, ValueError) as error:
        raise BadArguments(f"{what}: {error}") from error
    if length <= 0:
        raise BadArguments(f"{what} must be more than 0, not {text!r}", "write 100ms")
    return length
