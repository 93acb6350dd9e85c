"""Finding user-written processes: modules by name or file, and installed entry points.

Importing is enough: the decorators register. What cannot be imported is reported, and what it
had registered before it failed is taken back.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from .registry import PROCESSES, Processes
from .supervision import describe

GROUP = "dyknow.processes"
"""The group of entry points; each names a module, or something in one."""


@dataclass(frozen=True, slots=True)
class LoadReport:
    """What came of one module or entry point; ``error`` None if it was loaded."""

    origin: str
    added: tuple[str, ...]
    error: str | None = None


def load_processes(
    modules: Sequence[str] = (),
    *,
    points: Iterable[EntryPoint] | None = None,
    registry: Processes = PROCESSES,
) -> list[LoadReport]:
    """Import entry points (None: those installed), then ``modules``: dotted names, or files that
    end in ``.py``. One report each, in that order.

    ``registry`` is the one that the modules' decorators fill. Only what is no `Exception` passes
    through (KeyboardInterrupt, SystemExit).
    """
    reports = []
    found = entry_points(group=GROUP) if points is None else points
    for point in sorted(found, key=lambda point: (point.name, point.value)):
        origin = f"entry point {point.name} = {point.value}"
        reports.append(_load(origin, point.load, registry))
    reports += [_load(module, partial(_import, module), registry) for module in modules]
    return reports


def _load(origin: str, load: Callable[[], object], registry: Processes) -> LoadReport:
    before = {known.name for known in registry.all()}
    error = None
    try:
        load()
    except Exception as failure:  # noqa: BLE001  user code, reported: the others are loaded still
        error = describe(failure)
        for known in registry.all():
            # A module that failed is not there any more; what it imported before may be.
            if known.name not in before and known.code.__module__ not in sys.modules:
                registry.remove(known.name)
    added = tuple(known.name for known in registry.all() if known.name not in before)
    return LoadReport(origin, added, error)


def _import(module: str) -> None:
    if not module.endswith(".py"):
        importlib.import_module(module)
        return
    path = Path(module).resolve()
    name = path.stem
    there = sys.modules.get(name)
    if there is not None:
        if getattr(there, "__file__", None) != str(path):
            raise ImportError(f"there is another module called {name!r}: rename the file")
        return
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    sys.modules[name] = loaded
    try:
        spec.loader.exec_module(loaded)
    except BaseException:
        del sys.modules[name]
        raise
