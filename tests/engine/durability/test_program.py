"""Which source a checkpoint depends on: that of DyKnow, and nothing that lies beside it."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from places import ROOT

from dyknow.engine.durability import checkpoint


def test_the_program_is_all_packages_of_the_project() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    packages = [name.split(".") for name in project["tool"]["setuptools"]["packages"]]
    assert set(checkpoint._PACKAGES) == {name[1] for name in packages if len(name) > 1}


def test_files_beside_the_packages_are_no_other_program(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The tutorial has people write `robot.py` in the checkout, between two starts."""
    monkeypatch.setattr(checkpoint, "_ROOT", tmp_path)

    def write(name: str, text: str) -> str:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return checkpoint._program.__wrapped__()

    (tmp_path / "__init__.py").touch()
    before = write("engine/units/unit.py", "x = 1")
    for name in ("robot.py", "robots/__init__.py", "tests/test_robot.py", ".venv/lib/module.py"):
        assert write(name, "y = 1") == before
    assert write("engine/units/unit.py", "x = 2") != before
    (tmp_path / "engine/units/unit.py").write_text("x = 1")
    assert write("__init__.py", "y = 1") != before
    (tmp_path / "__init__.py").write_text("")
    assert write("service/new.py", "") != before
