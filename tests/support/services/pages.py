"""The pages of the project in Markdown: links, anchors, code blocks, commands."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from places import ROOT

_FENCED = re.compile(r"^```([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_SEPARATORS = frozenset({";", "|", "&&", "||", "&", "do", "then", "!"})


def pages() -> list[Path]:
    """Every page: those of the root, of docs/ and of examples/."""
    folders = (ROOT.glob("*.md"), (ROOT / "docs").rglob("*.md"), (ROOT / "examples").glob("*.md"))
    return sorted(page for folder in folders for page in folder)


@dataclass(frozen=True, slots=True)
class Block:
    """A fenced block: its language, the file that it is (``turtle ships.ttl``), its text."""

    language: str
    file: str
    text: str


def blocks(page: Path) -> list[Block]:
    """The fenced blocks of a page, in order."""
    found = _FENCED.findall(page.read_text())
    return [Block(*info.partition(" ")[::2], text) for info, text in found]


def prose(page: Path) -> str:
    """A page without its fenced blocks."""
    return _FENCED.sub("", page.read_text())


def links(page: Path) -> list[str]:
    """The targets of the links of a page that stay within the project."""
    found = re.findall(r"\]\(([^)\s]+)\)", prose(page))
    return [link for link in found if "://" not in link]


def headings(page: Path) -> list[str]:
    """The headings of a page, without marks."""
    return [
        re.sub(r"[`*]|\]\([^)]*\)|\[", "", text)
        for text in re.findall(r"^#+ (.*)$", prose(page), re.MULTILINE)
    ]


def anchors(page: Path) -> set[str]:
    """The names by which links reach the headings of a page, as GitHub makes them."""
    return {
        re.sub(r"[^\w\- ]", "", text.strip().lower()).replace(" ", "-") for text in headings(page)
    }


def commands(page: Path) -> Iterator[list[str]]:
    """The commands of a page's ``sh`` and ``console`` blocks, each as its words."""
    for block in blocks(page):
        if block.language in ("sh", "console"):
            yield from _commands(block.text.splitlines(), "$ " * (block.language == "console"))


def _commands(lines: list[str], prompt: str) -> Iterator[list[str]]:
    waiting = ""
    for line in lines:
        if not waiting and not line.startswith(prompt):
            continue  # output
        waiting += (line if waiting else line.removeprefix(prompt)) + "\n"
        if line.endswith("\\"):
            continue
        try:
            words = shlex.split(waiting, comments=True)
        except ValueError:  # a quotation goes on in the next line
            continue
        waiting = ""
        command: list[str] = []
        for word in words:
            if word in _SEPARATORS:
                yield command
                command = []
            else:
                command.append(word.rstrip(";"))
        yield command
    assert not waiting, f"a quotation without end: {waiting}"
