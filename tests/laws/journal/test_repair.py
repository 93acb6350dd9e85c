"""What ``dyknow repair`` makes of any damage: a directory that starts with the longest run of good
records; nothing good is gone, what is lost is told; also where it is stopped and called again."""

import shutil

from hypothesis import given, settings
from hypothesis import strategies as st
from simulated_disk import Killed, SimulatedDisk
from small_logs import folder

from dyknow.journal.checkpoints import Checkpoint, Checkpoints
from dyknow.journal.directory import DataDirectory
from dyknow.journal.errors import JournalDamaged
from dyknow.journal.inspection import inspect, misfit
from dyknow.journal.log import Log
from dyknow.journal.repair import repair
from dyknow.journal.segment import HEAD, header_of, walk

LIMITS = settings(deadline=None, max_examples=150)
PROGRAM = "p"


@st.composite
def works(draw):
    """How large the records are, the bytes of a file, after which records there are checkpoints,
    whether what nobody needs is forgotten, and whether the log is closed or killed."""
    sizes = draw(st.lists(st.integers(0, 40), min_size=1, max_size=14))
    segment = draw(st.sampled_from([1, 100, 150, 250]))
    checkpoints = draw(st.sets(st.integers(1, len(sizes)), max_size=2))
    return sizes, segment, sorted(checkpoints), draw(st.booleans()), draw(st.booleans())


FILES = st.sampled_from(["log", "log", "log", "log", "checkpoint", "mark", "list", "any"])
KINDS = st.sampled_from(["flip", "cut", "header", "empty", "delete", "zeros", "swap", "copy"])
DAMAGE = st.lists(st.tuples(KINDS, FILES, FILES), min_size=1, max_size=4)


class Original:
    """A data directory as it was before it was damaged: ``records`` by position, with their heads,
    and ``checkpoints`` by position, each as it stands in its file; ``synced``: up to where records
    were acknowledged."""

    def __init__(self, path, work):
        sizes, segment, checkpoints, drops, is_closed = work
        DataDirectory(path).close()
        known, disk = Checkpoints(path / "checkpoints"), SimulatedDisk()
        log = Log(path / "journal", segment=segment, disk=disk)
        self.records = {}
        for position, size in enumerate(sizes, 1):
            log.append(f"{position}:".encode() + bytes([position]) * size)
            log.commit()
            self._note(path)
            if position in checkpoints:
                known.write(Checkpoint(position, PROGRAM, b"portable", b"%d" % position))
                if drops:
                    log.drop(min(checkpoints))
        if is_closed:
            log.close()
        disk.kill()
        self.synced = len(sizes)
        self.checkpoints = {
            int(each.stem): each.read_bytes()
            for each in (path / "checkpoints").glob("*.checkpoint")
        }

    def _note(self, path):
        for each in (path / "journal").glob("*.log"):
            data = each.read_bytes()
            for found in walk(data, int(each.stem)):
                self.records[found.position] = data[found.begin - HEAD : found.begin + found.length]

    def there(self, path, *patterns):
        """The positions of records that stand somewhere in files that are called so."""
        contents = contents_of(path, *patterns)
        return {
            position
            for position, record in self.records.items()
            if any(record in data for data in contents)
        }

    def run(self, path):
        """First and last position of the longest run that something good goes before; None where
        nothing does. From the definition."""
        there = self.there(path)
        contents = contents_of(path)
        begins = {position for position, data in self.checkpoints.items() if data in contents}
        if 1 in there or not (there or begins):
            begins.add(0)
        if not begins:
            return None
        last = max(begins)
        for begin in begins:
            end = begin
            while end + 1 in there:
                end += 1
            last = max(last, end)
        first = last + 1
        while first - 1 in there:
            first -= 1
        return first, last


def contents_of(path, *patterns):
    return [
        each.read_bytes()
        for pattern in patterns or ("*",)
        for each in path.rglob(pattern)
        if each.is_file()
    ]


def damage(path, kind, one, other, chance):
    target = _file(path, one, chance)
    if target is None:
        return
    data = target.read_bytes()
    most = len(data.rstrip(b"\0")) or 1
    place = chance.randrange(min(most, len(data)) or 1)
    if kind == "flip" and data:
        changed = bytearray(data)
        changed[place] ^= 1 << chance.randrange(8)
        target.write_bytes(changed)
    elif kind == "cut":
        target.write_bytes(data[:place])
    elif kind == "header":
        target.write_bytes(data[: len(header_of(1))])
    elif kind == "empty":
        target.write_bytes(b"")
    elif kind == "delete":
        target.unlink()
    elif kind == "zeros":
        end = chance.randint(place, most)
        target.write_bytes(data[:place] + bytes(end - place) + data[end:])
    elif kind in ("swap", "copy") and (second := _file(path, other, chance)) is not None:
        content = second.read_bytes()
        second.write_bytes(data)
        if kind == "swap":
            target.write_bytes(content)


def _file(path, which, chance):
    named = {"log": "*.log", "checkpoint": "*.checkpoint", "mark": "high-*", "list": "kept.json"}
    folders = (path / "journal", path / "checkpoints")
    files = sorted(file for each in folders for file in each.glob(named.get(which, "*")))
    return chance.choice(files) if files else None


def snapshot(path):
    return {each: each.read_bytes() for each in path.rglob("*") if each.is_file()}


def started(path):
    """What a start finds in a copy of ``path``: its records, with their positions; None where it
    refuses."""
    copy = path.with_name("started")
    shutil.copytree(path, copy)
    try:
        with DataDirectory(copy):
            sound = [
                each.position for each in inspect(copy, PROGRAM).checkpoints if not each.damage
            ]
            log = Log(copy / "journal")
            found = dict(log.read())
            log.close()
            return found if misfit(log, sound) is None else None
    except JournalDamaged:
        return None
    finally:
        shutil.rmtree(copy)


def check(original, path, run, done, before):
    """The directory after its repair."""
    first, last = run
    assert done.kept == run
    # Sound, so that a second one has nothing to do; and it starts with just that.
    assert inspect(path, PROGRAM).damage == ()
    assert started(path) == {
        position: original.records[position][HEAD:] for position in range(first, last + 1)
    }
    # Nothing that was good is gone.
    assert original.there(path, "*.log", "*.damaged*") >= before
    # What is lost is told, now and to the next start.
    if last < original.synced:
        assert done.lost is not None
    if done.lost is not None:
        assert f"{done.lost} lost" in (path / "repaired").read_text()
    assert not list(path.rglob("*.part"))
    assert not list(path.rglob("1???????????????????.*"))


@given(works(), DAMAGE, st.randoms(use_true_random=False))
@LIMITS
def test_one_repair_keeps_the_longest_run_and_loses_no_file(work, damages, chance):
    with folder() as root:
        path = root / "data"
        original = Original(path, work)
        for each in damages:
            damage(path, *each, chance)
        run, found, files = original.run(path), inspect(path, PROGRAM), snapshot(path)
        before = original.there(path)
        if found.is_sound:
            return
        try:
            done = repair(found)
        except JournalDamaged:
            assert run is None
            assert snapshot(path) == files
            return
        assert run is not None
        check(original, path, run, done, before)
        # Whatever was changed stays: what there was is there.
        assert {*contents_of(path)} >= {*files.values()}


@given(works(), DAMAGE, st.randoms(use_true_random=False), st.data())
@LIMITS
def test_a_repair_that_is_stopped_is_called_again(work, damages, chance, data):
    """Also more than once, amid any call of the disk. In between nothing starts that would not
    have before, and every record is where it is looked for."""
    with folder() as root:
        path = root / "data"
        original = Original(path, work)
        for each in damages:
            damage(path, *each, chance)
        run, before = original.run(path), original.there(path)
        if run is None or inspect(path, PROGRAM).is_sound:
            return
        whole = shutil.copytree(path, root / "whole")
        expected = repair(inspect(whole, PROGRAM))
        could_start = started(path) is not None
        done = None
        for calls in (*data.draw(st.lists(st.integers(0, 40), min_size=1, max_size=3)), None):
            done = until_stopped(path, calls)
            if done is not None or inspect(path, PROGRAM).is_sound:
                break
            assert original.run(path) == run
            assert original.there(path) >= before
            assert could_start or started(path) is None
        assert done is None or (done.kept, done.lost) == (expected.kept, expected.lost)
        check(original, path, run, expected, before)
        names = {each.relative_to(path) for each in path.rglob("*")}
        assert names == {each.relative_to(whole) for each in whole.rglob("*")}
        assert all(
            (path / name).read_bytes() == (whole / name).read_bytes()
            for name in names
            if (path / name).is_file() and name.name != "lock"
        )


def until_stopped(path, calls):
    """Repair, by a process that is killed after so many calls of the disk; None if it was."""
    disk = SimulatedDisk()
    disk.stop_after = calls
    try:
        return repair(inspect(path, PROGRAM), disk)
    except Killed:
        return None
    finally:
        disk.kill()
