"""The data directory: its format, and that one process has it."""

import fcntl
import os
import threading

import pytest

from dyknow.journal.directory import DataDirectory, locked
from dyknow.journal.errors import DirectoryInUse, JournalDamaged, UnknownFormat


def test_a_second_opener_is_told_who_has_it(tmp_path):
    with DataDirectory(tmp_path), pytest.raises(DirectoryInUse, match=f"process {os.getpid()}"):
        DataDirectory(tmp_path)
    DataDirectory(tmp_path).close()


def test_what_a_process_left_that_is_gone_does_not_hold_it(tmp_path):
    (tmp_path / "lock").write_text("4711                \n")
    with DataDirectory(tmp_path):
        assert (tmp_path / "lock").read_text().strip() == str(os.getpid())


def test_a_new_directory_says_its_format_whatever_a_crash_left(tmp_path):
    (tmp_path / "format.json.part").write_text('{"for')
    DataDirectory(tmp_path).close()
    assert (tmp_path / "format.json").read_text() == '{"format":2}\n'
    assert not (tmp_path / "format.json.part").exists()


def test_a_later_format_is_refused_with_what_to_do_and_let_go(tmp_path):
    (tmp_path / "format.json").write_text('{"format": 3}')
    with pytest.raises(UnknownFormat, match="format 3") as caught:
        DataDirectory(tmp_path)
    assert "later" in caught.value.hint
    lock = os.open(tmp_path / "lock", os.O_RDWR)
    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    os.close(lock)


@pytest.mark.parametrize("content", [b"", b"\xff", b'{"form', b'{"format": "2"}'])
def test_a_damaged_format_is_told_with_what_it_should_say(tmp_path, content):
    (tmp_path / "format.json").write_bytes(content)
    with pytest.raises(JournalDamaged) as caught:
        DataDirectory(tmp_path)
    assert '{"format": 2}' in caught.value.hint


def test_the_store_of_format_1_is_found_and_kept_under_another_name(tmp_path):
    (tmp_path / "ontology").mkdir()
    with DataDirectory(tmp_path) as directory:
        assert directory.old_store == tmp_path / "ontology"
        directory.forget_old_store()
        assert directory.old_store is None
    assert (tmp_path / "ontology.format1").is_dir()


def test_who_looks_at_a_directory_does_not_keep_others_from_it(tmp_path):
    """It has the lock for a moment."""
    os.close(locked(tmp_path))
    looking = os.open(tmp_path / "lock", os.O_RDONLY)
    fcntl.flock(looking, fcntl.LOCK_SH)
    threading.Timer(0.05, os.close, [looking]).start()
    os.close(locked(tmp_path))
