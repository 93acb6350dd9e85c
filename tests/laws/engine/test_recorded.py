"""An engine with a data directory goes on as one that was never closed, wherever it was cut off."""

import os
import random
import shutil
import signal
import subprocess
import sys
from pathlib import Path

from commanding import REFUSALS, life, state
from hypothesis import given, settings
from hypothesis import strategies as st
from places import TESTS

from dyknow.engine.durability.commands import execute
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.engine import Engine
from dyknow.journal.durability import Durability

SUPPORT = TESTS / "support" / "engines"


def do(doer, command):
    """What came of it, told apart by its text."""
    try:
        return repr(doer(command))
    except REFUSALS as error:
        return f"{type(error).__name__}: {error}"


def opened(path):
    return RecordedEngine(path, now=0, durability=Durability.WRITE)


def cut_off(recorded):
    """The process is killed: what was committed is there, and nothing else of it."""
    recorded.log.commit()
    recorded._directory.close()


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32), st.integers(5, 60), st.sets(st.integers(0, 60), max_size=5))
def test_wherever_it_is_cut_off_it_goes_on(tmp_path_factory, seed, length, cuts):
    check(tmp_path_factory.mktemp("data"), seed, length, cuts)


def check(path: Path, seed: int, length: int, cuts: set[int]) -> None:
    commands = life(random.Random(seed), length)
    recorded = opened(path)
    whole = Engine(epoch=recorded.engine.epoch)
    pick = random.Random(seed)
    try:
        for i, command in enumerate(commands):
            told = do(recorded.do, command)
            assert told == do(lambda one: execute(whole, one), command), (i, command)
            if i in cuts:
                if pick.random() < 0.5:
                    recorded.checkpoint().write()
                cut_off(recorded)
                recorded = opened(path)
                assert recorded.recovery.is_continued, recorded.recovery.notes
                assert recorded.recovery.notes == []
        found, expected = state(recorded.engine), state(whole)
        for part, value in expected.items():
            assert found[part] == value, part
    finally:
        recorded._directory.close()
        shutil.rmtree(path)


def live(folder, seed, first, last, hashes):
    """A part of a life in a process of its own, with other hashes of texts; what it tells."""
    return subprocess.run(
        [sys.executable, SUPPORT / "living.py", folder, str(seed), str(first), str(last)],
        env={**os.environ, "PYTHONHASHSEED": str(hashes)},
        capture_output=True,
        check=False,
        text=True,
    )


def test_it_goes_on_in_other_processes_with_other_hashes(tmp_path):
    seed = 6
    whole = live("-", seed, 0, "end", 1)
    assert len(whole.stdout) > 20_000, whole.stderr
    parts = [(0, 25), (25, 50), (50, "end")]
    for hashes, (first, last) in enumerate(parts, 2):
        lived = live(str(tmp_path / "data"), seed, first, last, hashes)
        assert lived.returncode == -signal.SIGKILL, lived.stderr
    assert lived.stdout == whole.stdout
