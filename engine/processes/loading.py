"""Loads user-written processes: modules by name or file, and installed entry points.

Importing a module is enough, since its decorators register processes. If the import fails, the
report has the error, and the processes that the module had registered are removed.
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
    """The result of loading a module or entry point; ``error`` None: it was loaded."""

    origin: str
    added: tuple[str, ...]
    error: str | None = None


def load_processes(
    modules: Sequence[str] = (),
    *,
    points: Iterable[EntryPoint] | None = None,
    registry: Processes = PROCESSES,
) -> list[LoadReport]:
    """Import the entry points ``points`` (None: the installed ones), then ``modules``: dotted
    names, or files that end in ``.py``. Return a report for each, in that order.

    ``registry`` is the one that the modules' decorators fill. Raises only errors that are no
    `Exception` (KeyboardInterrupt, SystemExit).
    """
    reports = []
    found = entry_points(group=GROUP) if points is None else points
    for point in sorted(found, key=lambda point: (point.name, point.value)):
        origin = f"entry point {point.name} = {point.value}"
        reports.append(_load(origin, point.load, registry))
    reports += [_load(module, partial(_import, module), registry) for module in modules]
    return reports


def _load(origin: str, load: Callable[[], object], registry: Processes) -> LoadReport:
    before = {each.name for each in registry.all()}
    error = None
    try:
        load()
    except Exception as failure:  # noqa: BLE001  user code: report it, and load the others
        error = describe(failure)
        for each in registry.all():
            # Python drops the failed module, but not the modules that it had imported before.
            if each.name not in before and each.code.__module__ not in sys.modules:
                registry.remove(each.name)
    added = tuple(each.name for each in registry.all() if each.name not in before)
    return LoadReport(origin, added, error)


def _import(module: str) -> None:
    if not module.endswith(".py"):
        importlib.import_module(module)
        return
    path = Path(module).resolve()
    name = path.stem
    existing = sys.modules.get(name)
    if existing is not None:
        if getattr(existing, "__file__", None) != str(path):
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
