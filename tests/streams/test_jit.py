"""Compiled loops and numba's cache."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from dyknow.streams.jit import JIT

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
