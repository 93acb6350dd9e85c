"""The how-to pages and one explanation: files are written, `sh` blocks run.

The blocks of a page run from top to bottom on a new service, in a folder with the page's files and
the checkout's `templates` and `examples`. A `text` block right after a `sh` block is its output.
"""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest
from places import ROOT
from serving import shell

from dyknow.service.config.settings import Settings

PAGES = sorted(
    page
    for pattern in ("how-to/*.md", "explanation/which-verdict-when.md")
    for page in (ROOT / "docs").glob(pattern)
    if "```sh\n" in page.read_text()
)


@pytest.fixture
def clock() -> Callable[[], int]:
    """The clock of this machine: the pages' samples are of the past, and none is ahead of it."""
    return time.time_ns


@pytest.fixture
def settings(settings: Settings) -> Settings:
    """With the usual limit of bodies: a page plays the recording of examples/."""
    return settings.model_copy(update={"body_limit": Settings().body_limit})


@pytest.mark.skipif(shutil.which("curl") is None, reason="there is no curl")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_commands_run_from_top_to_bottom(page: Path, url: str, tmp_path: Path) -> None:
    blocks = re.findall(r"^```(\w+)(?: (\S+))?\n(.*?)^```", page.read_text(), re.M | re.S)
    for _, name, text in blocks:
        if name:
            (tmp_path / name).write_text(text)
    for shared in ("templates", "examples"):
        (tmp_path / shared).symlink_to(ROOT / shared)
    commands = [text for kind, _, text in blocks if kind == "sh"]
    told = shell("".join(f"echo; echo @@@\n{text}" for text in commands), tmp_path, url)
    shown = {
        command: output
        for (kind, _, command), (after, _, output) in pairwise(blocks)
        if (kind, after) == ("sh", "text")
    }
    printed = told.split("\n@@@\n")[1:]
    for command, output in zip(commands, printed, strict=True):
        assert lines(output) == lines(shown.get(command, output))


def lines(text: str) -> list[str]:
    """A text without the blanks at the ends of its lines."""
    return [line.rstrip() for line in text.strip().splitlines()]
