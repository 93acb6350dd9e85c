"""The tutorials, run as they are written: files, commands, and the services that they start.

Blocks run from top to bottom in a folder with the checkout's `examples`. A `console` block with
`dyknow serve` or `make serve` stops the service before it and starts that one, as a process of its
own at a free port, which stands for the page's address. A `text` block right after a `sh` block is
its output; `…` there is whatever depends on the machine.
"""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from pages import Block, blocks
from places import ROOT
from serving import Serving, shell

PAGES = sorted((ROOT / "docs" / "tutorial").glob("*.md"))


class Reader:
    """Somebody who does what a page says, in ``folder``."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._service: Serving | None = None
        (folder / "examples").symlink_to(ROOT / "examples")

    def starts(self, block: Block) -> bool:
        """Start the service that a block of commands for another terminal starts, if it does."""
        found = re.search(r"^\$ (make serve|dyknow serve.*?)\s*(#.*)?$", block.text, re.MULTILINE)
        if found is None:
            return False
        self.stop()
        _, _, *options = shlex.split(found[1])
        if found[1] == "make serve":
            options = ["--flights"]
        if "--data" in options:
            place = options.index("--data") + 1
            options[place] = str(self._folder / options[place])
        service = self._service = Serving(None, *options)
        if "--flights" in options:
            service.until(lambda: "The recorded flights play" in service.log)
        return True

    def does(self, commands: str) -> str:
        """Run the commands of a `sh` block, and return what they print."""
        url = "http://127.0.0.1:1" if self._service is None else self._service.url
        return shell(commands, self._folder, url)

    def stop(self) -> None:
        if self._service is not None:
            self._service.stop()
            self._service = None


@pytest.fixture
def reader(tmp_path: Path) -> Iterator[Reader]:
    reader = Reader(tmp_path)
    yield reader
    reader.stop()


@pytest.mark.long
@pytest.mark.skipif(shutil.which("curl") is None, reason="there is no curl")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_tutorial_runs_as_it_is_written(page: Path, reader: Reader, tmp_path: Path) -> None:
    printed: str | None = None
    started = 0
    for block in blocks(page):
        if block.file:
            (tmp_path / block.file).write_text(block.text)
        elif block.language == "console":
            started += reader.starts(block)
        elif block.language == "text" and printed is not None:
            assert fits(printed, block.text), printed
        printed = reader.does(block.text) if block.language == "sh" else None
    assert started


def fits(printed: str, shown: str) -> bool:
    """Whether the output is the one that the page shows, blanks at the ends of lines aside."""
    lines = "\n".join(line.rstrip() for line in printed.strip().splitlines())
    return re.fullmatch(re.escape(shown.strip()).replace("…", r".*"), lines) is not None
