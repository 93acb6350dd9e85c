"""Compiled loops and numba's cache."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from dyknow.streams import jit
from dyknow.streams.jit import JIT, Kernel

LOOP = """
from numba import types
from dyknow.streams.jit import Kernel
from rooms.inner.part import FACTOR, part

def loop(x):
    return part(x) * FACTOR

run = Kernel(loop, lambda: types.int64(types.int64), calls=(part,))
print(run(1), run._compiled.stats.cache_hits.total())
"""


@pytest.mark.skipif(not JIT, reason="there are no compiled loops")
def test_a_loop_is_compiled_again_when_what_it_calls_has_changed(tmp_path: Path) -> None:
    """Its own module stays as it was."""
    folder = tmp_path / "rooms" / "inner"
    folder.mkdir(parents=True)
    (folder / "loop.py").write_text(LOOP)

    def told(part: str) -> str:
        (folder / "part.py").write_text(part)
        command = [sys.executable, "-c", "import rooms.inner.loop"]
        # Python takes a module compiled before for current if its size and second are the same.
        environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
        )
        return done.stdout.strip()

    first = "FACTOR = 1\ndef part(x):\n    return x + 1\n"
    assert told(first) == "2 0"
    assert told(first) == "2 1"
    assert told(first.replace("x + 1", "x + 2")) == "3 0"
    assert told(first.replace("FACTOR = 1", "FACTOR = 5")) == "10 0"


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> Kernel:
    from numba import types

    monkeypatch.setattr(jit, "_KERNELS", [])

    def successor(x: int) -> int:
        return x + 1

    return Kernel(successor, lambda: types.int64(types.int64))


@pytest.mark.skipif(not JIT, reason="there are no compiled loops")
def test_little_work_is_not_compiled_at_first(
    kernel: Kernel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jit, "PATIENCE", 1000.0)
    assert kernel.run(1, size=jit.FEW) == 2
    assert kernel._compiled is None
    monkeypatch.setattr(jit, "PATIENCE", 0.0)
    assert kernel.run(1, size=jit.FEW) == 2
    assert kernel._compiled is not None


@pytest.mark.skipif(not JIT, reason="there are no compiled loops")
def test_much_work_is_compiled(kernel: Kernel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jit, "PATIENCE", 1000.0)
    assert kernel.run(1, size=jit.FEW + 1) == 2
    assert kernel._compiled is not None


@pytest.mark.skipif(not JIT, reason="there are no compiled loops")
def test_long_compiling_is_told_once(kernel: Kernel, monkeypatch: pytest.MonkeyPatch) -> None:
    timers = []

    class Timer:
        def __init__(self, seconds: float, tell: Callable[[], None]) -> None:
            self.seconds, self.tell, self.daemon, self.is_over = seconds, tell, False, False
            timers.append(self)

        def start(self) -> None:
            self.tell()
            self.tell()

        def cancel(self) -> None:
            self.is_over = True

    told: list[str] = []
    monkeypatch.setattr(jit, "Timer", Timer)
    monkeypatch.setattr(jit, "_NOTICE", jit._Notice())
    jit.when_compiling(lambda: told.append("compiling"))
    kernel.compile()
    assert told == ["compiling"]
    assert [(each.seconds <= jit.NOTICEABLE, each.is_over) for each in timers] == [(True, True)]
