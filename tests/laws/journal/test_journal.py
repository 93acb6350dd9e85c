"""What a log keeps: all that was committed, whatever is lost or damaged, or it says so."""

import random

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from simulated_disk import Killed, SimulatedDisk
from small_logs import folder

from dyknow.journal.checkpoints import Checkpoint, Checkpoints
from dyknow.journal.durability import Durability
from dyknow.journal.errors import JournalBroken, JournalDamaged, JournalFull
from dyknow.journal.log import Log
from dyknow.journal.segment import header_of, walk

LIMITS = settings(deadline=None, max_examples=100)


def payload(position, size):
    return f"{position}:".encode() + bytes([position % 251]) * size


WORK = st.lists(
    st.one_of(
        st.tuples(st.just("append"), st.integers(0, 60)),
        st.tuples(st.just("append"), st.integers(0, 60)),
        st.tuples(st.just("commit"), st.just(0)),
        st.tuples(st.just("drop"), st.integers(0, 5)),
        st.tuples(st.just("fail"), st.integers(0, 60)),
        st.tuples(st.just("open"), st.just(0)),
    ),
    max_size=30,
)
SEGMENT = st.sampled_from([1, 100, 250, 1 << 20])


class Run:
    """A log with what was done to it."""

    def __init__(self, path, segment, disk=None, durability=Durability.FSYNC):
        self.path = path
        self.segment = segment
        self.durability = durability
        self.disk = disk or SimulatedDisk()
        self.appended = {}
        self.committed = 0
        self.dropped = 0
        self.log = None

    def open(self):
        self.log = Log(self.path, segment=self.segment, disk=self.disk, durability=self.durability)

    def do(self, work):
        for what, size in work:
            log = self.log
            if what == "append":
                position = log.position + 1
                # Noted first: a call that is cut short may have written it.
                self.appended[position] = payload(position, size)
                assert log.append(self.appended[position]) == position
            elif what == "commit":
                self.committed = max(self.committed, log.commit())
            elif what == "drop":
                # Noted first, too.
                self.dropped = max(self.dropped, log.durable - size)
                log.drop(log.durable - size)
            elif what == "fail":
                before = log.position
                try:
                    with log.entry(payload(before + 1, size)):
                        raise ZeroDivisionError
                except ZeroDivisionError:
                    assert log.position == before
            else:
                log.close()
                self.committed = max(self.committed, log.durable)
                self.open()

    def check(self, log, *, committed=None):
        """``log`` holds a prefix of what was appended, and all that was committed."""
        least = self.committed if committed is None else committed
        found = dict(log.read(0))
        assert list(found) == list(range(log.first, log.position + 1))
        assert all(found[each] == self.appended[each] for each in found)
        assert log.position >= least
        assert log.first <= self.dropped + 1 or not found
        assert log.durable == log.position


@given(WORK, SEGMENT, st.randoms(use_true_random=False))
@LIMITS
def test_after_a_loss_of_power_all_that_was_committed_is_there(work, segment, chance):
    """Of what was not synced any part may be there, torn at any byte; and again, when the power
    goes once more."""
    with folder() as path:
        run = Run(path, segment)
        run.open()
        for _ in range(3):
            run.do(work)
            disk = run.disk.lose_power(
                lambda: chance.random() < 0.5, lambda n: chance.randint(0, n)
            )
            run.disk = disk
            run.open()
            run.check(run.log)
            # What was lost is forgotten: its positions are given anew.
            run.appended = {k: v for k, v in run.appended.items() if k <= run.log.position}
            run.committed = run.log.position
        run.log.close()


@given(WORK, SEGMENT, st.integers(1, 200), st.sampled_from(list(Durability)))
@LIMITS
def test_after_a_kill_amid_any_call_all_that_was_committed_is_there(
    work, segment, calls, durability
):
    with folder() as path:
        run = Run(path, segment, durability=durability)
        run.disk.stop_after = calls
        try:
            run.open()
            run.do(work)
            run.do(work)
        except Killed:
            pass
        run.disk.kill()
        run.disk = SimulatedDisk()
        run.open()
        assert run.log.lost == 0
        assert run.log.doubt is None
        run.check(run.log)
        run.log.close()


@given(WORK, SEGMENT, st.integers(1, 250), st.randoms(use_true_random=False))
@LIMITS
def test_after_a_loss_of_power_amid_any_call_all_that_was_committed_is_there(
    work, segment, calls, chance
):
    """Also where the log is opened, closed and made shorter."""
    with folder() as path:
        run = Run(path, segment)
        run.disk.stop_after = calls
        try:
            run.open()
            run.do([*work, ("open", 0), ("drop", 1), *work, ("drop", 0)])
        except Killed:
            pass
        run.disk = run.disk.lose_power(
            lambda: chance.random() < 0.5, lambda n: chance.randint(0, n)
        )
        run.open()
        run.check(run.log)
        run.log.close()


@given(
    WORK.filter(lambda work: any(what == "append" for what, _ in work)),
    SEGMENT,
    st.sampled_from(["flip", "cut", "zeros", "delete", "swap"]),
    st.randoms(use_true_random=False),
    st.booleans(),
)
@LIMITS
def test_damage_is_told(work, segment, kind, chance, is_closed):
    """Whatever is done to the files: the log says so, or holds all that was committed."""
    with folder() as path:
        run = kept(path, work, segment, Durability.FSYNC, is_closed)
        damage(path, kind, chance)
        try:
            run.open()
        except JournalDamaged:
            return
        if run.log.torn is None:
            run.check(run.log)
        else:
            # Told, and what there still is is as it was.
            run.check(run.log, committed=0)
        run.log.close()


KEEPING = WORK.filter(lambda work: any(what == "append" for what, _ in work))
KINDS = st.sampled_from(["flip", "cut", "zeros", "delete", "swap"])


@given(
    KEEPING,
    SEGMENT,
    st.sampled_from(list(Durability)),
    KINDS,
    st.randoms(use_true_random=False),
    st.booleans(),
)
@LIMITS
def test_damage_of_one_file_is_always_told(work, segment, durability, kind, chance, is_closed):
    """Also where nothing is lost by it."""
    with folder() as path:
        run = kept(path, work, segment, durability, is_closed)
        before = meant(path)
        damage(path, kind, chance)
        left = meant(path)
        assert is_told(run) or left == before


@given(
    KEEPING,
    SEGMENT,
    st.sampled_from(list(Durability)),
    st.sampled_from(["flip", "cut", "zeros", "delete"]),
    st.sampled_from(["boundary", "cut", "zeros", "delete"]),
    st.randoms(use_true_random=False),
    st.booleans(),
)
@LIMITS
def test_damage_of_the_mark_and_a_cut_are_always_told(
    work, segment, durability, kind, how, chance, is_closed
):
    """Else numbers would be given twice: either nothing is started, or it is known that what was
    acknowledged may be gone."""
    with folder() as path:
        run = kept(path, work, segment, durability, is_closed)
        files, mark = sorted(path.glob("*.log")), path / "high-water-mark"
        before = mark.read_bytes()
        if how == "boundary":
            records = list(walk(files[-1].read_bytes(), int(files[-1].stem)))
            place = chance.choice(
                [len(header_of(1)), *(each.begin + each.length for each in records)]
            )
            files[-1].write_bytes(files[-1].read_bytes()[:place])
        else:
            damage(path, how, chance, files)
        damage(path, kind, chance, [mark])
        if not list(path.glob("*.log")):
            return  # No log at all is a new one: an engine gives it an epoch of its own.
        if not mark.exists() or mark.read_bytes() != before:
            assert is_told(run)
        if run.log is not None and run.log.position < run.committed:
            assert run.log.doubt is not None


def kept(path, work, segment, durability, is_closed):
    """What was done to a log that is closed, or was killed after a commit."""
    run = Run(path, segment, durability=durability)
    run.open()
    run.do(work)
    run.committed = run.log.commit()
    if is_closed:
        run.log.close()
    run.disk.kill()
    run.disk, run.log = SimulatedDisk(), None
    return run


def meant(path):
    """What is in the files: the room behind the records is nothing, nor is a file without any."""
    return {
        each: data
        for each in path.iterdir()
        if len(data := each.read_bytes().rstrip(b"\0")) > len(header_of(1))
    }


def is_told(run):
    """A start refuses, or has something to say."""
    said = []
    try:
        run.log = Log(run.path, segment=run.segment, disk=run.disk, on_doubt=said.append)
    except JournalDamaged:
        return True
    run.log.close()
    log = run.log
    assert said == ([] if log.doubt is None else [log.doubt])
    return bool(log.torn or log.doubt or log.mark_fault)


def damage(path, kind, chance, files=None):
    files = sorted(path.iterdir()) if files is None else files
    target = chance.choice(files)
    data = target.read_bytes()
    # Most of a file is room: what is written stands at its beginning.
    most = len(data.rstrip(b"\0")) or 1
    place = chance.randrange(min(most, len(data)) or 1)
    if kind == "flip":
        changed = bytearray(data)
        changed[place] ^= 1 << chance.randrange(8)
        target.write_bytes(changed)
    elif kind == "cut":
        target.write_bytes(data[:place])
    elif kind == "zeros":
        end = chance.randint(place, most)
        target.write_bytes(data[:place] + bytes(end - place) + data[end:])
    elif kind == "delete":
        target.unlink()
    else:
        other = chance.choice(files)
        content = other.read_bytes()
        other.write_bytes(data)
        target.write_bytes(content)


@given(
    st.lists(st.integers(0, 60), min_size=1, max_size=8),
    st.integers(0, 2),
    st.randoms(use_true_random=False),
)
@LIMITS
def test_a_flipped_bit_that_no_mark_tells_of_is_told_by_what_follows(sizes, later, chance):
    """An early mark is what a loss of power may leave: a later commit says what was kept."""
    with folder() as path:
        run = Run(path, 1 << 20)
        run.open()
        early = (path / "high-water-mark").read_bytes()
        run.do([("append", size) for size in sizes] + [("commit", 0)])
        end = run.log._open[-1]._written
        for _ in range(later + 1):
            run.do([("append", 5), ("commit", 0)])
        run.disk.kill()
        (path / "high-water-mark").write_bytes(early)
        name = path / f"{1:020d}.log"
        data = bytearray(name.read_bytes())
        data[chance.randrange(end)] ^= 1 << chance.randrange(8)
        name.write_bytes(data)
        with pytest.raises(JournalDamaged):
            Log(path)


@given(
    st.lists(st.tuples(st.integers(0, 300), st.integers(0, 3)), max_size=30),
    st.sampled_from([100, 1000, 1 << 20]),
)
@example([(300, 0), (300, 1), (10, 0), (10, 2)], 1 << 20)
@LIMITS
def test_a_full_disk_is_told_and_the_log_goes_on_when_there_is_room(steps, segment):
    """``steps``: how much is appended, and what the disk does meanwhile: 0 nothing, 1 it has no
    room to give, 2 what is written does not fit either, 3 there is room again."""
    with folder() as path:
        run = Run(path, segment)
        run.open()
        acknowledged = {}
        for size, what in steps:
            run.disk.room = 0 if what in (1, 2) else None
            run.disk.full_writes = what == 2
            before = run.log.position
            data = payload(before + 1, size)
            try:
                position = run.log.append(data)
            except JournalFull:
                assert run.log.position == before
                continue
            assert position == before + 1
            run.appended[position] = data
            try:
                run.log.commit()
            except JournalFull:
                continue
            acknowledged[position] = data
        run.disk.room, run.disk.full_writes = None, False
        run.committed = run.log.commit()
        assert run.committed == run.log.position
        assert run.log.append(b"more") == run.committed + 1
        run.appended[run.committed + 1] = b"more"
        run.log.commit()
        run.disk.kill()
        run.disk = SimulatedDisk()
        run.open()
        assert run.log.torn is None
        run.check(run.log)
        assert acknowledged.items() <= dict(run.log.read()).items()
        run.log.close()


@given(WORK, SEGMENT, st.randoms(use_true_random=False))
@LIMITS
def test_after_a_sync_that_failed_nothing_more_is_taken(work, segment, chance):
    with folder() as path:
        run = Run(path, segment)
        run.open()
        run.do(work)
        run.log.commit()
        run.committed = run.log.durable
        run.do([("append", 3)])
        run.disk.broken = {"sync"}
        for _ in range(2):
            with pytest.raises(JournalBroken):
                run.log.commit()
        run.disk.broken.clear()
        for refused in (run.log.commit, lambda: run.log.append(b"x")):
            with pytest.raises(JournalBroken):
                refused()
        assert run.log.durable == run.committed
        # What is committed is read as before.
        assert set(dict(run.log.read())) == set(range(run.log.first, run.committed + 1))
        disk = run.disk.lose_power(lambda: chance.random() < 0.5, lambda n: chance.randint(0, n))
        run.disk = disk
        run.open()
        run.check(run.log)
        run.log.close()


@given(
    st.lists(st.tuples(st.integers(1, 50), st.integers(0, 80)), min_size=1, max_size=6),
    st.integers(0, 60),
    st.randoms(use_true_random=False),
)
@LIMITS
def test_a_checkpoint_is_whole_or_not_there(steps, calls, chance):
    with folder() as path:
        disk = SimulatedDisk()
        written, position = {}, 0
        disk.stop_after = calls
        last = 0
        try:
            found = Checkpoints(path, disk)
            for more, size in steps:
                position += more
                kept = Checkpoint(
                    position, "p", b"a" * size, random.Random(position).randbytes(size)
                )
                written[position] = kept
                found.write(kept)
                last = position
        except Killed:
            pass
        disk.lose_power(lambda: chance.random() < 0.5, lambda n: chance.randint(0, n))
        found = Checkpoints(path)
        assert last == 0 or found.positions()[0] >= last
        assert all(found.read(each) == written[each] for each in found.positions())
        assert not list(path.glob("*.part"))


@given(st.integers(0, 40), st.integers(0, 40), st.sampled_from(["flip", "cut"]), st.data())
@LIMITS
def test_damage_to_a_checkpoint_is_told(portable, state, kind, data):
    with folder() as path:
        found = Checkpoints(path)
        kept = Checkpoint(7, "dyknow 1", b"p" * portable, b"s" * state)
        found.write(kept)
        name = next(path.glob("*.checkpoint"))
        content = bytearray(name.read_bytes())
        place = data.draw(st.integers(0, len(content) - 1))
        if kind == "flip":
            content[place] ^= 1 << data.draw(st.integers(0, 7))
        else:
            del content[place:]
        name.write_bytes(content)
        try:
            read = found.read(7)
        except JournalDamaged:
            return
        # White space in the head has no meaning; and 1 is 1.0.
        assert read == kept
