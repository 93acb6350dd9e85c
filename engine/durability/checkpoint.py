"""The whole state of an engine as bytes, and an engine out of them
(docs/explanation/design/0007-the-journal.md).

An engine is a graph of objects; this is its pickle, with what pickle cannot do by itself: functions
within functions, compiled loops, stores, locks. It is for the very program that wrote it: who keeps
a checkpoint keeps `program` beside it, and reads none of another.
"""

from __future__ import annotations

import copyreg
import dataclasses
import hashlib
import importlib.util
import io
import marshal
import pickle
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import CellType, CodeType, FunctionType, MappingProxyType, ModuleType
from typing import Any, Final, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from pyoxigraph import Store

from ...continuous.columns.budget import UNLIMITED, Budget
from ...matching.gc_pause import gc_paused
from ...ontology.quad_store import quads_of, store_of
from ..engine import Engine
from ..processes.registry import Processes
from ..processes.supervision import Instance, Runner
from ..units.backlog import Turns
from ..units.work_time import Stopwatch
from .process_state import REMEMBERING, Unkept, kept_of

T = TypeVar("T")

_ROOT = Path(__file__).parents[2]
_DEEP = 100_000
"""Frames: units that read each other's streams are a chain of objects as long as their chain."""
_STACK = 512 << 20
_PICKLED = ("msgspec", "numba", "numpy", "pyoxigraph")
"""Packages whose objects are in a state, or whose versions decide what comes of it."""
_DATACLASS_STATE: Final = getattr(dataclasses, "_dataclass_getstate", None)
_COMPILED = type(importlib.import_module("numba").njit(lambda: None))


@dataclass(frozen=True, slots=True)
class Outside:
    """What an engine works with that is no part of its state: the program's own, made anew with
    each process."""

    processes: Processes
    runner: Runner
    stopwatch: Stopwatch | None = None
    budget: Budget = UNLIMITED
    turns: Turns | None = None

    def given(self) -> dict[str, Any]:
        """By the names of `Engine`'s arguments."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    def named(self) -> dict[str, object]:
        """All of it by the names under which a state speaks of it, user-written code included:
        where that is defined is no matter of the state."""
        found = {name: value for name, value in self.given().items() if value is not None}
        for each in self.processes.all():
            found[f"process {each.name}"] = each
            found[f"code of {each.name}"] = each.code
        return found


@dataclass(frozen=True, slots=True)
class State:
    """The bytes of a state, and what could not be written of it."""

    data: bytes
    unkept: tuple[Unkept, ...]


class CheckpointError(Exception):
    """The state cannot be written, or not be read by this program."""


def program(processes: Processes | None = None) -> str:
    """What a checkpoint is for: this version of the program and of Python, by its very text, with
    these user-written processes, by the texts of their modules, and of what is loaded of the
    packages that these are in.

    Contract: called when the modules have been loaded, and soon: it reads their files.
    """
    known = () if processes is None else processes.all()
    if not known:
        return _program()
    digest = hashlib.sha256(repr(sorted(each.name for each in known)).encode())
    for name, text in sorted(_modules(each.code for each in known).items()):
        digest.update(f"\0{name}\0".encode() + text)
    return f"{_program()}, processes {digest.hexdigest()[:16]}"


def _modules(codes: Iterable[Any]) -> dict[str, bytes]:
    """The text of each module of user-written code, by its name; of code that has none, what it is
    compiled to."""
    found = {}
    for code in codes:
        package = code.__module__.partition(".")[0]
        for name, module in tuple(sys.modules.items()):
            if name.partition(".")[0] == package:
                path = getattr(module, "__file__", None)
                if path is not None and Path(path).is_file():
                    found[name] = Path(path).read_bytes()
        if code.__module__ not in found:
            compiled = getattr(code, "__code__", None)
            found[f"{code.__module__}.{code.__qualname__}"] = (
                b"" if compiled is None else marshal.dumps(compiled)
            )
    return found


@cache
def _program() -> str:
    digest = hashlib.sha256()
    for package in _PICKLED:
        digest.update(f"{package} {version(package)}\0".encode())
    for path in sorted(_ROOT.rglob("*.py")):
        place = path.relative_to(_ROOT)
        if (
            place.parts[0] not in ("tests", "bench", "docs", "examples")
            and ".venv" not in place.parts
        ):
            digest.update(str(place).encode() + b"\0" + path.read_bytes())
    python = ".".join(map(str, sys.version_info[:3]))
    return f"dyknow {version('dyknow')}, Python {python}, {digest.hexdigest()[:16]}"


def state_of(engine: Engine, more: object, outside: Outside) -> State:
    """The state of ``engine``, and ``more`` that belongs to it. What is ``outside``, with which the
    engine was made, stays there. What user-written processes remember and cannot be written is left
    out, and told.

    Raises `CheckpointError` where something else cannot be written.
    """
    names = {id(value): name for name, value in outside.named().items()}
    try:
        try:
            return _written((engine, more), names, None)
        except Exception:  # noqa: BLE001  user code may be in it, and raise anything
            # Whose fault it is is looked for only where there is one: that costs as much again.
            return _written((engine, more), names, [])
    except Exception as error:
        told = f"{type(error).__name__}: {error}"
        raise CheckpointError(f"the state cannot be written: {told}") from error


def _written(graph: object, names: dict[int, str], unkept: list[Unkept] | None) -> State:
    target = io.BytesIO()
    writer = _Writer(target, names, unkept)
    with gc_paused():
        _deep(lambda: writer.dump(graph))
    return State(target.getvalue(), tuple(unkept or ()))


def engine_of(state: bytes, outside: Outside) -> tuple[Engine, Any]:
    """The engine that had ``state``, and what came with it. Contract: this very program has written
    it; a pickle may do anything.

    Raises `CheckpointError` for what cannot be read.
    """
    try:
        with gc_paused():
            engine, more = _deep(lambda: _Reader(io.BytesIO(state), outside).load())
    except Exception as error:  # a pickle that is not whole may raise whatever it names
        raise CheckpointError(f"the state cannot be read: {error}") from error
    return engine, more


class _Writer(pickle.Pickler):
    """``unkept``: what of user-written processes cannot be written is left out, and told there;
    None: that raises."""

    def __init__(
        self, target: io.BytesIO, outside: dict[int, str], unkept: list[Unkept] | None
    ) -> None:
        super().__init__(target, protocol=5)
        self._outside = outside
        self._unkept = unkept
        self._forgotten: set[int] = set()
        """Instances that are left out, by their ids: they are there as long as this is."""

    def reducer_override(self, value: Any) -> Any:
        # Not as a `persistent_id`, for which every number and text would be asked.
        name = self._outside.get(id(value))
        if name is not None:
            return _outside, (name,)
        if self._unkept is not None and isinstance(value, REMEMBERING):
            kept, unkept = kept_of(value, self._why_not)
            if unkept:
                self._unkept += unkept
                self._forgotten.add(id(kept.get("_instance")))
            return copyreg.__newobj__, (type(value),), kept  # type: ignore[attr-defined]
        if type(value) is Instance and id(value) in self._forgotten:
            return Instance, (value.make,)
        reduce = _REDUCERS.get(type(value))
        if reduce is not None:
            return reduce(value)
        names = _slots(type(value))
        if names is None:
            return NotImplemented
        # As dataclasses do it, which look up the names of the fields for each value.
        return copyreg.__newobj__, (type(value),), [getattr(value, name) for name in names]  # type: ignore[attr-defined]

    def _why_not(self, value: object) -> Exception | None:
        """Why ``value`` cannot be written; None: it can."""
        try:
            _Writer(io.BytesIO(), self._outside, None).dump(value)
        except Exception as error:  # noqa: BLE001  user code, and there is something to tell
            return error
        return None


class _Reader(pickle.Unpickler):
    def __init__(self, source: io.BytesIO, outside: Outside) -> None:
        super().__init__(source)
        self._outside: dict[str, object] = {**outside.given(), **outside.named()}

    def find_class(self, module: str, name: str) -> Any:
        if module == __name__ and name == _outside.__name__:
            return self._from_outside
        return super().find_class(module, name)

    def _from_outside(self, name: str) -> object:
        found = self._outside.get(name, self)
        if found is self:
            raise CheckpointError(f"there is no {name} any more")
        return found


def _outside(name: str) -> object:
    """What is outside of a state and has this ``name``: `_Reader` knows it, and calls another."""
    raise CheckpointError(f"{name} is outside")


def _slots(kind: type) -> tuple[str, ...] | None:
    """The fields of a frozen dataclass with slots, whose state they are; None of others."""
    if getattr(kind, "__getstate__", None) is not _DATACLASS_STATE:
        return None
    usual = ("__reduce__", "__reduce_ex__")
    if any(getattr(kind, name) is not getattr(object, name) for name in usual):
        return None
    if kind not in _SLOTS:
        _SLOTS[kind] = tuple(each.name for each in fields(kind))
    return _SLOTS[kind]


_SLOTS: Final[WeakKeyDictionary[type, tuple[str, ...]]] = WeakKeyDictionary()


def _reduce_function(value: FunctionType) -> Any:
    """A function within a function, or without a name: its place in the source, and its cells."""
    if "<" not in value.__qualname__:
        return NotImplemented
    code = value.__code__
    places = _codes(value.__module__)[code.co_qualname]
    cells = value.__closure__ or ()
    state = (value.__defaults__, value.__kwdefaults__, value.__dict__)
    made = (value.__module__, code.co_qualname, places.index(code), cells)
    return _function, made, state, None, None, _set_function


def _function(module: str, name: str, place: int, cells: tuple[CellType, ...]) -> FunctionType:
    code = _codes(module)[name][place]
    found = importlib.import_module(module)
    return FunctionType(code, vars(found), code.co_name, None, cells)


def _set_function(value: FunctionType, state: tuple[Any, Any, dict[str, Any]]) -> None:
    value.__defaults__, value.__kwdefaults__ = state[:2]
    value.__dict__.update(state[2])


@cache
def _codes(module: str) -> dict[str, list[CodeType]]:
    """The code of every function in a module, by its qualified name, in order of the source."""
    spec = importlib.util.find_spec(module)
    code = None if spec is None else spec.loader.get_code(module)  # type: ignore[union-attr]
    found: dict[str, list[CodeType]] = {}
    for each in () if code is None else _within(code):
        found.setdefault(each.co_qualname, []).append(each)
    return found


def _within(code: CodeType) -> Iterator[CodeType]:
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield constant
            yield from _within(constant)


def _reduce_cell(value: CellType) -> Any:
    # Filled when it is there already: a function may be within its own cell. In a tuple, since
    # None would mean that there is nothing to fill it with.
    try:
        return _cell, (), (value.cell_contents,), None, None, _set_cell
    except ValueError:
        return _cell, ()


def _cell() -> CellType:
    return CellType()


def _set_cell(value: CellType, contents: tuple[object]) -> None:
    (value.cell_contents,) = contents


def _reduce_compiled(value: Any) -> str:
    return str(value.py_func.__qualname__)


def _reduce_store(value: Store) -> Any:
    return store_of, (quads_of(value),)


def _reduce_array(value: np.ndarray[Any, Any]) -> Any:
    """A part of another array stays a part of it: who writes into the one writes into the other."""
    whole = value.base
    if type(whole) is not np.ndarray or not whole.flags.c_contiguous:
        return NotImplemented
    if not value.size or value.dtype.hasobject:
        return NotImplemented
    # Of a dimension of one the stride says nothing, and may be any.
    strides = tuple(
        stride if count > 1 else value.itemsize
        for stride, count in zip(value.strides, value.shape, strict=True)
    )
    start = value.__array_interface__["data"][0] - whole.__array_interface__["data"][0]
    return _part, (whole, start, value.shape, strides, value.dtype)


def _part(
    whole: np.ndarray[Any, Any],
    start: int,
    shape: tuple[int, ...],
    strides: tuple[int, ...],
    dtype: np.dtype[Any],
) -> np.ndarray[Any, Any]:
    return np.ndarray(shape, dtype, whole, start, strides)


def _reduce_mapping(value: MappingProxyType[Any, Any]) -> Any:
    return MappingProxyType, (dict(value),)


def _reduce_module(value: ModuleType) -> Any:
    return importlib.import_module, (value.__name__,)


_REDUCERS: dict[type, Callable[[Any], Any]] = {
    FunctionType: _reduce_function,
    CellType: _reduce_cell,
    _COMPILED: _reduce_compiled,
    Store: _reduce_store,
    MappingProxyType: _reduce_mapping,
    np.ndarray: _reduce_array,
    ModuleType: _reduce_module,
}


def _deep(work: Callable[[], T]) -> T:
    """``work`` with room for deep recursion, on a thread that ends with it."""
    found: list[T] = []
    failed: list[Exception] = []

    def run() -> None:
        try:
            found.append(work())
        except Exception as error:  # noqa: BLE001  raised again where it is waited for
            failed.append(error)

    limit, stack = sys.getrecursionlimit(), threading.stack_size(_STACK)
    sys.setrecursionlimit(max(limit, _DEEP))
    try:
        thread = threading.Thread(target=run, name="dyknow-checkpoint")
        thread.start()
        thread.join()
    finally:
        sys.setrecursionlimit(limit)
        threading.stack_size(stack)
    if failed:
        raise failed[0]
    return found[0]
