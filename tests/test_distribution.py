"""The wheel and the sdist: they hold what the program reads, and the wheel alone runs."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tarfile
import tomllib
from email.message import Message
from email.parser import HeaderParser
from pathlib import Path
from zipfile import ZipFile

import pytest
from pages import links
from places import ROOT
from waiting import HANGS

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
NOT_SOURCE = shutil.ignore_patterns(".*", "build", "dist", "*.egg-info", "__pycache__")


def build(kind: str, source: Path, target: Path) -> Path:
    """Build without a network: setuptools and wheel are here, pinned (pyproject.toml, `build`)."""
    code = f"import sys, setuptools.build_meta as b; b.build_{kind}(sys.argv[1])"
    subprocess.run(
        [sys.executable, "-c", code, str(target)],
        cwd=source,
        check=True,
        capture_output=True,
        timeout=HANGS,
    )
    (built,) = target.glob("*.whl" if kind == "wheel" else "*.tar.gz")
    return built


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built of the sdist, as `python -m build` does: the sdist lacks nothing, then."""
    folder = tmp_path_factory.mktemp("built")
    # A copy: building leaves folders behind.
    shutil.copytree(ROOT, folder / "source", ignore=NOT_SOURCE)
    sdist = build("sdist", folder / "source", folder)
    with tarfile.open(sdist) as archive:
        archive.extractall(folder / "sdist", filter="data")
    (source,) = (folder / "sdist").iterdir()
    assert (source / "LICENSE").is_file()
    # An index shows the README alone; it says that its links are in the sdist.
    linked = {link.partition("#")[0] for link in links(ROOT / "README.md")}
    assert sorted(link for link in linked if not (source / link).exists()) == []
    return build("wheel", source, folder)


@pytest.fixture(scope="module")
def names(wheel: Path) -> set[str]:
    with ZipFile(wheel) as archive:
        return set(archive.namelist())


@pytest.mark.parametrize(
    "pattern",
    [
        "templates/library/*.rq",
        "ontology/*.ttl",
        "ontology/alignments/*.ttl",
        "languages/*/*.lark",
        "languages/specification/*.xsd",
        "service/console/*.*",
        "service/console/*/*.*",
        "service/static/*",
        "examples/*.*",
        "py.typed",
    ],
)
def test_the_wheel_has_what_the_program_reads(names: set[str], pattern: str) -> None:
    files = {f"dyknow/{path.relative_to(ROOT)}" for path in ROOT.glob(pattern) if path.is_file()}
    assert files
    assert files <= names


def test_the_wheel_has_no_tests_and_no_pages(names: set[str]) -> None:
    folders = {name.split("/")[1] for name in names if name.startswith("dyknow/")}
    assert not folders & {"tests", "bench", "docs", "docker"}
    assert {name.split("/")[0] for name in names} == {"dyknow", "dyknow-0.1.0.dist-info"}


def test_the_metadata_is_whole(wheel: Path) -> None:
    with ZipFile(wheel) as archive:
        found: Message = HeaderParser().parsestr(
            archive.read("dyknow-0.1.0.dist-info/METADATA").decode()
        )
    assert found["Name"] == "dyknow"
    assert found["Summary"] == PROJECT["description"]
    assert found["Author"] == PROJECT["authors"][0]["name"]
    assert found["License-Expression"] == "Apache-2.0"
    assert found["License-File"] == "LICENSE"
    assert found["Description-Content-Type"] == "text/markdown"
    assert found.get_payload().strip() == (ROOT / "README.md").read_text().strip()
    assert found.get_all("Classifier") == PROJECT["classifiers"]
    assert len(found.get_all("Project-URL", [])) == len(PROJECT["urls"])
    assert set(found.get_all("Provides-Extra", [])) == {"arrow", "mcap", "pandas", "px4", "rosbag"}


def test_the_wheel_alone_runs(wheel: Path, tmp_path: Path) -> None:
    """Unpacked beside the installed dependencies: nothing of the checkout is needed."""
    with ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    head = (
        "import sys; sys.path.insert(0, sys.argv.pop(1))\n"
        "import dyknow; assert dyknow.__file__.startswith(sys.path[0]), dyknow.__file__\n"
    )

    def run(code: str, *arguments: str) -> str:
        done = subprocess.run(
            [sys.executable, "-c", head + code, str(tmp_path), *arguments],
            cwd=tmp_path,
            check=True,
            capture_output=True,
            text=True,
            timeout=HANGS,
        )
        return done.stdout

    command = "from dyknow.service.cli import main; main()"
    assert "serve" in run(command, "--help")
    assert run(command, "--version").strip() == PROJECT["version"]
    # It reads the ontologies, the grammars and the templates of the package.
    code = """
from dyknow.engine.engine import Engine
from dyknow.templates.library import shipped_texts
engine = Engine()
engine.annotate("stream s contains speed(UAV) = v for every UAV = id")
for text in shipped_texts().values():
    engine.register_template(text)
print(*(view.local_name for view in engine.templates()))"""
    assert run(code).split() == ["HighSpeedEvent", "LowAltitudeEvent"]
