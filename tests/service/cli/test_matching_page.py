"""docs/explanation/matching.md: its files are read, its commands run, and print what the page
says."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from places import ROOT
from serving import shell

from dyknow.engine.processes.loading import load_processes
from dyknow.engine.processes.registry import PROCESSES

PAGE = (ROOT / "docs" / "explanation" / "matching.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)(?: (\S+))?\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
FOLLOW_UNTIL = """
follow_until() {
  command curl -sSN "$2" > followed & follower=$!
  until grep -q "$1" followed; do sleep 0.05; done
  kill $follower; wait $follower || true
  cat followed
}
"""
# The page follows for a second, the test until the switch has come: no machine is too slow.
BY_TIME, BY_CONTENT = "curl -sN -m 1 ", "follow_until 'quality of air.*}$' "


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """The page's files, and its code loaded as ``--processes`` does; forgotten afterwards."""
    before = {known.name for known in PROCESSES.all()}
    for _, name, text in BLOCKS:
        if name:
            (tmp_path / name).write_text(text)
    (report,) = load_processes([str(tmp_path / "helicopter.py")], points=[])
    assert report.error is None
    yield tmp_path
    for known in PROCESSES.all():
        if known.name not in before:
            PROCESSES.remove(known.name)


@pytest.mark.skipif(shutil.which("curl") is None, reason="there is no curl")
def test_the_commands_of_the_page_print_what_it_says(folder: Path, url: str) -> None:
    commands = [text for kind, _, text in BLOCKS if kind == "sh"]
    script = "".join(f"echo @@@\n{text}" for text in commands)
    assert script.count(BY_TIME) == 1
    script = script.replace(BY_TIME, BY_CONTENT)
    told = shell(FOLLOW_UNTIL + script, folder, url, COLUMNS="200")
    printed = told.split("@@@\n")[1:]
    shown = {
        command: then
        for (kind, _, command), (after, _, then) in pairwise(BLOCKS)
        if (kind, after) == ("sh", "text")
    }
    assert len(shown) == 2
    for command, said in zip(commands, printed, strict=True):
        assert shown.get(command, said) == said
    # The switch of the page, as the service tells it.
    (switch,) = (then for kind, _, then in BLOCKS if then.startswith("event: rematched"))
    assert switch.replace('": ', '":').replace(', "', ',"') in told
