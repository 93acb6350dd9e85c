"""The house as a whole: what pyproject.toml says of it, what the paper map says of it."""

import ast
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
ROOMS = {
    path.parent.relative_to(ROOT)
    for path in ROOT.glob("*/**/__init__.py")
    if not any(part.startswith(".") or part in ("tests", "build") for part in path.parts)
}


def test_every_package_is_listed():
    listed = set(PROJECT["tool"]["setuptools"]["packages"])
    there = {"dyknow"} | {".".join(("dyknow", *room.parts)) for room in ROOMS}
    assert listed == there


def test_every_data_file_is_listed():
    patterns = [
        (Path(*package.split(".")[1:]), pattern)
        for package, globs in PROJECT["tool"]["setuptools"]["package-data"].items()
        for pattern in globs
    ]
    covered = {path for folder, pattern in patterns for path in (ROOT / folder).glob(pattern)}
    data = {
        path
        for room in ROOMS
        for path in (ROOT / room).rglob("*")
        if path.is_file() and path.suffix not in (".py", ".pyc", ".nbi", ".nbc")
    }
    assert data <= covered


def test_every_python_file_says_what_it_is():
    silent = [
        path
        for room in [Path(), *ROOMS]
        for path in (ROOT / room).glob("*.py")
        if not path.read_text().lstrip().startswith('"""')
    ]
    assert silent == []


def test_no_folder_has_many_files():
    sizes = {room: len([*(ROOT / room).glob("*.py")]) for room in ROOMS}
    assert {room: size for room, size in sizes.items() if size > 22} == {}


def test_every_long_file_says_why_it_is_long():
    texts = {path: path.read_text() for room in ROOMS for path in (ROOT / room).glob("*.py")}
    long = {path: text for path, text in texts.items() if text.count("\n") > 500}
    silent = [
        p for p, text in long.items() if " long" not in (ast.get_docstring(ast.parse(text)) or "")
    ]
    assert silent == []


def _map_rows() -> list[tuple[str, str, str]]:
    rows = []
    for line in (ROOT / "docs" / "reference" / "paper-map.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 3 and "`" in cells[1]:
            rows.append((cells[0], cells[1], cells[2]))
    return rows


@pytest.mark.parametrize(("term", "modules", "tests"), _map_rows())
def test_the_paper_map_is_true(term: str, modules: str, tests: str):
    """Each row names modules with something in them, and tests that exist."""
    for path, name in re.findall(r"`([\w/.-]+)(?::(\w+))?`", modules):
        text = (ROOT / path).read_text()
        assert not name or re.search(rf"\b{name}\b", text), f"{term}: {name} is not in {path}"
    named = re.findall(r"`([\w/.-]+)(?:::(\w+))?`", tests)
    assert named, f"{term}: no test"
    for path, name in named:
        text = (ROOT / path).read_text()
        assert not name or f"def {name}(" in text or path.endswith(".case"), f"{term}: {name}"


def test_the_paper_map_is_not_empty():
    assert len(_map_rows()) > 40


def test_lock_files_hold_no_addresses():
    for path in ROOT.glob("requirements*.lock"):
        text = path.read_text()
        assert "://" not in text
        assert text.count("--hash=sha256:") >= text.count("==")


def test_every_definition_is_listed_with_the_laws_that_use_it():
    tests = ROOT / "tests"
    folder = tests / "definitions"
    rows = re.findall(r"^\| `(\w+)` \|.*\| ([^|]*) \|$", (folder / "README.md").read_text(), re.M)
    assert sorted(name for name, _ in rows) == sorted(path.stem for path in folder.rglob("*.py"))
    imports = {
        path.stem: set(re.findall(r"^(?:from|import) (\w+)", path.read_text(), re.M))
        for path in [*folder.rglob("*.py"), *(tests / "support").rglob("*.py")]
    }
    for name, laws in rows:
        for law in re.findall(r"`([^`]+)`", laws):
            used = set(re.findall(r"^(?:from|import) (\w+)", (tests / law).read_text(), re.M))
            while more := {m for each in used for m in imports.get(each, ())} - used:
                used |= more
            assert name in used, f"{law} does not use {name}"
