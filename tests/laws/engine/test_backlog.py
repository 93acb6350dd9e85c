"""A unit that is behind says what it would say had it never been, only later; and an engine that is
opened again closes the windows that it closed."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import pytest
from commanding import REFUSALS, life, state
from hypothesis import given, settings
from hypothesis import strategies as st
from stepping import Steps, caught_up

from dyknow.engine.durability.commands import ANYTIME, execute
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.engine import Engine
from dyknow.engine.units import windowed
from dyknow.journal.durability import Durability


@pytest.fixture(autouse=True, scope="module")
def parts():
    """Batches of a few samples are large."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(windowed, "_PART", 1)
        yield


def do(doer, command):
    """Why it was refused; None if it was not."""
    try:
        doer(command)
    except REFUSALS as error:
        return f"{type(error).__name__}: {error}"
    return None


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32), st.integers(5, 60))
def test_being_behind_changes_nothing_but_when(seed, length):
    pick = random.Random(seed)
    steps = Steps(pick)
    at_once, behind = Engine(epoch="e1"), Engine(epoch="e1", turns=steps)
    for i, command in enumerate(life(random.Random(seed), length)):
        if not isinstance(command, ANYTIME):
            caught_up(behind.work_backlog, behind.backlog, steps)
        told = do(lambda one: execute(at_once, one), command)
        assert do(lambda one: execute(behind, one), command) == told, (i, command)
        if pick.random() < 0.3:
            steps.allow()
            behind.work_backlog()
    caught_up(behind.work_backlog, behind.backlog, steps)
    found, expected = state(behind), state(at_once)
    for name, stream in expected["streams"].items():
        assert found["streams"][name] == stream, name
    for part, value in expected.items():
        assert found[part] == value, part


def opened(path, steps):
    return RecordedEngine(path, now=0, durability=Durability.WRITE, turns=steps)


def lived(path: Path, seed: int, length: int, cuts: set[int], most: float):
    """A life with windows that close at random moments, cut off after some commands. At each cut,
    what is opened again is what it was."""
    pick, chance = random.Random(seed), random.Random(seed + 1)
    steps = Steps(pick, most)
    recorded = opened(path, steps)
    recorded.engine.epoch = "e1"
    try:
        for i, command in enumerate(life(random.Random(seed), length)):
            if not isinstance(command, ANYTIME) and recorded.engine.backlog.is_mid_window:
                recorded.engine.backlog.finish_windows()
                recorded.work_backlog(begins=False)
            do(recorded.do, command)
            if pick.random() < 0.4:
                steps.allow()
                recorded.work_backlog()
            if i in cuts:
                if chance.random() < 0.5:
                    recorded.engine.backlog.finish_windows()
                    recorded.checkpoint().write()
                    if chance.random() < 0.5:
                        recorded.work_backlog()
                before = state(recorded.engine)
                recorded.log.commit()
                recorded._directory.close()
                recorded = opened(path, steps)
                assert recorded.recovery.notes == []
                recorded.engine.epoch = "e1"
                assert state(recorded.engine) == before
        caught_up(recorded.work_backlog, recorded.engine.backlog, steps)
        return state(recorded.engine)
    finally:
        recorded._directory.close()
        shutil.rmtree(path)


@settings(deadline=None, max_examples=25)
@given(
    st.integers(0, 2**32),
    st.integers(5, 60),
    st.sets(st.integers(0, 60), max_size=5),
    st.sampled_from((float("inf"), 3, 10)),
)
def test_wherever_it_is_cut_off_it_is_as_far_behind(tmp_path_factory, seed, length, cuts, most):
    lived(tmp_path_factory.mktemp("cut"), seed, length, cuts, most)
