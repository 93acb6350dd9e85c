"""``dyknow check, repair, backup, restore, log``: looking into a data directory."""

import json
import os
import shutil
import tempfile
from pathlib import Path

import pytest
from asking import asking
from command_line import run
from serving import Serving, launch
from simulated_disk import Killed, SimulatedDisk

from dyknow.engine.durability.checkpoint import program
from dyknow.engine.durability.commands import (
    DeclareStream,
    Publish,
    RegisterTemplate,
    Tick,
)
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.journal import examination
from dyknow.journal.checkpoints import Checkpoints
from dyknow.journal.disk import Disk
from dyknow.journal.durability import Durability
from dyknow.journal.errors import JournalDamaged
from dyknow.journal.examination import files_of
from dyknow.journal.inspection import inspect
from dyknow.journal.repair import repair
from dyknow.journal.segment import header_of, scan, walk
from dyknow.rdf.namespaces import DYKNOW
from dyknow.service.app import create_app
from dyknow.service.cli.data import data_directory as cli
from dyknow.service.config.settings import Settings
from dyknow.service.server import running
from dyknow.streams.history import Retention
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import SECOND

SPEEDS = StreamDeclaration("s5", (Field("n", FieldType.INTEGER),), 0, Retention(), DYKNOW, None)
NDJSON = {"content-type": "application/x-ndjson"}
TEMPLATE = "templates/library/high_speed.rq"
HEADER = len(header_of(1))
"""Bytes of a file of the log before its records."""


def speed(n):
    body = b'{"valid": %d, "available": %d, "n": %d}\n' % (n * SECOND, n * SECOND, n)
    return Publish("s5", "ndjson", body, n * SECOND, f"key {n}")


def published(recorded):
    """The samples of the stream, by the numbers that were sent."""
    return recorded.engine.generator("s5").stream.all().columns["n"].values.tolist()


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """Samples 1 to 20, checkpoints after 5 and 12, a file of the log for about two commands; what
    dropping would forget is kept."""
    path = tmp_path_factory.mktemp("original") / "data"
    recorded = RecordedEngine(path, now=0, segment=200)
    recorded.do(DeclareStream(SPEEDS))
    for n in range(1, 21):
        recorded.do(speed(n))
        recorded.log.commit()
        if n in (5, 12):
            checkpoints, unwritten = Checkpoints(path / "checkpoints"), recorded.checkpoint()
            unwritten.put()
            checkpoints.keep(unwritten.position)
    recorded.close(checkpoint=False)
    for each in (path / "journal").glob("*.log"):
        # Without the room behind the records, 4 MiB a file: many copies are made.
        os.truncate(each, scan(each).end)
    return path


@pytest.fixture
def data(original, tmp_path):
    return shutil.copytree(original, tmp_path / "data")


def checked(data, status=0):
    return json.loads(run("check", data, "--json", status=status).stdout)


def flip(path, place):
    content = bytearray(path.read_bytes())
    content[place] ^= 1
    path.write_bytes(content)


def file_with(data, position):
    """The file of the log that has this record."""
    return next(
        path
        for path in sorted((data / "journal").glob("*.log"))
        if scan(path).first <= position <= scan(path).last
    )


def spoil(data, position):
    """Flip a bit of this record."""
    path = file_with(data, position)
    records = walk(path.read_bytes(), int(path.stem))
    flip(path, next(each.begin for each in records if each.position == position))


def opened(data):
    return RecordedEngine(data, now=30 * SECOND)


def test_a_sound_directory_is_told_so_with_what_a_start_does(data):
    before = {path: path.read_bytes() for path in data.rglob("*") if path.is_file()}
    found = checked(data)
    assert found["sound"]
    assert (found["format"], found["position"], found["in_use_by"]) == (2, 22, None)
    assert [each["position"] for each in found["checkpoints"]] == [14, 7]
    assert sum(each["records"] for each in found["log"]) == 22
    assert found["start"] == "goes on from checkpoint 14, does 8 commands again"
    text = run("check", data).stdout
    assert "14" in text
    assert "goes on from checkpoint 14" in text
    assert before == {path: path.read_bytes() for path in data.rglob("*") if path.is_file()}


def test_check_and_repair_of_a_directory_in_use(data):
    recorded = opened(data)
    assert checked(data)["in_use_by"]
    assert "in use by process" in run("repair", data, status=1).stderr
    recorded.close()


@pytest.mark.parametrize("command", [["check"], ["repair"], ["log"]])
def test_what_is_no_data_directory_is_refused(tmp_path, command):
    for path in (tmp_path, tmp_path / "none"):
        result = run(*command, path, status=1)
        assert result.stderr.startswith("error:")
        assert result.stdout == ""


def test_a_sound_directory_is_not_repaired(data):
    before = sorted(data.rglob("*"))
    run("repair", data)
    assert sorted(data.rglob("*")) == before


def test_damage_behind_the_checkpoint_is_cut_and_told_and_ids_begin_anew(data):
    path = file_with(data, 18)
    flip(path, scan(path).end - 3)
    damage = checked(data, status=1)
    assert not damage["sound"]
    assert path.name in damage["damage"][0]
    assert damage["start"].startswith("refuses")
    assert "dyknow repair" in run("serve", "--data", data, "--port", "0", status=1).stderr
    done = json.loads(run("repair", data, "--json").stdout)
    assert (done["position"], done["lost"]) == (17, "records 18 to 22")
    assert all(each.endswith(".damaged") for each in done["aside"])
    # Every byte is still somewhere.
    assert (path.parent / f"{path.name}.damaged").exists()
    assert "begin anew: records 18 to 22 lost" in checked(data)["start"]
    recorded = opened(data)
    assert not recorded.recovery.is_continued
    assert any("records 18 to 22" in note for note in recorded.recovery.notes)
    assert published(recorded) == list(range(1, 16))
    epoch = recorded.engine.epoch
    # Sent again under its key, what was lost comes once.
    recorded.do(speed(16))
    recorded.close(checkpoint=False)
    assert "anew" not in checked(data)["start"]
    recorded = opened(data)
    assert recorded.engine.epoch == epoch
    assert published(recorded) == list(range(1, 17))
    recorded.close()


def test_damage_before_the_checkpoint_loses_nothing(data):
    original = read_epoch(data)
    flip(file_with(data, 9), 60)
    checked(data, status=1)
    done = json.loads(run("repair", data, "--json").stdout)
    assert done["lost"] is None
    assert done["position"] == 22
    assert checked(data)["start"] == "goes on from checkpoint 14, does 8 commands again"
    recorded = opened(data)
    assert recorded.recovery.is_continued
    assert recorded.engine.epoch == original
    assert published(recorded) == list(range(1, 21))
    recorded.close()


def read_epoch(data):
    first = run("log", data, "-n", "1").stdout
    return json.loads(first)["epoch"]


def test_a_missing_file_is_a_cut(data):
    file_with(data, 17).unlink()
    assert "records up to" in checked(data, status=1)["damage"][0]
    done = json.loads(run("repair", data, "--json").stdout)
    assert done["lost"].endswith("to 22")
    recorded = opened(data)
    assert published(recorded) == list(range(1, done["position"] - 1))
    recorded.close()


def test_a_damaged_checkpoint_is_set_aside_and_nothing_is_lost(data):
    newest = max((data / "checkpoints").glob("*.checkpoint"))
    flip(newest, 500)
    found = checked(data, status=1)
    assert found["checkpoints"][0]["damage"]
    assert found["start"] == "goes on from checkpoint 7, does 15 commands again"
    # A start does without it.
    recorded = opened(data)
    assert published(recorded) == list(range(1, 21))
    recorded.close(checkpoint=False)
    done = json.loads(run("repair", data, "--json").stdout)
    assert done["aside"] == [f"{newest}.damaged", f"{newest.parent}/kept.json.damaged"]
    assert done["lost"] is None
    assert checked(data)["sound"]


def test_without_any_log_the_newest_checkpoint_is_gone_on_from(data):
    shutil.rmtree(data / "journal")
    checked(data, status=1)
    done = json.loads(run("repair", data, "--json").stdout)
    assert done["lost"] == "what may have followed record 14"
    recorded = opened(data)
    assert published(recorded) == list(range(1, 13))
    recorded.do(speed(13))
    recorded.close(checkpoint=False)
    recorded = opened(data)
    assert published(recorded) == list(range(1, 14))
    recorded.close()


def test_where_nothing_can_be_gone_on_from_nothing_is_changed(data):
    shutil.rmtree(data / "checkpoints")
    file_with(data, 1).unlink()
    before = sorted(data.rglob("*"))
    assert "restore a backup" in run("repair", data, status=1).stderr
    assert sorted(data.rglob("*")) == before


@pytest.mark.parametrize(("one", "other"), [(0, 1), (1, 2), (1, -2), (-3, -2)])
def test_files_of_the_log_whose_contents_were_swapped_are_all_kept(data, one, other):
    epoch, files = read_epoch(data), sorted((data / "journal").glob("*.log"))
    swap(files[one], files[other])
    checked(data, status=1)
    done = json.loads(run("repair", data, "--json").stdout)
    assert (done["first"], done["position"], done["lost"]) == (1, 22, None)
    assert sorted((data / "journal").glob("*.log")) == files
    recorded = started_again(data)
    assert recorded.engine.epoch == epoch
    assert published(recorded) == list(range(1, 21))
    recorded.close()


def swap(path, other):
    content = path.read_bytes()
    path.write_bytes(other.read_bytes())
    other.write_bytes(content)


def started_again(data):
    """After one repair: it is sound, and goes on."""
    assert checked(data)["sound"]
    return opened(data)


def test_checkpoints_whose_contents_were_swapped_are_all_kept(data):
    swap(*(data / "checkpoints").glob("*.checkpoint"))
    shutil.rmtree(data / "journal")
    run("repair", data)
    assert [each["position"] for each in checked(data)["checkpoints"]] == [14, 7]
    recorded = started_again(data)
    assert published(recorded) == list(range(1, 13))
    recorded.close()


@pytest.mark.parametrize("size", [0, HEADER])
@pytest.mark.parametrize(("position", "last"), [(1, 22), (9, 22), (14, 22), (15, 14), (18, 16)])
def test_a_file_that_was_cut_to_its_header_is_as_one_that_is_gone(data, position, last, size):
    """What comes before the newest checkpoint is not needed."""
    path = file_with(data, position)
    os.truncate(path, size)
    checked(data, status=1)
    done = json.loads(run("repair", data, "--json").stdout)
    assert done["position"] == last
    assert (done["lost"] is None) == (last == 22)
    recorded = started_again(data)
    assert published(recorded) == list(range(1, last - 1))
    recorded.close()


def test_what_a_restore_has_left_that_was_not_finished_is_not_repaired(data):
    (data / "restoring").write_text("from copy\n")
    flip(file_with(data, 18), 60)
    before = {path: path.read_bytes() for path in data.rglob("*") if path.is_file()}
    told = run("repair", data, status=1)
    assert "was not finished" in told.stderr
    assert "remove the directory and restore again" in " ".join(told.stderr.split())
    del before[data / "lock"]
    after = {path: path.read_bytes() for path in data.rglob("*") if path.is_file()}
    assert before.items() <= after.items()
    assert after.keys() == {*before, data / "lock"}


@pytest.mark.parametrize("name", ["checkpoints/kept.json", "journal/high-water-mark"])
@pytest.mark.parametrize("content", [b"[14, \xff", b"[14,6]\n", b""])
def test_what_is_written_anew_stays_as_it_was(data, name, content):
    (data / name).write_bytes(content)
    checked(data, status=1)
    done = json.loads(run("repair", data, "--json").stdout)
    assert done["aside"] == [str(data / f"{name}.damaged")]
    assert (data / f"{name}.damaged").read_bytes() == content
    assert checked(data)["sound"]
    assert done["position"] == 22


def test_a_damaged_backup_is_not_repaired_and_stays_as_it_is(data, tmp_path):
    run("backup", data, tmp_path / "copy")
    spoil(tmp_path / "copy", 22)
    before = {path: path.read_bytes() for path in tmp_path.joinpath("copy").rglob("*.*")}
    assert "is a backup" in run("repair", tmp_path / "copy", status=1).stderr
    after = {path: path.read_bytes() for path in tmp_path.joinpath("copy").rglob("*.*")}
    assert after == before


def test_what_is_called_otherwise_is_not_looked_at(data):
    """As check tells of it."""
    newest = max((data / "checkpoints").glob("*.checkpoint"))
    names = ["checkpoints/14.checkpoint", "journal/4.log", "journal/\u00b2.log"]
    for name in names:
        shutil.copy(newest, data / name)
    found = checked(data)
    assert [each["position"] for each in found["checkpoints"]] == [14, 7]
    assert sorted(found["strays"]) == sorted(names)
    opened(data).close()


def test_what_stays_is_on_the_disk_before_the_mark_tells_of_it(data):
    """As a start sees to it: a process that was killed may have left it to the system."""
    synced, done = set(), []

    class Watched(Disk):
        def sync(self, file):
            synced.add(os.readlink(f"/proc/self/fd/{file}"))
            super().sync(file)

        def rename(self, path, target):
            done.append((target.name, frozenset(synced)))
            super().rename(path, target)

    (data / "checkpoints" / "kept.json").write_text("[")
    (data / "journal" / "high-water-mark").unlink()
    repair(inspect(data, program(), is_held=True), Watched())
    (before,) = (known for name, known in done if name == "high-water-mark")
    files = [*(data / "journal").glob("*.log"), *(data / "checkpoints").glob("*.checkpoint")]
    assert {str(each) for each in files} <= before


def test_after_a_repair_that_was_stopped_early_nothing_starts(data):
    """Where a start would have passed over what is damaged, too."""
    first, second = sorted((data / "checkpoints").glob("*.checkpoint"))
    contents = first.read_bytes(), second.read_bytes()
    second.write_bytes(contents[0])
    first.write_bytes(contents[1])

    class Stopping(Disk):
        """It dies when the first file is to get its place."""

        def rename(self, path, target):
            if target.suffix == ".checkpoint":
                raise Killed
            super().rename(path, target)

    with pytest.raises(Killed):
        repair(inspect(data, program(), is_held=True), Stopping())
    assert len(list((data / "checkpoints").glob("*.checkpoint.repairing"))) == 2
    with pytest.raises(JournalDamaged):
        opened(data)
    run("repair", data)
    opened(data).close()


def test_what_an_earlier_repair_has_told_is_told_yet(data):
    """No start has heard of it."""
    for position in (20, 18):
        spoil(data, position)
        run("repair", data)
    recorded = opened(data)
    assert any("20 to 22 lost; records 18 to 19" in each for each in recorded.recovery.notes)
    recorded.close()


def test_repair_may_be_stopped_anywhere_and_called_again(data, tmp_path):
    """Amid any call of the disk; in between nothing starts. (More in
    tests/laws/journal/test_repair.py.)"""
    files = sorted((data / "journal").glob("*.log"))
    swap(files[0], files[4])
    flip(max((data / "checkpoints").glob("*.checkpoint")), 500)
    (data / "journal" / "high-water-mark").unlink()
    path = file_with(data, 18)
    flip(path, scan(path).end - 3)
    whole = shutil.copytree(data, tmp_path / "whole")
    expected = repair(inspect(whole, program()))
    assert (expected.kept, expected.lost) == ((1, 17), "records 18 to 22")
    for calls in range(1000):
        again, disk = shutil.copytree(data, tmp_path / "again"), SimulatedDisk()
        disk.stop_after = calls
        try:
            repair(inspect(again, program()), disk)
            break
        except Killed:
            disk.kill()
        if inspect(again, program()).is_sound:
            break  # Killed when all was done.
        with pytest.raises(JournalDamaged):
            opened(again)
        done = repair(inspect(again, program()))
        assert (done.kept, done.lost) == (expected.kept, expected.lost)
        assert contents(again) == contents(whole)
        shutil.rmtree(again)
    assert calls > 20
    recorded = opened(whole)
    assert not recorded.recovery.is_continued
    assert published(recorded) == list(range(1, 16))
    recorded.close()


def contents(folder):
    files = [path for path in folder.rglob("*") if path.is_file() and path.name != "lock"]
    return {path.relative_to(folder): path.read_bytes() for path in files}


@pytest.mark.parametrize("name", ["copy", "copy.tar"])
def test_a_backup_is_restored(data, tmp_path, name):
    copy, again = tmp_path / name, tmp_path / "again"
    told = run("backup", data, copy).stdout
    assert "up to record 22" in told
    assert not (tmp_path / f"{name}.part").exists()
    assert not any(path.stat().st_mode & 0o077 for path in [copy, *copy.rglob("*.*")])
    assert "is there already" in run("backup", data, copy, status=1).stderr
    again.mkdir()
    manifest = json.loads(run("restore", copy, again, "--json").stdout)
    assert (manifest["checkpoint"], manifest["position"]) == (14, 22)
    assert "not empty" in run("restore", copy, again, status=1).stderr
    assert checked(again)["sound"]
    recorded = opened(again)
    assert published(recorded) == list(range(1, 21))
    # The service that it was made of may have gone on with the same ids.
    assert not recorded.recovery.is_continued
    assert recorded.engine.epoch != read_epoch(data)
    recorded.close()


def test_a_damaged_backup_and_what_is_none_are_refused(data, tmp_path):
    copy = tmp_path / "copy"
    run("backup", data, copy)
    flip(next((copy / "checkpoints").iterdir()), 1000)
    assert "damaged" in run("restore", copy, tmp_path / "again", status=1).stderr
    assert not (tmp_path / "again").exists()
    assert "is no backup" in run("restore", data, tmp_path / "again", status=1).stderr
    (tmp_path / "x.tar").write_bytes(b"none")
    assert "is no backup" in run("restore", tmp_path / "x.tar", tmp_path / "again", status=1).stderr


def test_a_restore_that_was_not_finished_is_not_started(data, tmp_path):
    (data / "restoring").write_text("from copy\n")
    assert "not finished" in run("serve", "--data", data, "--port", "0", status=1).stderr
    found = checked(data, status=1)
    assert not found["sound"]
    assert found["start"].startswith("refuses")
    assert "not finished" in run("backup", data, data.with_name("copy"), status=1).stderr


@pytest.mark.parametrize("position", [18, 21, 22])
def test_a_damaged_directory_is_not_backed_up(data, tmp_path, position):
    """Also where the rest alone would look like a log that ends sooner."""
    spoil(data, position)
    assert "not sound" in run("backup", data, tmp_path / "copy", status=1).stderr
    assert not list(tmp_path.glob("copy*"))


def test_a_directory_whose_last_records_are_gone_is_not_backed_up(data, tmp_path):
    file_with(data, 22).unlink()
    assert "not sound" in run("backup", data, tmp_path / "copy", status=1).stderr


@pytest.mark.parametrize("in_use", [False, True])
def test_what_was_acknowledged_and_written_only_is_missed_where_it_is_gone(tmp_path, in_use):
    data = tmp_path / "data"
    recorded = RecordedEngine(data, now=0, segment=400, durability=Durability.WRITE)
    recorded.do(DeclareStream(SPEEDS))
    for n in range(1, 21):
        recorded.do(speed(n))
        recorded.log.commit()
    if not in_use:
        data = shutil.copytree(data, tmp_path / "killed")
    file_with(data, 20).write_bytes(header_of(scan(file_with(data, 20)).first))
    assert "are lost" in "".join(checked(data, status=1)["damage"])
    assert "not sound" in run("backup", data, tmp_path / "copy", status=1).stderr
    assert run("log", data, status=1).stdout
    recorded.close(checkpoint=False)


def test_a_log_that_is_gone_is_missed(data, tmp_path):
    shutil.rmtree(data / "journal")
    assert "not sound" in run("backup", data, tmp_path / "copy", status=1).stderr
    there = tmp_path / "running"
    recorded = RecordedEngine(there, now=0)
    recorded.do(Tick(5))
    recorded.log.commit()
    shutil.rmtree(there / "journal")
    assert checked(there, status=1)["damage"]
    assert "not sound" in run("backup", there, tmp_path / "copy", status=1).stderr
    (there / "journal").mkdir()
    recorded.close(checkpoint=False)


def test_a_backup_is_not_started_itself(data, tmp_path):
    """It would give the ids that the service gives that it was made of."""
    run("backup", data, tmp_path / "copy")
    assert "dyknow restore" in checked(tmp_path / "copy")["start"]
    before = (tmp_path / "copy" / "backup.json").read_bytes()
    told = run("serve", "--data", tmp_path / "copy", "--port", "0", status=1).stderr
    assert "is a backup" in told
    assert "dyknow restore" in told
    assert (tmp_path / "copy" / "backup.json").read_bytes() == before
    run("restore", tmp_path / "copy", tmp_path / "again")


def test_a_backup_leaves_what_is_there_as_it_is(data, tmp_path):
    (tmp_path / "copy.part").mkdir()
    (tmp_path / "copy.part" / "mine").write_text("mine")
    run("backup", data, tmp_path / "copy")
    run("backup", data, tmp_path / "copy.tar")
    assert (tmp_path / "copy.part" / "mine").read_text() == "mine"
    assert {each.name for each in tmp_path.iterdir()} == {"data", "copy", "copy.part", "copy.tar"}
    (tmp_path / "nowhere").symlink_to(tmp_path / "not there")
    assert "is there already" in run("backup", data, tmp_path / "nowhere", status=1).stderr
    assert "in the data directory" in run("backup", data, data / "copy", status=1).stderr
    flip(file_with(data, 22), 60)
    run("backup", data, tmp_path / "a" / "b" / "copy", status=1)
    assert not (tmp_path / "a").exists()


def test_a_backup_whose_manifest_tells_of_others_is_not_restored(data, tmp_path):
    run("backup", data, tmp_path / "copy")
    manifest = tmp_path / "copy" / "backup.json"
    for name in ("first", "position"):
        known = json.loads(manifest.read_bytes())
        changed = tmp_path / name
        shutil.copytree(tmp_path / "copy", changed)
        (changed / "backup.json").write_text(json.dumps({**known, name: known[name] + 1}))
        told = run("restore", changed, tmp_path / f"again {name}", status=1).stderr
        assert "instead of" in told
        told = run("serve", "--data", tmp_path / f"again {name}", "--port", "0", status=1).stderr
        assert "not finished" in told
    (tmp_path / "file").write_text("a file")
    assert "no directory" in run("restore", tmp_path / "copy", tmp_path / "file", status=1).stderr


def test_bytes_that_are_no_text_are_damage_or_shown_as_they_are(data, tmp_path):
    newest = max((data / "checkpoints").glob("*.checkpoint"))
    content = newest.read_bytes()
    newest.write_bytes(content[:14] + b"\xff" + content[15:])
    assert "not sound" in run("backup", data, tmp_path / "copy", status=1).stderr
    newest.write_bytes(content)
    (data / "repaired").write_bytes(b"\xff lost\n")
    assert "lost" in checked(data)["start"]


def test_what_is_damaged_before_the_newest_checkpoint_is_not_in_a_backup(data, tmp_path):
    """Nor needed: it is backed up as a directory that has forgotten it."""
    spoil(data, 8)
    run("backup", data, tmp_path / "copy")
    run("restore", tmp_path / "copy", tmp_path / "again")
    assert checked(tmp_path / "again")["sound"]


def test_a_backup_of_a_service_that_takes_samples_and_forgets_is_whole(tmp_path):
    """While it publishes, writes checkpoints and drops what they need no more."""
    data = tmp_path / "data"
    recorded = RecordedEngine(data, now=0, segment=500)
    settings = Settings(
        port=0, tick=0.02, data=data, checkpoint_bytes=2000, checkpoint_interval=1000
    )
    acknowledged = []
    with (
        running(create_app(recorded, settings, lambda: SECOND), settings) as url,
        asking(url) as http,
    ):
        http.put("/streams/s5", json={"fields": {"n": "integer"}}).raise_for_status()
        for i in range(4):
            for n in range(i * 30 + 1, i * 30 + 31):
                http.post("/streams/s5/samples", content=speed(n).body).raise_for_status()
            run("backup", data, tmp_path / f"copy{i}")
            acknowledged.append((i + 1) * 30)
    for i, least in enumerate(acknowledged):
        again = tmp_path / f"again{i}"
        run("restore", tmp_path / f"copy{i}", again)
        restored = RecordedEngine(again, now=SECOND)
        found = published(restored)
        assert found == list(range(1, len(found) + 1))
        assert len(found) >= least
        restored.close(checkpoint=False)


def test_the_log_is_printed_for_people_who_look_for_a_cause(data):
    lines = [json.loads(line) for line in run("log", data).stdout.splitlines()]
    assert [line["position"] for line in lines] == list(range(1, 23))
    assert [line["do"] for line in lines[:3]] == ["begin", "declare stream", "publish"]
    assert lines[2]["key"] == "key 1"
    assert lines[2]["body"] == speed(1).body.decode()
    (last,) = run("log", data, "--after", "21", "--full").stdout.splitlines()
    assert json.loads(last)["body"] == speed(20).body.decode()
    assert len(run("log", data, "-n", "3").stdout.splitlines()) == 3


def test_of_a_damaged_log_what_is_good_is_printed(data):
    path = file_with(data, 18)
    flip(path, scan(path).end - 3)
    result = run("log", data, status=1)
    assert len(result.stdout.splitlines()) == 17
    assert "18" in result.stderr or path.name in result.stderr


def test_a_log_with_a_gap_is_printed_up_to_it(data):
    spoil(data, 7)
    for after, printed in ((0, range(1, 7)), (8, ())):
        result = run("log", data, "--after", str(after), status=1)
        positions = [json.loads(line)["position"] for line in result.stdout.splitlines()]
        assert positions == list(printed)
        assert "dyknow check" in result.stderr


@pytest.mark.parametrize("gone", [1, 22])
def test_a_log_that_lacks_its_beginning_or_end_is_told(data, gone):
    file_with(data, gone).unlink()
    result = run("log", data, status=1)
    assert result.stdout
    assert "records up to 22 were kept" in result.stderr


def test_files_that_are_forgotten_while_they_are_looked_at_are_no_fault(data, monkeypatch):
    """A service forgets them after they are listed."""
    recorded = opened(data)
    there = files_of(data / "journal")
    for module, command in ((examination, "log"), (examination, "check"), (cli, "check")):
        calls = []

        def listed(folder, calls=calls):
            calls.append(folder)
            return [*there, folder / "00000000000000000099.log"] if len(calls) < 3 else there

        def told(*arguments, calls=calls, **options):
            calls.append(arguments)
            if len(calls) < 3:
                raise FileNotFoundError("a file of the log")
            return []

        with monkeypatch.context() as patched:
            if module is examination:
                patched.setattr(examination, "files_of", listed)
            else:
                patched.setattr(cli, "found_processes", told)
            run(command, data)
        assert len(calls) == 3
    recorded.close(checkpoint=False)


def test_long_texts_are_abbreviated(tmp_path):
    recorded = RecordedEngine(tmp_path / "data", now=0)
    text = Path(TEMPLATE).read_text()
    recorded.do(RegisterTemplate(text))
    recorded.do(Tick(5))
    recorded.close(checkpoint=False)
    lines = [json.loads(each) for each in run("log", tmp_path / "data").stdout.splitlines()]
    assert f"… ({len(text)})" in lines[1]["text"]
    assert lines[2] == {"position": 3, "bytes": lines[2]["bytes"], "do": "tick", "now": 5}
    full = run("log", tmp_path / "data", "--full").stdout.splitlines()
    assert json.loads(full[1])["text"] == text


UNITS = """
import threading

import dyknow


@dyknow.computational_unit(output="total", inputs=["v"])
class Holding:
    def __init__(self):
        self.lock = threading.Lock()

    def __call__(self, time, samples, state):
        return samples[0].value, state


@dyknow.source(sort="float", period="50ms")
def ticking(time):
    return 1.0
"""
HELD = """sort v = (value float)
sort total = (value float)
source float ticking
source v s
compunit total Holding(v)
strmgen x = s
strmgen held = Holding(x)"""


def test_a_module_that_cannot_be_kept_or_is_gone_is_told_everywhere(tmp_path):
    module = tmp_path / "holding_units.py"
    module.write_text(UNITS)
    data, loaded = tmp_path / "data", ("--processes", str(module))
    serving = Serving(data, *loaded, DYKNOW_CHECKPOINT_INTERVAL="0.1")
    try:
        http = serving.http
        http.put("/streams/s", json={"fields": {"value": "float"}}).raise_for_status()
        http.post("/kpl", content=HELD, headers={"content-type": "text/plain"}).raise_for_status()
        sample = {"valid": "2026-01-01T00:00:00Z", "value": 1.5}
        http.post("/streams/s/samples", json=sample, headers=NDJSON).raise_for_status()
        told = serving.until(lambda: changes(http, "state not kept"))
        assert [each["transformation"] for each in told] == ["Holding"]
        assert "self.lock is a lock" in told[0]["specification"]
        assert any("self.lock" in line for line in serving.lines)
        # At a start it is not before all is warm.
        serving.until(lambda: http.get("/readyz").status_code == 200)
    finally:
        serving.kill()
    checked = run_anew("check", data)
    assert "a start needs the user-written process 'Holding' of module 'holding_units'" in checked
    assert "not kept: Holding: self.lock is a lock and cannot be pickled" in checked
    assert checked.count("ids of events begin anew") == 1  # because of that
    assert "missing" not in run_anew("check", data, *loaded)
    # Without the module it says so, and what was declared waits.
    without = Serving(data)
    try:
        for lines in (without.lines, [each["specification"] for each in restored(without.http)]):
            for name in ("Holding", "ticking"):
                assert any(f"{name!r} of module 'holding_units' is missing" in it for it in lines)
        kinds = {each["name"]: each["kind"] for each in without.http.get("/kpl").json()}
        assert kinds["strmgen held = Holding(x)"] == "not restored"
    finally:
        without.kill()
    empty = tmp_path / "empty_units.py"
    empty.write_text("")
    checked = run_anew("check", data, "--processes", str(empty))
    assert "missing: the user-written process 'Holding' of module 'holding_units'" in checked
    again = Serving(data, *loaded)
    try:
        kinds = {each["name"]: each["kind"] for each in again.http.get("/kpl").json()}
        assert kinds["held"] == "strmgen"
        count = again.http.get("/streams/ticking").json()["last"]
        again.until(lambda: again.http.get("/streams/ticking").json()["last"] > count)
        assert not any("missing" in line for line in again.lines)
    finally:
        again.stop()


def changes(http, change):
    lines = http.get("/streams/status/samples").text.splitlines()
    return [each for line in lines if (each := json.loads(line))["change"] == change]


def restored(http):
    return changes(http, "not restored")


def run_anew(*arguments):
    """What a command in a process of its own prints: it loads modules."""
    with tempfile.TemporaryFile("w+") as file:
        process = launch(*map(str, arguments), stdout=file.fileno(), COLUMNS="300")
        assert process.wait() == 0
        file.seek(0)
        return file.read()
