"""When a checkpoint is due."""

from __future__ import annotations

from dyknow.service.config.settings import Settings
from dyknow.service.durability.checkpoint_policy import CheckpointPolicy

SETTINGS = Settings(checkpoint_interval=300, checkpoint_bytes=1 << 20, checkpoint_work=4)


def test_time_bytes_or_work_make_one_due() -> None:
    policy = CheckpointPolicy()
    assert not policy.is_due(0, 100, SETTINGS)
    assert not policy.is_due(299, 100, SETTINGS)
    assert policy.is_due(300, 100, SETTINGS)
    policy.snapshot_taken(100)
    policy.checkpoint_written(0.1)
    assert not policy.is_due(301, 100, SETTINGS)
    assert not policy.is_due(601, 100, SETTINGS), "nothing has come since"
    assert policy.is_due(602, 101, SETTINGS)
    policy.snapshot_taken(101)
    policy.checkpoint_written(0.1)
    assert policy.is_due(603, 101 + (1 << 20), SETTINGS)
    policy.snapshot_taken(101 + (1 << 20))
    policy.checkpoint_written(0.1)
    policy.work_seconds = 4.0
    assert policy.is_due(604, 101 + (1 << 20), SETTINGS)
    policy.snapshot_taken(101 + (1 << 20))
    assert not policy.is_due(605, 101 + (1 << 20), SETTINGS), "work counts from the last one"


def test_one_that_takes_long_is_rarer() -> None:
    policy = CheckpointPolicy()
    policy.snapshot_taken(0)
    policy.checkpoint_written(1.0)
    policy.work_seconds = 4.0
    assert not policy.is_due(1, 1, SETTINGS)
    policy.work_seconds = 20.0
    assert policy.is_due(2, 1, SETTINGS)


def test_one_that_failed_is_not_tried_at_once() -> None:
    policy = CheckpointPolicy()
    policy.work_seconds = 4.0
    assert policy.is_due(1, 1, SETTINGS)
    policy.checkpoint_failed(1)
    assert not policy.is_due(10.9, 1, SETTINGS)
    assert policy.is_due(11, 1, SETTINGS)


def test_one_that_was_taken_and_could_not_be_kept_spares_no_work() -> None:
    policy = CheckpointPolicy()
    policy.work_seconds = 4.0
    assert policy.is_due(1, 1, SETTINGS)
    policy.snapshot_taken(1)
    policy.work_seconds = 1.0
    policy.checkpoint_failed(2)
    assert policy.work_seconds == 5.0
    assert policy.is_due(12, 1, SETTINGS)
    policy.snapshot_taken(1)
    policy.checkpoint_written(0.1)
    policy.checkpoint_failed(13)
    assert policy.work_seconds == 0.0


def test_what_comes_while_one_is_written_is_not_in_it() -> None:
    policy = CheckpointPolicy()
    assert not policy.is_due(0, 100, SETTINGS)
    assert policy.is_due(300, 100, SETTINGS)
    policy.snapshot_taken(100)
    policy.checkpoint_written(20.0)
    assert policy.is_due(600, 150, SETTINGS), "50 bytes came in these 20 s"
    policy.snapshot_taken(150)
    policy.checkpoint_written(20.0)
    assert policy.is_due(601, 150 + (1 << 20), SETTINGS)
