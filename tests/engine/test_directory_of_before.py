"""Directories that a program before the rules of instants wrote give what they gave (P9).

tests/fixtures/before_instants.tar.xz holds them, with what the engine of then told of them
(tests/support/directory_of_before.py); it is never made anew.
"""

import json
import tarfile
from pathlib import Path

import pytest
from directory_of_before import told

from dyknow.engine.commands import Publish
from dyknow.engine.recorded import RecordedEngine
from dyknow.journal.log import Durability
from dyknow.streams.time import SECOND

ARCHIVE = Path(__file__).parents[1] / "fixtures" / "before_instants.tar.xz"


@pytest.fixture
def written(tmp_path):
    """The directories, and what was told of each."""
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(tmp_path, filter="data")
    return tmp_path, json.loads((tmp_path / "expected.json").read_text())


def opened(path):
    return RecordedEngine(path, now=15 * SECOND, durability=Durability.WRITE)


def plain(found):
    return json.loads(json.dumps(found))


@pytest.mark.parametrize("kind", ["log", "checkpoint"])
def test_streams_numbers_and_events_are_what_they_were(written, kind):
    folder, expected = written
    recorded = opened(folder / kind)
    found = plain(told(recorded))
    recorded.close(checkpoint=False)
    assert found["streams"].keys() == expected[kind]["streams"].keys()
    for name, stream in expected[kind]["streams"].items():
        assert found["streams"][name] == stream, name
    assert found == expected[kind]


def row(at, id, value):
    line = {"valid": at * SECOND, "available": at * SECOND, "id": id, "spd": value}
    return json.dumps(line)


@pytest.mark.parametrize("kind", ["log", "checkpoint"])
def test_what_comes_after_it_goes_by_the_rules_of_now(written, kind):
    """Of the last instant the directory knows one row: others are samples now."""
    folder, expected = written
    before = expected[kind]["streams"]["radar"]["counters"]
    recorded = opened(folder / kind)
    sweep = "\n".join([row(14, "uav1", 15.0), row(14, "uav2", 16.0), row(14, "uav2", 16.0)])
    recorded.do(Publish("radar", "ndjson", sweep.encode(), 16 * SECOND))
    found = plain(told(recorded))
    _, used, late, duplicate, *_ = found["streams"]["radar"]["counters"]
    assert (used, late, duplicate) == (before[1] + 1, before[2], before[3] + 2)
    recorded.log.commit()
    recorded._directory.close()  # killed: the next start repeats both kinds of commands
    again = opened(folder / kind)
    assert again.recovery.is_continued
    assert plain(told(again)) == found
    again.close()
