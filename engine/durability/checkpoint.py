"""Pickle the state of an engine, and unpickle it (docs/explanation/design/0007-the-journal.md).

An engine is a graph of objects. This module adds the objects that pickle cannot handle: nested
functions, compiled loops, stores. Only the program that wrote a pickle may read it: a checkpoint
contains `program`, and recovery compares it first.
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
from itertools import chain
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
from .process_state import STATEFUL, Unkept, picklable_attributes

T = TypeVar("T")

_ROOT = Path(__file__).parents[2]
_PACKAGES: Final = (
    *("continuous", "converters", "engine", "journal", "languages", "matching", "ontology", "rdf"),
    *("reasoning", "service", "sparql", "streams", "templates"),
)
_MAX_FRAMES = 100_000
"""Frames of recursion: pickle recurses along chains of units that read each other's streams."""
_STACK = 512 << 20
_PICKLED = ("msgspec", "numba", "numpy", "pyoxigraph")
"""Packages whose objects are in a state, or whose versions affect results."""
_DATACLASS_STATE: Final = getattr(dataclasses, "_dataclass_getstate", None)
_COMPILED = type(importlib.import_module("numba").njit(lambda: None))


@dataclass(frozen=True, slots=True)
class Outside:
    """The objects that an engine uses and that are not part of its state: each operating-system
    process creates them anew."""

    processes: Processes
    runner: Runner
    stopwatch: Stopwatch | None = None
    budget: Budget = UNLIMITED
    turns: Turns | None = None

    def arguments(self) -> dict[str, Any]:
        """They as keyword arguments of `Engine`."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    def by_name(self) -> dict[str, object]:
        """They and user-written code, by the names that a pickle has for them. A pickle refers to
        user-written code by the name of its process, not by its module."""
        names = {name: value for name, value in self.arguments().items() if value is not None}
        for each in self.processes.all():
            names[f"process {each.name}"] = each
            names[f"code of {each.name}"] = each.code
        return names


@dataclass(frozen=True, slots=True)
class State:
    """The pickle of a state, and the process states that it lacks."""

    data: bytes
    unkept: tuple[Unkept, ...]


class CheckpointError(Exception):
    """The state cannot be pickled, or this program cannot unpickle it."""


def program(processes: Processes | None = None) -> str:
    """Identify the program that can read a checkpoint: version, Python, and digests of its source
    and of the modules of user-written processes, with the loaded modules of their packages.

    Contract: call it soon after the modules were loaded, since it reads their files.
    """
    loaded = () if processes is None else processes.all()
    if not loaded:
        return _program()
    digest = hashlib.sha256(repr(sorted(each.name for each in loaded)).encode())
    for name, text in sorted(_modules(each.code for each in loaded).items()):
        digest.update(f"\0{name}\0".encode() + text)
    return f"{_program()}, processes {digest.hexdigest()[:16]}"


def _modules(codes: Iterable[Any]) -> dict[str, bytes]:
    """The source of each module of user-written code, by name; the byte code where there is no
    source file."""
    sources = {}
    for code in codes:
        package = code.__module__.partition(".")[0]
        for name, module in tuple(sys.modules.items()):
            if name.partition(".")[0] == package:
                path = getattr(module, "__file__", None)
                if path is not None and Path(path).is_file():
                    sources[name] = Path(path).read_bytes()
        if code.__module__ not in sources:
            compiled = getattr(code, "__code__", None)
            sources[f"{code.__module__}.{code.__qualname__}"] = (
                b"" if compiled is None else marshal.dumps(compiled)
            )
    return sources


@cache
def _program() -> str:
    digest = hashlib.sha256()
    for package in _PICKLED:
        digest.update(f"{package} {version(package)}\0".encode())
    # Not all of the folder: in a checkout, people keep programs of their own beside the packages.
    modules = (sorted((_ROOT / package).rglob("*.py")) for package in _PACKAGES)
    for path in (_ROOT / "__init__.py", *chain.from_iterable(modules)):
        digest.update(str(path.relative_to(_ROOT)).encode() + b"\0" + path.read_bytes())
    python = ".".join(map(str, sys.version_info[:3]))
    return f"dyknow {version('dyknow')}, Python {python}, {digest.hexdigest()[:16]}"


def state_of(engine: Engine, more: object, outside: Outside) -> State:
    """Pickle ``engine`` together with ``more``. Objects in ``outside`` are pickled as their names.
    States of user-written processes that cannot be pickled are left out and reported in `State`.

    Raises `CheckpointError` where another object cannot be pickled.
    """
    names = {id(value): name for name, value in outside.by_name().items()}
    try:
        try:
            return _pickled((engine, more), names, None)
        except Exception:  # noqa: BLE001  user code may be in it, and raise anything
            # Testing each process state costs as much again, so it happens only after an error.
            return _pickled((engine, more), names, [])
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
        raise CheckpointError(f"the state cannot be written: {reason}") from error


def _pickled(graph: object, names: dict[int, str], unkept: list[Unkept] | None) -> State:
    target = io.BytesIO()
    writer = _Writer(target, names, unkept)
    with gc_paused():
        _run_deep(lambda: writer.dump(graph))
    return State(target.getvalue(), tuple(unkept or ()))


def engine_of(state: bytes, outside: Outside) -> tuple[Engine, Any]:
    """Unpickle an engine and the object that `state_of` got with it. Contract: this program wrote
    ``state``; unpickling executes code.

    Raises `CheckpointError`.
    """
    try:
        with gc_paused():
            engine, more = _run_deep(lambda: _Reader(io.BytesIO(state), outside).load())
    except Exception as error:  # a truncated pickle may raise any error
        raise CheckpointError(f"the state cannot be read: {error}") from error
    return engine, more


class _Writer(pickle.Pickler):
    """``unkept`` gets the process states that cannot be pickled; if it is None, they raise."""

    def __init__(
        self, target: io.BytesIO, outside: dict[int, str], unkept: list[Unkept] | None
    ) -> None:
        super().__init__(target, protocol=5)
        self._outside = outside
        self._unkept = unkept
        self._left_out: set[int] = set()
        """``id`` of the instances that are left out. They live longer than the pickler, so no id
        is used again."""

    def reducer_override(self, value: Any) -> Any:
        # Not `persistent_id`: pickle calls it for every number and text, too.
        name = self._outside.get(id(value))
        if name is not None:
            return _outside, (name,)
        if self._unkept is not None and isinstance(value, STATEFUL):
            kept, unkept = picklable_attributes(value, self._pickling_error)
            if unkept:
                self._unkept += unkept
                self._left_out.add(id(kept.get("_instance")))
            return copyreg.__newobj__, (type(value),), kept  # type: ignore[attr-defined]
        if type(value) is Instance and id(value) in self._left_out:
            return Instance, (value.make,)
        reduce = _REDUCERS.get(type(value))
        if reduce is not None:
            return reduce(value)
        names = _slots(type(value))
        if names is None:
            return NotImplemented
        # Same as the dataclass's own __getstate__, which looks up its fields for each value.
        return copyreg.__newobj__, (type(value),), [getattr(value, name) for name in names]  # type: ignore[attr-defined]

    def _pickling_error(self, value: object) -> Exception | None:
        """The error of pickling ``value``; None: there is none."""
        try:
            _Writer(io.BytesIO(), self._outside, None).dump(value)
        except Exception as error:  # noqa: BLE001  user code; the error is reported
            return error
        return None


class _Reader(pickle.Unpickler):
    def __init__(self, source: io.BytesIO, outside: Outside) -> None:
        super().__init__(source)
        self._outside: dict[str, object] = {**outside.arguments(), **outside.by_name()}

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
    """Stand for the object of `Outside` with this name; `_Reader.find_class` replaces this
    function."""
    raise CheckpointError(f"{name} is outside")


def _slots(kind: type) -> tuple[str, ...] | None:
    """The fields of a frozen dataclass with slots; None for other classes."""
    if getattr(kind, "__getstate__", None) is not _DATACLASS_STATE:
        return None
    # A class with a reduction of its own has to be pickled by that.
    usual = ("__reduce__", "__reduce_ex__")
    if any(getattr(kind, name) is not getattr(object, name) for name in usual):
        return None
    if kind not in _SLOTS:
        _SLOTS[kind] = tuple(each.name for each in fields(kind))
    return _SLOTS[kind]


_SLOTS: Final[WeakKeyDictionary[type, tuple[str, ...]]] = WeakKeyDictionary()


def _reduce_function(value: FunctionType) -> Any:
    """Reduce a nested function or lambda to its place in the source and its cells. Pickle handles
    the others by name."""
    if "<" not in value.__qualname__:
        return NotImplemented
    code = value.__code__
    places = _codes(value.__module__)[code.co_qualname]
    cells = value.__closure__ or ()
    state = (value.__defaults__, value.__kwdefaults__, value.__dict__)
    arguments = (value.__module__, code.co_qualname, places.index(code), cells)
    return _function, arguments, state, None, None, _set_function


def _function(module: str, name: str, place: int, cells: tuple[CellType, ...]) -> FunctionType:
    code = _codes(module)[name][place]
    found = importlib.import_module(module)
    return FunctionType(code, vars(found), code.co_name, None, cells)


def _set_function(value: FunctionType, state: tuple[Any, Any, dict[str, Any]]) -> None:
    value.__defaults__, value.__kwdefaults__ = state[:2]
    value.__dict__.update(state[2])


@cache
def _codes(module: str) -> dict[str, list[CodeType]]:
    """The code objects of a module's functions by qualified name, in order of the source."""
    # A nested function exists only after a call of its outer one, so its code comes from the
    # module's source.
    spec = importlib.util.find_spec(module)
    code = None if spec is None else spec.loader.get_code(module)  # type: ignore[union-attr]
    codes: dict[str, list[CodeType]] = {}
    for each in () if code is None else _within(code):
        codes.setdefault(each.co_qualname, []).append(each)
    return codes


def _within(code: CodeType) -> Iterator[CodeType]:
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield constant
            yield from _within(constant)


def _reduce_cell(value: CellType) -> Any:
    # The contents are set as state, after creation: a function may be in its own cell. They are in
    # a tuple, since pickle skips a state of None.
    try:
        return _cell, (), (value.cell_contents,), None, None, _set_cell
    except ValueError:
        return _cell, ()


def _cell() -> CellType:
    return CellType()


def _set_cell(value: CellType, contents: tuple[object]) -> None:
    (value.cell_contents,) = contents


def _reduce_compiled(value: Any) -> str:
    # Pickle takes a text as the name of a global of the object's module.
    return str(value.py_func.__qualname__)


def _reduce_store(value: Store) -> Any:
    return store_of, (quads_of(value),)


def _reduce_array(value: np.ndarray[Any, Any]) -> Any:
    """Reduce a view of an array to its base and offset, so that both still share their memory."""
    whole = value.base
    if type(whole) is not np.ndarray or not whole.flags.c_contiguous:
        return NotImplemented
    if not value.size or value.dtype.hasobject:
        return NotImplemented
    # numpy leaves the stride of a dimension of length 1 undefined.
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


def _run_deep(work: Callable[[], T]) -> T:
    """Run ``work`` on a thread with a large stack and a high recursion limit."""
    results: list[T] = []
    errors: list[Exception] = []

    def run() -> None:
        try:
            results.append(work())
        except Exception as error:  # noqa: BLE001  raised again in the calling thread
            errors.append(error)

    # Only a new thread can have a larger stack. Both limits are those of the process, so the old
    # ones come back afterwards.
    limit, stack = sys.getrecursionlimit(), threading.stack_size(_STACK)
    sys.setrecursionlimit(max(limit, _MAX_FRAMES))
    try:
        thread = threading.Thread(target=run, name="dyknow-checkpoint")
        thread.start()
        thread.join()
    finally:
        sys.setrecursionlimit(limit)
        threading.stack_size(stack)
    if errors:
        raise errors[0]
    return results[0]
