"""When a checkpoint is due."""

from __future__ import annotations

from dyknow.service.config.settings import Settings
from dyknow.service.durability.checkpoint_policy import CheckpointTimes

SETTINGS = Settings(checkpoint_interval=300, checkpoint_bytes=1 << 20, checkpoint_work=4)


def test_time_bytes_or_work_make_one_due() -> None:
    times = CheckpointTimes()
    assert not times.is_due(0, 100, SETTINGS)
    assert not times.is_due(299, 100, SETTINGS)
    assert times.is_due(300, 100, SETTINGS)
    times.taken(100)
    times.kept(0.1)
    assert not times.is_due(301, 100, SETTINGS)
    assert not times.is_due(601, 100, SETTINGS), "nothing has come since"
    assert times.is_due(602, 101, SETTINGS)
    times.taken(101)
    times.kept(0.1)
    assert times.is_due(603, 101 + (1 << 20), SETTINGS)
    times.taken(101 + (1 << 20))
    times.kept(0.1)
    times.worked = 4.0
    assert times.is_due(604, 101 + (1 << 20), SETTINGS)
    times.taken(101 + (1 << 20))
    assert not times.is_due(605, 101 + (1 << 20), SETTINGS), "work counts from the last one"


def test_one_that_takes_long_is_rarer() -> None:
    times = CheckpointTimes()
    times.taken(0)
    times.kept(1.0)
    times.worked = 4.0
    assert not times.is_due(1, 1, SETTINGS)
    times.worked = 20.0
    assert times.is_due(2, 1, SETTINGS)


def test_one_that_failed_is_not_tried_at_once() -> None:
    times = CheckpointTimes()
    times.worked = 4.0
    assert times.is_due(1, 1, SETTINGS)
    times.failed(1)
    assert not times.is_due(10.9, 1, SETTINGS)
    assert times.is_due(11, 1, SETTINGS)


def test_one_that_was_taken_and_could_not_be_kept_spares_no_work() -> None:
    times = CheckpointTimes()
    times.worked = 4.0
    assert times.is_due(1, 1, SETTINGS)
    times.taken(1)
    times.worked = 1.0
    times.failed(2)
    assert times.worked == 5.0
    assert times.is_due(12, 1, SETTINGS)
    times.taken(1)
    times.kept(0.1)
    times.failed(13)
    assert times.worked == 0.0


def test_what_comes_while_one_is_written_is_not_in_it() -> None:
    times = CheckpointTimes()
    assert not times.is_due(0, 100, SETTINGS)
    assert times.is_due(300, 100, SETTINGS)
    times.taken(100)
    times.kept(20.0)
    assert times.is_due(600, 150, SETTINGS), "50 bytes came in these 20 s"
    times.taken(150)
    times.kept(20.0)
    assert times.is_due(601, 150 + (1 << 20), SETTINGS)
